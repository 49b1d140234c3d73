"""The image state (x, y, a, b, c) of points that move freely, each by all views of its track.

A track is counted from its newest position (x0, y0): that shifts the picture plane, keeps the form and saves digits.
"""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import ZERO, compiled, compiled_for
from ttcvid.geometry.kernels.windows import window_descent
from ttcvid.model import Floats, Ints

LEAST_FRAMES = 3
"""Views that the state needs; a window is never cut below them."""

# The depth of a point over that at time 0, 1 + c t, stays above this over the window; one step of c changes it by no
# more than 1 at the window's end. c about zero is expected with a standard deviation of 3 over the window: it decides
# where the views alone leave c open (two views, no flow), and nowhere else.
_LEAST_DEPTH_RATIO, _C_SIGMA = 0.1, 3.0
# Views that say less of c than this part of what is expected of it say nothing: what they say is rounding.
_LEAST_INFO = 1e-6
# Rows of ``views (4, M)``.
_X, _Y, _INVERSE, _TIME = range(4)
# Sums: of h^2 t^j, j = 0, 1, 2; couplings of x, a, y, b with c; information on c; scores; squared residuals.
_H, _HT, _HTT, _X_C, _A_C, _Y_C, _B_C, _INFO, _SCORE_X, _SCORE_A, _SCORE_Y, _SCORE_B, _SCORE_C, _SQUARES = range(14)

_Belief = tuple[Floats, Floats, Floats]
"""(prior of c, its limits (2), longest step, x0, y0), and of the plane of motion the ``normal (3,)`` and its
covariance, empty where there is none.
"""
_PRIOR, _LOW, _HIGH, _LONGEST, _X0, _Y0 = range(6)


@compiled_for(
    "(f8[:, :, ::1], f8[::1], f8[::1], i8[::1], Tuple((f8[::1], f8[::1])), Tuple((f8[::1], f8[:, ::1])), "
    "Tuple((f8[:, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[::1], i8[::1])))"
)
def fit_free_points(
    xy: Floats,
    t_s: Floats,
    sigma: Floats,
    order: Ints,
    gates: tuple[Floats, Floats],
    plane: tuple[Floats, Floats],
    found: tuple[Floats, Floats, Floats, Floats, Ints],
) -> None:
    """Fill the results ``found`` of `track_state.fit_whole_tracks`, track by track.

    ``order`` lists the views, nearest first, of which only so many are used as the first of the ``gates`` allows for,
    as in `windows`; the normal of the ``plane`` and its covariance are empty where there is none.
    """
    state, cov, info_w, chi2, n_frames = found
    normal, normal_cov = plane
    longest = len(gates[0]) - 1
    views, limits, work = np.empty((4, longest)), np.empty(6), (np.empty(14), np.empty(5))
    sums, s = np.empty(14), np.empty(5)
    for i in range(xy.shape[1]):
        if not sigma[i] > 0.0:
            continue
        m, first, last = ZERO, 0.0, 0.0
        for k in order:
            # A sum is finite where all of its terms are.
            if m < longest and np.isfinite(xy[k, i, 0] + xy[k, i, 1]):
                if m == 0:
                    limits[_X0], limits[_Y0] = xy[k, i, 0], xy[k, i, 1]
                views[_X, m], views[_Y, m] = xy[k, i, 0] - limits[_X0], xy[k, i, 1] - limits[_Y0]
                views[_INVERSE, m], views[_TIME, m] = 1.0 / sigma[i], t_s[k]
                first, last = min(first, t_s[k]), max(last, t_s[k])
                m += 1
        n_frames[i] = m
        if m < 2:
            continue
        span = max(last - first, 1e-12)
        limits[_PRIOR], limits[_LONGEST] = (span / _C_SIGMA) ** 2, 1.0 / span
        limits[_LOW] = -(1.0 - _LEAST_DEPTH_RATIO) / max(last, 1e-12)
        limits[_HIGH] = (1.0 - _LEAST_DEPTH_RATIO) / max(-first, 1e-12)
        belief = limits, normal, normal_cov
        s[:], sums[:] = 0.0, 0.0
        _add(views, ZERO, m, s, np.inf, 1.0, sums)
        _solve(sums, s, belief, work[1])
        for j in range(5):
            s[j] = work[1][j]
        n_frames[i], chi2[i] = _descend(views, m, LEAST_FRAMES, belief, gates, s, sums, work)
        _store(sums, s, limits, n_frames[i] >= LEAST_FRAMES, i, state, cov, info_w)


@compiled
def _add(views: Floats, first: int, stop: int, s: Floats, limit: float, sign: float, sums: Floats) -> None:
    """Add to ``sums (14,)``. With h = 1 / (1 + c t), d x(t) / d(x, a, c) = (h, h t, -h t x(t)).

    As `windows.window_descent` asks for. An infinite ``limit`` stands for the linear equations
    x + a t - x_i t c = x_i, with observed positions in the column of c.
    """
    is_linear = limit == np.inf
    h0 = h1 = h2 = x_c = a_c = y_c = b_c = info = score_x = score_a = score_y = score_b = score_c = squares = 0.0
    for k in range(np.uint64(first), np.uint64(stop)):
        inverse, t = views[_INVERSE, k], views[_TIME, k]
        h = 1.0 / (1.0 + s[4] * t)
        x, y = (s[0] + s[2] * t) * h, (s[1] + s[3] * t) * h
        rx, ry = (views[_X, k] - x) * inverse, (views[_Y, k] - y) * inverse
        square = rx * rx + ry * ry
        weight = 1.0 if is_linear else limit / max(square, limit)
        x, y = views[_X, k] if is_linear else x, views[_Y, k] if is_linear else y
        h *= inverse
        w, gx, gy = weight * h * h, weight * h * rx, weight * h * ry
        wt, along = w * t, gx * x + gy * y
        wtt = wt * t
        h0 += w
        h1 += wt
        h2 += wtt
        x_c += wt * x
        a_c += wtt * x
        y_c += wt * y
        b_c += wtt * y
        info += wtt * (x * x + y * y)
        score_x += gx
        score_a += gx * t
        score_y += gy
        score_b += gy * t
        score_c -= t * along
        squares += weight * square
    sums[_H] += sign * h0
    sums[_HT] += sign * h1
    sums[_HTT] += sign * h2
    sums[_X_C] += sign * x_c
    sums[_A_C] += sign * a_c
    sums[_Y_C] += sign * y_c
    sums[_B_C] += sign * b_c
    sums[_INFO] += sign * info
    sums[_SCORE_X] += sign * score_x
    sums[_SCORE_A] += sign * score_a
    sums[_SCORE_Y] += sign * score_y
    sums[_SCORE_B] += sign * score_b
    sums[_SCORE_C] += sign * score_c
    sums[_SQUARES] += sign * squares


@compiled
def _follow(sums: Floats, p: float, q: float) -> tuple[float, float]:
    """What (x, a) or (y, b) are for the right-hand side (p, q): the two share one 2 x 2 matrix."""
    inverse = 1.0 / (sums[_H] * sums[_HTT] - sums[_HT] * sums[_HT])
    return (sums[_HTT] * p - sums[_HT] * q) * inverse, (sums[_H] * q - sums[_HT] * p) * inverse


@compiled
def _solve(sums: Floats, s: Floats, belief: _Belief, step: Floats) -> float:
    """Fill the Gauss-Newton step ``(5,)`` of x, y, a, b, c; that of c goes half of the way to its limits at most.

    Returns by how much chi-square falls. (x, a) and (y, b) meet in c alone.
    """
    limits, c = belief[0], s[4]
    (x_c, a_c), (y_c, b_c) = _follow(sums, sums[_X_C], sums[_A_C]), _follow(sums, sums[_Y_C], sums[_B_C])
    x_0, a_0 = _follow(sums, sums[_SCORE_X], sums[_SCORE_A])
    y_0, b_0 = _follow(sums, sums[_SCORE_Y], sums[_SCORE_B])
    info = max(sums[_INFO] - sums[_X_C] * x_c - sums[_A_C] * a_c - sums[_Y_C] * y_c - sums[_B_C] * b_c, 0.0)
    score = sums[_SCORE_C] + sums[_X_C] * x_0 + sums[_A_C] * a_0 + sums[_Y_C] * y_0 + sums[_B_C] * b_0
    dc = (score - limits[_PRIOR] * c) / (info + limits[_PRIOR])
    dc = min(max(dc, -limits[_LONGEST], 0.5 * (limits[_LOW] - c)), limits[_LONGEST], 0.5 * (limits[_HIGH] - c))
    step[0], step[1], step[2], step[3], step[4] = x_0 + x_c * dc, y_0 + y_c * dc, a_0 + a_c * dc, b_0 + b_c * dc, dc
    fall: float = sums[_SCORE_X] * x_0 + sums[_SCORE_A] * a_0 + sums[_SCORE_Y] * y_0 + sums[_SCORE_B] * b_0
    fall += dc * (2.0 * score - info * dc)
    return fall


@compiled
def _solve_on_plane(sums: Floats, s: Floats, belief: _Belief, step: Floats) -> float:
    """The same step with ``normal . w = 0`` as one more observation, of one w = (a' + c x0, b' + c y0, c)."""
    limits, normal, cov = belief
    if len(normal) == 0:
        return _solve(sums, s, belief, step)
    by_c = normal[0] * limits[_X0] + normal[1] * limits[_Y0] + normal[2]
    a, b, c = s[2] + s[4] * limits[_X0], s[3] + s[4] * limits[_Y0], s[4]
    variance = 1e-12 + (
        a * (cov[0, 0] * a + cov[0, 1] * b + cov[0, 2] * c)
        + b * (cov[1, 0] * a + cov[1, 1] * b + cov[1, 2] * c)
        + c * (cov[2, 0] * a + cov[2, 1] * b + cov[2, 2] * c)
    )
    reach, towards = np.empty(5), sums.copy()
    towards[_SCORE_X] = towards[_SCORE_Y] = 0.0
    towards[_SCORE_A], towards[_SCORE_B], towards[_SCORE_C] = normal[0], normal[1], by_c
    anywhere = limits.copy()
    anywhere[_LOW], anywhere[_HIGH], anywhere[_LONGEST] = -np.inf, np.inf, np.inf
    _solve(towards, np.zeros(5), (anywhere, normal, cov), reach)
    _solve(sums, s, (anywhere, normal, cov), step)
    off = normal[0] * s[2] + normal[1] * s[3] + by_c * c
    miss = off + normal[0] * step[2] + normal[1] * step[3] + by_c * step[4]
    part = miss / (variance + normal[0] * reach[2] + normal[1] * reach[3] + by_c * reach[4])
    for j in range(5):
        step[j] -= part * reach[j]
    limit = min(max(step[4], -limits[_LONGEST], 0.5 * (limits[_LOW] - c)), limits[_LONGEST], 0.5 * (limits[_HIGH] - c))
    shorter = limit / step[4] if limit != step[4] else 1.0
    for j in range(5):
        step[j] *= shorter
    pull = off / variance
    fall: float = sums[_SCORE_X] * step[0] + sums[_SCORE_Y] * step[1] + (sums[_SCORE_C] - pull * by_c) * step[4]
    fall += (sums[_SCORE_A] - pull * normal[0]) * step[2] + (sums[_SCORE_B] - pull * normal[1]) * step[3]
    return fall


_descend = window_descent(_add, _solve, _solve_on_plane)


@compiled
def _store(
    sums: Floats, s: Floats, limits: Floats, has_cov: bool, i: int, state: Floats, cov: Floats, info_w: Floats
) -> None:
    """State, covariance and information of track i, moved back to the picture plane about its own origin.

    The covariance stays NaN where the views say next to nothing of c.
    """
    x0, y0 = limits[_X0], limits[_Y0]
    state[i, 0], state[i, 1] = s[0] + x0, s[1] + y0
    state[i, 2], state[i, 3], state[i, 4] = s[2] + s[4] * x0, s[3] + s[4] * y0, s[4]
    rest = 1.0 / sums[_H]
    info_aa = sums[_HTT] - sums[_HT] * sums[_HT] * rest
    info_ac, info_bc = sums[_HT] * sums[_X_C] * rest - sums[_A_C], sums[_HT] * sums[_Y_C] * rest - sums[_B_C]
    info_cc = sums[_INFO] - (sums[_X_C] * sums[_X_C] + sums[_Y_C] * sums[_Y_C]) * rest
    # a = a' + c x0: the information of (a', b', c), seen from (a, b, c).
    info_w[i, 0, 0] = info_w[i, 1, 1] = info_aa
    info_w[i, 0, 2] = info_w[i, 2, 0] = info_ac - info_aa * x0
    info_w[i, 1, 2] = info_w[i, 2, 1] = info_bc - info_aa * y0
    info_w[i, 2, 2] = info_cc - 2.0 * (info_ac * x0 + info_bc * y0) + info_aa * (x0 * x0 + y0 * y0)
    if not has_cov:
        return
    # How x, y, a, b follow c along the valley of the likelihood: the part of the covariance that c makes.
    (x_c, a_c), (y_c, b_c) = _follow(sums, sums[_X_C], sums[_A_C]), _follow(sums, sums[_Y_C], sums[_B_C])
    info_c = sums[_INFO] - sums[_X_C] * x_c - sums[_A_C] * a_c - sums[_Y_C] * y_c - sums[_B_C] * b_c
    if not info_c > _LEAST_INFO * limits[_PRIOR]:
        return
    along = (x_c, y_c, a_c + x0, b_c + y0, 1.0)
    for j in range(5):
        for k in range(5):
            cov[i, j, k] = along[j] * along[k] / info_c
    inverse = 1.0 / (sums[_H] * sums[_HTT] - sums[_HT] * sums[_HT])
    for j in range(2):
        cov[i, j, j] += sums[_HTT] * inverse
        cov[i, 2 + j, 2 + j] += sums[_H] * inverse
        cov[i, j, 2 + j] -= sums[_HT] * inverse
        cov[i, 2 + j, j] -= sums[_HT] * inverse
