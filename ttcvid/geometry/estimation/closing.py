"""How a thing closes in, and by how much faster all the while: from the sizes of its picture over time.

Sizes are blind to the rotation of the camera (to first order) and to the direction of the thing: what is left is depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from ttcvid.geometry.medians import median, row_medians
from ttcvid.geometry.quotient import quotient
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
    xy = xy[:, ::every]
    is_seen = np.isfinite(xy[..., 0]) & np.isfinite(xy[-1, :, 0])
    then, now = np.where(is_seen[..., None], xy, 0.0), np.where(is_seen[..., None], xy[-1], 0.0)
    # As if the size were the same: what flows as most of them do.
    flow = np.stack([row_medians(now[..., j] - then[..., j], is_seen) for j in range(2)], axis=-1)
    square = np.sum((now - then - flow[:, None]) ** 2, axis=2)
    for _ in range(_STEPS):
        sigma2 = _SIGMA_OF_MEDIAN**2 * row_medians(square, is_seen)[:, None] + _TINY**2
        w = is_seen / (1.0 + square / (_CAUCHY_SIGMAS**2 * sigma2))
        total = np.sum(w, axis=1)
        off_then, off_now = (
            each - quotient(np.einsum("lm,lmj->lj", w, each), total[:, None])[:, None] for each in (then, now)
        )
        uu, vv = (np.einsum("lm,lmj->l", w, each**2) for each in (off_then, off_now))
        scale = np.sqrt(quotient(vv, uu))
        square = np.sum((off_now - scale[:, None, None] * off_then) ** 2, axis=2)
    squares = np.sum(w * w, axis=1)
    count = quotient(total * total, squares)
    is_told = (np.sum(is_seen, axis=1) >= 3) & (uu > 0.0) & (vv > 0.0) & (count > 2.0)
    is_told[-1] = False
    # Weighted points tell a size as well as so many equal ones would.
    off = np.sum(w * w * square, axis=1)
    point_variance = quotient(off * count, squares * (2.0 * count - 3.0) * (1.0 + scale * scale))
    of_size = scale * scale * point_variance * quotient(total, count) * (quotient(1.0, uu) + quotient(1.0, vv))
    depth, variance = np.where(is_told, scale, np.nan), np.where(is_told, of_size, np.nan)
    depth[-1], variance[-1] = 1.0, np.fmin.reduce(variance)
    radius = np.sqrt(quotient(vv, total))[is_told]
    return depth, variance, float(radius[-1]) if len(radius) else 0.0


def fit_braking(depth: Floats, variance: Floats, since_s: Floats, drift_hz: float, least_s: float) -> Closing | None:
    """Rate and acceleration now of what may have begun to accelerate at some view; None with too few views.

    Generalised least squares: the present view's noise is in all of ``depth``, so that the present depth is unknown
    too; what matching errs by adds up like a random walk away from now. Who brakes has not braked all the time that is
    looked at: a constant acceleration over all of it is too small by then, and the present rate lags. Here it goes on
    steadily until a view (the first is one of them) and accelerates from there on; of these, the one that fits best is
    taken. That makes noise look surer than it is, by less than 0.35 standard deviations.

    Parameters
    ----------
    depth, variance : (L,) as of `depths_over_time`, NaN where not known.
    since_s : (L,) times up to 0.
    drift_hz : variance that the random walk gains in a second.
    least_s : what has begun since then is left out: it hangs on few views.
    """
    began_s = since_s[np.isfinite(depth) & np.isfinite(variance)][:-_LEAST_STEPS]
    began_s = np.append(began_s[:1], began_s[1:][began_s[1:] <= -least_s])
    rows = _whitened(depth, variance, since_s, drift_hz, began_s)
    if rows is None:
        return None
    steady = np.linalg.qr(rows[:, :2])[0]
    left = rows[:, 2:] - steady @ (steady.T @ rows[:, 2:])
    gain = (left[:, :-1].T @ left[:, -1]) ** 2 / np.maximum(np.sum(left[:, :-1] ** 2, axis=0), _TINY)
    columns, depths = rows[:, [0, 1, 2 + int(np.argmax(gain))]], rows[:, -1]
    cov = np.linalg.inv(columns.T @ columns)
    found = cov @ (columns.T @ depths)
    left = depths - columns @ found
    cov *= max(float(left @ left) / (len(rows) - 3), 1.0)
    return Closing(float(found[1] / found[0]), float(found[2] / found[0]), cov[1:, 1:] / found[0] ** 2)


def _whitened(depth: Floats, variance: Floats, since_s: Floats, drift_hz: float, began_s: Floats) -> Floats | None:
    """1, t, K curves and the depth of each known view, independent of unit variance: (L, 3 + K); None with too few.

    A curve is what an acceleration of 1 adds that began at ``began_s (K,)``, seen from now: t^2 / 2 since then, and
    before it the straight line that meets that. Independent: multiplied by the inverse of the Cholesky factor of what
    the views err by.
    """
    is_known = np.isfinite(depth) & np.isfinite(variance)
    t = since_s[is_known]
    if len(t) < _LEAST_VIEWS:
        return None
    until = np.maximum(t[:, None], began_s)
    rows = np.column_stack([np.ones(len(t)), t, until * (t[:, None] - 0.5 * until), depth[is_known]])
    errors = drift_hz * np.minimum(-t[:, None], -t)
    errors[np.diag_indices(len(t))] += max(median(variance[is_known]), _TINY * _TINY)
    return np.asarray(solve_triangular(np.linalg.cholesky(errors), rows, lower=True, check_finite=False))
