"""The image state (x, y, a, b, c) of points by maximum likelihood from all views of their tracks.

(x, y) = (X, Y) / Z is where the point is at time 0, (a, b, c) = V / Z its velocity in units of its depth, in 1/s. Seen
by a camera that does not turn, it moves along x(t) = (x + a t) / (1 + c t), y(t) = (y + b t) / (1 + c t).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ttcvid.geometry.chi_square import chi2_quantile
from ttcvid.geometry.compiled import compiled
from ttcvid.model import Floats, Ints

LEAST_FRAMES = 3
"""Views that the state needs; a window is never cut below them."""

# An observation farther off than this, in sigmas, loses weight as 1 / r^2: 1 % of Gaussian noise in two components.
_ROBUST_SIGMAS = 3.0
# Gauss-Newton ends after so many steps, or after one shorter than this (squared, in sigmas of the estimate).
_MAX_STEPS, _CONVERGED_CHI2 = 8, 1e-2
# The window is chosen anew in the first steps; then it only becomes shorter, so that the rest converges.
_WINDOW_STEPS = 3
# So many of a window's farthest views are tested also by themselves: where a velocity has changed they are the ones
# that do not fit, and in a long window they drown.
_TAIL = 3
# The depth of a point over that at time 0, 1 + c t, stays above this over the window; one step of c changes it by no
# more than 1 at the window's end. c about zero is expected with a standard deviation of 3 over the window: it decides
# where the views alone leave c open (two views, no flow), and nowhere else.
_LEAST_DEPTH_RATIO, _C_SIGMA = 0.1, 3.0
# Columns of the sums below.
_N_SUMS = 14


@dataclass(frozen=True)
class MotionPlane:
    """The plane in which everything moves: its unit ``normal (3,)`` with ``covariance (3, 3)`` in rad^2."""

    normal: Floats
    covariance: Floats


@dataclass(frozen=True)
class WholeTracks:
    """States of N tracks at time 0.

    ``state (N, 5)`` x, y without unit, a, b, c in 1/s, with ``cov (N, 5, 5)``, NaN with fewer than three views;
    ``info_w (N, 3, 3)`` in s^2: information on w = (a, b, c) alone, x and y marginalised out, so that the
    likelihood of any other w is ``exp(-(w - state[2:])' info_w (w - state[2:]) / 2)``. Two views have rank 2 (their
    state has c = 0, one of the w that explain them), one view has none. ``chi2 (N,)`` of the robust residuals over
    the window of ``n_frames (N,)`` views, with ``dof (N,)`` = 2 n_frames - 5 degrees of freedom, 0 at the least.
    """

    state: Floats
    cov: Floats
    info_w: Floats
    chi2: Floats
    dof: Ints
    n_frames: Ints


def fit_whole_tracks(
    xy: Floats,
    t_s: Floats,
    sigma_norm: Floats,
    start: Floats | None = None,
    max_frames: int | None = None,
    gate_probability: float = 0.999,
    plane: MotionPlane | None = None,
) -> WholeTracks:
    """State of each track by robust Gauss-Newton on the reprojection error, over a window that fits it.

    The window is the longest run of views around time 0 that one constant velocity explains, three views at the least:
    chi-square tests of the whole window, and of what its farthest views add to it. Jacobians stand at the predicted
    positions: at the observed ones, which the linear solve that starts the search uses, noise enters a column and
    biases c towards zero.

    Parameters
    ----------
    xy
        ``(L, N, 2)`` derotated positions in the plane z = 1 of the camera at time 0; NaN where not observed.
    t_s
        ``(L,)`` times relative to the reference, in s: 0 and before, or on both sides; in any order.
    sigma_norm
        ``(N,)`` standard deviation of a coordinate of one observation.
    start
        ``(N, 5)`` states to start from, such as those of the last frame carried forward (`carried_forward`); NaN rows,
        or None: from the linear solve.
    max_frames
        Most views of a window; None: all.
    gate_probability
        Probability with which a constant velocity keeps its whole window.
    plane
        Planar motion, as the Gaussian prior ``normal . w ~ N(0, w' covariance w)``: then two views suffice. It is
        part of ``cov`` and ``info_w`` then.

    Returns
    -------
    `WholeTracks`. NaN state where the views are fewer than two, or sigma is not positive.

    Source: DESIGN section 3, the general estimator.

    A point at (1, 0, 10) m that comes nearer by 1 m in 0.1 s has ttc_z = 1 s, that is c = -1 / s:

    >>> z = np.array([10.0, 11.0, 12.0, 13.0])
    >>> xy = np.column_stack([1.0 / z, 0.0 * z])[:, None]
    >>> fit_whole_tracks(xy, np.array([0.0, -0.1, -0.2, -0.3]), np.array([1e-6])).state.round(6) + 0.0
    array([[ 0.1,  0. ,  0. ,  0. , -1. ]])
    """
    n = xy.shape[1]
    if xy.shape != (len(t_s), n, 2) or sigma_norm.shape != (n,):
        raise ValueError(
            f"expected xy (L, N, 2), t_s (L,) and sigma_norm (N,), got {xy.shape}, {t_s.shape}, {sigma_norm.shape}"
        )
    order = np.argsort(np.abs(t_s), kind="stable")
    longest = len(t_s) if max_frames is None else min(max_frames, len(t_s))
    nothing = np.empty(0), np.empty((0, 0))
    normal, normal_cov = nothing if plane is None else (plane.normal, plane.covariance)
    state, cov = np.full((n, 5), np.nan), np.full((n, 5, 5), np.nan)
    info_w, chi2 = np.zeros((n, 3, 3)), np.zeros(n)
    n_frames = np.zeros(n, dtype=np.int64)
    start = np.full((n, 5), np.nan) if start is None else start
    _fit_each(
        np.ascontiguousarray(xy, dtype=np.float64),
        np.asarray(t_s, dtype=np.float64),
        np.asarray(sigma_norm, dtype=np.float64),
        order,
        longest,
        np.asarray(start, dtype=np.float64),
        window_gates(longest, 5, gate_probability),
        window_gates(_TAIL, 0, gate_probability),
        np.asarray(normal, dtype=np.float64),
        np.asarray(normal_cov, dtype=np.float64),
        state,
        cov,
        info_w,
        chi2,
        n_frames,
    )
    if plane is not None:
        _add_plane(plane, state, cov, info_w)
    return WholeTracks(state, cov, info_w, chi2, np.maximum(2 * n_frames - 5, 0), n_frames)


def carried_forward(state: Floats, dt_s: float, cam_R_prev: Floats) -> Floats:
    """States ``(N, 5)`` of the last reference as the present camera sees them ``dt_s`` later; NaN behind it.

    ``cam_R_prev (3, 3)`` turns a ray of the last reference camera into the present one.
    """
    place = np.column_stack([state[:, :2], np.ones(len(state))]) + dt_s * state[:, 2:]
    place, velocity = place @ cam_R_prev.T, state[:, 2:] @ cam_R_prev.T
    depth = np.where(place[:, 2:] > _LEAST_DEPTH_RATIO, place[:, 2:], np.nan)
    return np.concatenate([place[:, :2] / depth, velocity / depth], axis=1)


@lru_cache(maxsize=32)
def window_gates(max_frames: int, n_unknowns: int, probability: float) -> Floats:
    """Chi-square ``(max_frames + 1,)`` inside which so many views are kept; infinite without a degree of freedom."""
    dof = 2 * np.arange(max_frames + 1) - n_unknowns
    gates = np.full(max_frames + 1, np.inf)
    gates[dof > 0] = chi2_quantile(probability, dof[dof > 0])
    return gates


def _add_plane(plane: MotionPlane, state: Floats, cov: Floats, info_w: Floats) -> None:
    """Add what the plane says to the covariances and the information, in place."""
    variance = np.einsum("ni,ij,nj->n", state[:, 2:], plane.covariance, state[:, 2:])
    has_rate = variance > 0.0
    info_w[has_rate] += np.outer(plane.normal, plane.normal) / variance[has_rate, None, None]
    towards = cov[:, :, 2:] @ plane.normal
    spread = variance + towards[:, 2:] @ plane.normal
    cov -= np.einsum("ni,nj->nij", towards, towards) / spread[:, None, None]


@compiled
def _fit_each(
    xy: Floats,
    t_s: Floats,
    sigma: Floats,
    order: Ints,
    longest: int,
    start: Floats,
    gates: Floats,
    tail_gates: Floats,
    normal: Floats,
    normal_cov: Floats,
    state: Floats,
    cov: Floats,
    info_w: Floats,
    chi2: Floats,
    n_frames: Ints,
) -> None:
    """Fill the results of `fit_whole_tracks`, track by track."""
    t, px, py = np.empty(longest), np.empty(longest), np.empty(longest)
    sums = np.zeros((longest + 1, _N_SUMS))
    s, step = np.empty(5), np.empty(5)
    for i in range(xy.shape[1]):
        if not sigma[i] > 0.0:
            continue
        m = 0
        for place in order:
            if m == longest:
                break
            if np.isfinite(xy[place, i, 0] + xy[place, i, 1]):
                t[m], px[m], py[m] = t_s[place], xy[place, i, 0], xy[place, i, 1]
                m += 1
        n_frames[i] = m
        if m < 2:
            continue
        # About the newest position: a shift of the picture plane that keeps the path's form and the digits.
        x0, y0 = px[0], py[0]
        first, last = 0.0, 0.0
        for k in range(m):
            px[k] -= x0
            py[k] -= y0
            first, last = min(first, t[k]), max(last, t[k])
        span = max(last - first, 1e-12)
        prior = (span / _C_SIGMA) ** 2
        inverse = 1.0 / sigma[i]
        c_low = -(1.0 - _LEAST_DEPTH_RATIO) / max(last, 1e-12)
        c_high = (1.0 - _LEAST_DEPTH_RATIO) / max(-first, 1e-12)
        s[0], s[1] = start[i, 0] - x0, start[i, 1] - y0
        s[2], s[3], s[4] = start[i, 2] - start[i, 4] * x0, start[i, 3] - start[i, 4] * y0, start[i, 4]
        has_start = np.isfinite(s[0] + s[1] + s[2] + s[3] + s[4]) and c_low < s[4] < c_high
        n = m
        if not has_start:
            s[:] = 0.0
            _add_up(t, px, py, m, s, inverse, True, sums)
            _solve(sums[m], prior, s[4], c_low, c_high, 1.0 / span, step)
            s += step
        for count in range(_MAX_STEPS):
            n = m if count < _WINDOW_STEPS else n
            _add_up(t, px, py, n, s, inverse, False, sums)
            while n > LEAST_FRAMES:
                whole = sums[n, 13] - _solve(sums[n], prior, s[4], c_low, c_high, 1.0 / span, step)
                k = max(n - _TAIL, LEAST_FRAMES)
                near = sums[k, 13] - _solve(sums[k], prior, s[4], c_low, c_high, 1.0 / span, step)
                if whole <= gates[n] and whole - near <= tail_gates[n - k]:
                    break
                n -= 1
            fall = _solve(sums[n], prior, s[4], c_low, c_high, 1.0 / span, step)
            if len(normal):
                fall = _solve_on_plane(sums[n], prior, s, x0, y0, c_low, c_high, span, normal, normal_cov, step)
            s += step
            chi2[i] = max(sums[n, 13] - fall, 0.0)
            if fall < _CONVERGED_CHI2:
                break
        n_frames[i] = n
        _store(sums[n], n, s, x0, y0, state[i], cov[i], info_w[i])


@compiled
def _add_up(
    t: Floats, px: Floats, py: Floats, m: int, s: Floats, inverse: float, is_linear: bool, sums: Floats
) -> None:
    """Running sums of the normal equations over the first m views: ``sums[k]`` belongs to the first k.

    Columns: 0-2 the sums of h^2 t^j, j = 0, 1, 2; 3-6 the couplings of x, a, y, b with c; 7 the information on c;
    8-12 the score of x, a, y, b, c; 13 the squared residuals. With h = 1 / (1 + c t), d x(t) / d(x, a, c) =
    (h, h t, -h t x(t)). ``is_linear``: of x + a t - x_i t c = x_i instead, with observed positions in the column of c.
    """
    limit = _ROBUST_SIGMAS * _ROBUST_SIGMAS
    for k in range(m):
        time = t[k]
        h = 1.0 / (1.0 + s[4] * time)
        x, y = (s[0] + s[2] * time) * h, (s[1] + s[3] * time) * h
        rx, ry = (px[k] - x) * inverse, (py[k] - y) * inverse
        square = rx * rx + ry * ry
        weight = 1.0
        if is_linear:
            x, y = px[k], py[k]
        elif square > limit:
            weight = limit / square
        hi = h * inverse
        w = weight * hi * hi
        wt = w * time
        wtt = wt * time
        gx, gy = weight * hi * rx, weight * hi * ry
        past, row = sums[k], sums[k + 1]
        row[0] = past[0] + w
        row[1] = past[1] + wt
        row[2] = past[2] + wtt
        row[3] = past[3] + wt * x
        row[4] = past[4] + wtt * x
        row[5] = past[5] + wt * y
        row[6] = past[6] + wtt * y
        row[7] = past[7] + wtt * (x * x + y * y)
        row[8] = past[8] + gx
        row[9] = past[9] + gx * time
        row[10] = past[10] + gy
        row[11] = past[11] + gy * time
        row[12] = past[12] - time * (gx * x + gy * y)
        row[13] = past[13] + weight * square


@compiled
def _solve(
    row: Floats, prior: float, c: float, c_low: float, c_high: float, longest_step: float, step: Floats
) -> float:
    """Gauss-Newton step ``(5,)`` of x, y, a, b, c; returns by how much chi-square falls.

    (x, a) and (y, b) share one 2 x 2 matrix, and meet in c alone.
    """
    inverse = 1.0 / (row[0] * row[2] - row[1] * row[1])
    x_c, a_c = (row[2] * row[3] - row[1] * row[4]) * inverse, (row[0] * row[4] - row[1] * row[3]) * inverse
    y_c, b_c = (row[2] * row[5] - row[1] * row[6]) * inverse, (row[0] * row[6] - row[1] * row[5]) * inverse
    x_0, a_0 = (row[2] * row[8] - row[1] * row[9]) * inverse, (row[0] * row[9] - row[1] * row[8]) * inverse
    y_0, b_0 = (row[2] * row[10] - row[1] * row[11]) * inverse, (row[0] * row[11] - row[1] * row[10]) * inverse
    info_c = max(row[7] - row[3] * x_c - row[4] * a_c - row[5] * y_c - row[6] * b_c, 0.0)
    score_c = row[12] + row[3] * x_0 + row[4] * a_0 + row[5] * y_0 + row[6] * b_0
    dc = (score_c - prior * c) / (info_c + prior)
    dc = min(max(dc, -longest_step), longest_step)
    # Half of the way to a limit at most.
    dc = min(max(dc, 0.5 * (c_low - c)), 0.5 * (c_high - c))
    step[0], step[1] = x_0 + x_c * dc, y_0 + y_c * dc
    step[2], step[3] = a_0 + a_c * dc, b_0 + b_c * dc
    step[4] = dc
    fall: float = row[8] * x_0 + row[9] * a_0 + row[10] * y_0 + row[11] * b_0 + dc * (2.0 * score_c - info_c * dc)
    return fall


@compiled
def _solve_on_plane(
    row: Floats,
    prior: float,
    s: Floats,
    x0: float,
    y0: float,
    c_low: float,
    c_high: float,
    span: float,
    normal: Floats,
    normal_cov: Floats,
    step: Floats,
) -> float:
    """The same step with ``normal . w = 0`` as one more observation, of one w = (a' + c x0, b' + c y0, c)."""
    by_c = normal[0] * x0 + normal[1] * y0 + normal[2]
    a, b = s[2] + s[4] * x0, s[3] + s[4] * y0
    variance = 1e-12 + (
        a * (normal_cov[0, 0] * a + normal_cov[0, 1] * b + normal_cov[0, 2] * s[4])
        + b * (normal_cov[1, 0] * a + normal_cov[1, 1] * b + normal_cov[1, 2] * s[4])
        + s[4] * (normal_cov[2, 0] * a + normal_cov[2, 1] * b + normal_cov[2, 2] * s[4])
    )
    reach, towards = np.empty(5), row.copy()
    towards[8] = towards[10] = 0.0
    towards[9], towards[11], towards[12] = normal[0], normal[1], by_c
    _solve(towards, prior, 0.0, -np.inf, np.inf, np.inf, reach)
    _solve(row, prior, s[4], -np.inf, np.inf, np.inf, step)
    off = normal[0] * s[2] + normal[1] * s[3] + by_c * s[4]
    miss = off + normal[0] * step[2] + normal[1] * step[3] + by_c * step[4]
    step -= reach * (miss / (variance + normal[0] * reach[2] + normal[1] * reach[3] + by_c * reach[4]))
    limit = min(max(step[4], -1.0 / span), 1.0 / span)
    limit = min(max(limit, 0.5 * (c_low - s[4])), 0.5 * (c_high - s[4]))
    if limit != step[4]:
        step *= limit / step[4]
    pull = off / variance
    fall: float = (
        row[8] * step[0]
        + (row[9] - pull * normal[0]) * step[2]
        + row[10] * step[1]
        + (row[11] - pull * normal[1]) * step[3]
        + (row[12] - pull * by_c) * step[4]
    )
    return fall


@compiled
def _store(row: Floats, n: int, s: Floats, x0: float, y0: float, state: Floats, cov: Floats, info_w: Floats) -> None:
    """State, covariance and information of a track, moved back to the picture plane about its own origin."""
    state[0], state[1] = s[0] + x0, s[1] + y0
    state[2], state[3], state[4] = s[2] + s[4] * x0, s[3] + s[4] * y0, s[4]
    rest = 1.0 / row[0]
    info_aa = row[2] - row[1] * row[1] * rest
    info_ac, info_bc = row[1] * row[3] * rest - row[4], row[1] * row[5] * rest - row[6]
    info_cc = row[7] - (row[3] * row[3] + row[5] * row[5]) * rest
    # a = a' + c x0: the information of (a', b', c), seen from (a, b, c).
    info_w[0, 0] = info_w[1, 1] = info_aa
    info_w[0, 2] = info_w[2, 0] = info_ac - info_aa * x0
    info_w[1, 2] = info_w[2, 1] = info_bc - info_aa * y0
    info_w[2, 2] = info_cc - 2.0 * (info_ac * x0 + info_bc * y0) + info_aa * (x0 * x0 + y0 * y0)
    if n < LEAST_FRAMES:
        return
    inverse = 1.0 / (row[0] * row[2] - row[1] * row[1])
    # How x, y, a, b follow c along the valley of the likelihood: the part of the covariance that c makes.
    along = np.empty(5)
    along[0], along[2] = (row[2] * row[3] - row[1] * row[4]) * inverse, (row[0] * row[4] - row[1] * row[3]) * inverse
    along[1], along[3] = (row[2] * row[5] - row[1] * row[6]) * inverse, (row[0] * row[6] - row[1] * row[5]) * inverse
    info_c = row[7] - row[3] * along[0] - row[4] * along[2] - row[5] * along[1] - row[6] * along[3]
    along[2] += x0
    along[3] += y0
    along[4] = 1.0
    variance_c = 1.0 / max(info_c, 1e-300)
    for j in range(5):
        for k in range(5):
            cov[j, k] = along[j] * along[k] * variance_c
    cov[0, 0] += row[2] * inverse
    cov[1, 1] += row[2] * inverse
    cov[2, 2] += row[0] * inverse
    cov[3, 3] += row[0] * inverse
    cov[0, 2] -= row[1] * inverse
    cov[2, 0] -= row[1] * inverse
    cov[1, 3] -= row[1] * inverse
    cov[3, 1] -= row[1] * inverse
