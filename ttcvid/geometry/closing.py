"""How a thing closes in, and by how much faster all the while: from the sizes of its picture over time.

Sizes are blind to the rotation of the camera (to first order) and to the direction of the thing: what is left is depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.model import Floats

# Views that a depth, its rate and its acceleration need, with some to tell their noise.
_LEAST_VIEWS = 6
# What has begun fewer steps ago than this is not told from the error of a view.
_LEAST_STEPS = 2
# Steps of the robust fit of a size: from equal sizes these are enough.
_STEPS = 3
# What so many tracks say of a size, more of them hardly say better, in so much more time: their common error limits it.
_MOST_TRACKS = 40
# From a median of lengths of two components to their standard deviation per axis; squares beyond so many of these
# variances count half (Cauchy).
_SIGMA_OF_MEDIAN, _CAUCHY_SIGMAS = 0.849, 2.4
# Points lie nowhere better than this, over the focal length: a divisor.
_TINY = 1e-9


@dataclass(frozen=True)
class Closing:
    """Depth over time, Z(t) / Z(0) = 1 + ``rate_hz`` t + ``acceleration_hz2`` t^2 / 2, with its covariance (2, 2).

    Negative: it comes nearer, ever faster.
    """

    rate_hz: float
    acceleration_hz2: float
    cov: Floats

    @property
    def rate_sigma_hz(self) -> float:
        """Standard deviation of the rate over the depth, 1/s."""
        return float(np.sqrt(self.cov[0, 0]))

    @property
    def acceleration_sigma_hz2(self) -> float:
        """Standard deviation of the acceleration over the depth, 1/s^2."""
        return float(np.sqrt(self.cov[1, 1]))

    def left_after(self, t_s: float, lasting_s: float) -> tuple[float, float]:
        """What is left of the present depth after a time, and its standard deviation; both linear in what is known.

        The acceleration lasts for so long, and the speed then stays. What closes in ever faster has been reached where
        less than nothing is left. A car 20 m ahead at our own speed that brakes with 5 m/s^2 for 1 s:

        >>> Closing(0.0, -5 / 20, np.eye(2)).left_after(4.5, 1.0)[0]
        0.0
        >>> Closing(-0.25, -0.5, np.diag([0.01, 0.0])).left_after(2.0, 1.0)
        (-0.25, 0.2)
        """
        while_s = min(t_s, lasting_s)
        by = np.array([t_s, while_s * (t_s - 0.5 * while_s)])
        left = 1.0 + by @ np.array([self.rate_hz, self.acceleration_hz2])
        return float(left), float(np.sqrt(by @ self.cov @ by))


def depths_over_time(xy: Floats) -> tuple[Floats, Floats, float]:
    """Depth of a thing in past views, over its present one, by the sizes of its picture.

    Robust: a part of the tracks may belong to something else. Of many tracks every n-th is looked at.

    Parameters
    ----------
    xy : (L, M, 2) places of its tracks in the plane z = 1 without rotation, NaN where not seen; the last view is the
        present one.

    Returns
    -------
    depth : (L,) Z(t) / Z(0), NaN where not known.
    variance : (L,) of it, by how well the tracks agree.
    radius : root mean square distance of the points that agree from their centre, in the plane z = 1.
    """
    every = max(1, -(-xy.shape[1] // _MOST_TRACKS))
    depth, variance = np.full(len(xy), np.nan), np.full(len(xy), np.nan)
    radius = _fit_sizes(np.ascontiguousarray(xy[:, ::every]), depth, variance)
    return depth, variance, radius


def fit_closing(depth: Floats, variance: Floats, since_s: Floats, drift_hz: float) -> Closing | None:
    """Rate and acceleration of a depth (L,) seen with noise and with an error that drifts; None with too few views.

    Generalised least squares: the present view's noise is in all of ``depth``, so that the present depth is unknown
    too; what matching errs by adds up like a random walk away from now.

    Parameters
    ----------
    depth, variance : as of `depths_over_time`, NaN where not known.
    since_s : (L,) times up to 0.
    drift_hz : variance that the random walk gains in a second.
    """
    rows = np.empty((len(depth), 4))
    n_views = _whiten(depth, variance, since_s, drift_hz, np.full(1, -np.inf), rows)
    return None if n_views < _LEAST_VIEWS else _solved(rows[:n_views])


def fit_braking(depth: Floats, variance: Floats, since_s: Floats, drift_hz: float, least_s: float) -> Closing | None:
    """Rate and acceleration now of what may have begun to accelerate at some view; None with too few views.

    Who brakes has not braked all the time that is looked at: a constant acceleration over all of it is too small by
    then, and the present rate lags. Here it goes on steadily until a view and accelerates from there on; of these,
    the one that fits best is taken (`fit_closing` among them, which begins at the first view). That makes noise look
    surer than it is, by less than 0.35 standard deviations.

    Parameters
    ----------
    depth, variance, since_s, drift_hz : as of `fit_closing`.
    least_s : what has begun since then is left out: it hangs on few views.
    """
    began_s = since_s[np.isfinite(depth) & np.isfinite(variance)][:-_LEAST_STEPS]
    began_s = np.append(began_s[:1], began_s[1:][began_s[1:] <= -least_s])
    rows = np.empty((len(depth), 3 + len(began_s)))
    n_views = _whiten(depth, variance, since_s, drift_hz, began_s, rows)
    if n_views < _LEAST_VIEWS:
        return None
    rows = rows[:n_views]
    steady = np.linalg.qr(rows[:, :2])[0]
    left = rows[:, 2:] - steady @ (steady.T @ rows[:, 2:])
    gain = (left[:, :-1].T @ left[:, -1]) ** 2 / np.maximum(np.sum(left[:, :-1] ** 2, axis=0), _TINY)
    return _solved(rows[:, [0, 1, 2 + int(np.argmax(gain)), -1]])


def _solved(rows: Floats) -> Closing:
    """The motion of which ``rows (L, 4)`` tell: the depth, and what makes it, of each view."""
    columns, depths = rows[:, :3], rows[:, 3]
    cov = np.linalg.inv(columns.T @ columns)
    found = cov @ (columns.T @ depths)
    left = depths - columns @ found
    cov *= max(float(left @ left) / (len(rows) - 3), 1.0)
    return Closing(float(found[1] / found[0]), float(found[2] / found[0]), cov[1:, 1:] / found[0] ** 2)


@compiled_for("(f8[::1], f8[::1], f8[::1], f8, f8[::1], f8[:, ::1])")
def _whiten(depth: Floats, variance: Floats, since_s: Floats, drift_hz: float, began_s: Floats, rows: Floats) -> int:
    """Fills ``rows (L, 3 + K)`` with 1, t, K curves and the depth of each known view, independent of unit variance.

    A curve is what an acceleration of 1 adds that began at ``began_s (K,)``, seen from now: t^2 / 2 since then, and
    before it the straight line that meets that. Independent: multiplied by the inverse of the Cholesky factor of what
    the views err by. Returns how many are known; with too few, they stay as they are.
    """
    n, n_columns, noise, t = 0, rows.shape[1], np.empty(len(depth)), np.empty(len(depth))
    for i in range(len(depth)):
        if np.isfinite(depth[i]) and np.isfinite(variance[i]):
            noise[n], t[n] = variance[i], since_s[i]
            rows[n, 0], rows[n, 1], rows[n, n_columns - 1] = 1.0, t[n], depth[i]
            for k in range(n_columns - 3):
                until = max(t[n], began_s[k])
                rows[n, 2 + k] = until * (t[n] - 0.5 * until)
            n += 1
    if n < _LEAST_VIEWS:
        return n
    factor, own = np.empty((n, n)), max(np.median(noise[:n]), _TINY * _TINY)
    for i in range(n):
        for k in range(i + 1):
            rest = drift_hz * min(-t[i], -t[k]) + (own if i == k else 0.0)
            for m in range(k):
                rest -= factor[i, m] * factor[k, m]
            factor[i, k] = np.sqrt(rest) if i == k else rest / factor[k, k]
        for column in range(n_columns):
            for m in range(i):
                rows[i, column] -= factor[i, m] * rows[m, column]
            rows[i, column] /= factor[i, i]
    return n


@compiled_for("(f8[:, :, ::1], f8[::1], f8[::1])")
def _fit_sizes(xy: Floats, depth: Floats, variance: Floats) -> float:
    """Fills ``depth, variance (L,)`` of `depths_over_time`; returns its ``radius``."""
    now, n_tracks, radius = len(xy) - 1, xy.shape[1], 0.0
    offset, w, square, centre = np.empty((n_tracks, 4)), np.empty(n_tracks), np.empty(n_tracks), np.empty(4)
    for view in range(now):
        n = 0
        for i in range(n_tracks):
            if np.isfinite(xy[view, i, 0]) and np.isfinite(xy[now, i, 0]):
                offset[n, 0], offset[n, 1] = xy[view, i, 0], xy[view, i, 1]
                offset[n, 2], offset[n, 3] = xy[now, i, 0], xy[now, i, 1]
                n += 1
        if n < 3:
            continue
        # As if the size were the same: what flows as most of them do.
        flow_x, flow_y = np.median(offset[:n, 2] - offset[:n, 0]), np.median(offset[:n, 3] - offset[:n, 1])
        for i in range(n):
            dx, dy = offset[i, 2] - offset[i, 0] - flow_x, offset[i, 3] - offset[i, 1] - flow_y
            square[i] = dx * dx + dy * dy
        scale, uu, vv, total, misfit, squares = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for _ in range(_STEPS):
            sigma2 = _SIGMA_OF_MEDIAN**2 * np.median(square[:n]) + _TINY**2
            total, squares = 0.0, 0.0
            centre[0], centre[1], centre[2], centre[3] = 0.0, 0.0, 0.0, 0.0
            for i in range(n):
                w[i] = 1.0 / (1.0 + square[i] / (_CAUCHY_SIGMAS**2 * sigma2))
                total += w[i]
                squares += w[i] * w[i]
                for j in range(4):
                    centre[j] += w[i] * offset[i, j]
            for j in range(4):
                centre[j] /= total
            uu, vv = 0.0, 0.0
            for i in range(n):
                uu += w[i] * ((offset[i, 0] - centre[0]) ** 2 + (offset[i, 1] - centre[1]) ** 2)
                vv += w[i] * ((offset[i, 2] - centre[2]) ** 2 + (offset[i, 3] - centre[3]) ** 2)
            if not (uu > 0.0 and vv > 0.0):
                break
            scale = np.sqrt(vv / uu)
            misfit = 0.0
            for i in range(n):
                dx = offset[i, 2] - centre[2] - scale * (offset[i, 0] - centre[0])
                dy = offset[i, 3] - centre[3] - scale * (offset[i, 1] - centre[1])
                square[i] = dx * dx + dy * dy
                misfit += w[i] * w[i] * square[i]
        count = total * total / squares
        if not (uu > 0.0 and vv > 0.0 and count > 2.0):
            continue
        # Weighted points tell a size as well as so many equal ones would.
        point_variance = misfit * count / (squares * (2.0 * count - 3.0) * (1.0 + scale * scale))
        depth[view] = scale
        variance[view] = scale * scale * point_variance * (total / count) * (1.0 / uu + 1.0 / vv)
        radius = np.sqrt(vv / total)
    depth[now], variance[now] = 1.0, np.nanmin(variance)
    return radius
