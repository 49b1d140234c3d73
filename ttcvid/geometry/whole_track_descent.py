"""The inner loops of `whole_track`: robust Gauss-Newton on the image state of each track, compiled.

All arrays that a function fills are arguments of it. A track is counted from its newest position (x0, y0): that shifts
the picture plane, keeps the path's form, and saves digits.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
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
TAIL = 3
# The depth of a point over that at time 0, 1 + c t, stays above this over the window; one step of c changes it by no
# more than 1 at the window's end. c about zero is expected with a standard deviation of 3 over the window: it decides
# where the views alone leave c open (two views, no flow), and nowhere else.
_LEAST_DEPTH_RATIO, _C_SIGMA = 0.1, 3.0
# Views that say less of c than this part of what is expected of it say nothing: what they say is rounding.
_LEAST_INFO = 1e-6
# Columns of the sums below.
_N_SUMS = 14


@compiled_for(
    "(f8[:, :, ::1], f8[::1], f8[::1], i8[::1], i8, f8[::1], f8[::1], f8[::1], f8[:, ::1], f8[:, ::1], "
    "f8[:, :, ::1], f8[:, :, ::1], f8[::1], i8[::1])"
)
def fit_each(
    xy: Floats,
    t_s: Floats,
    sigma: Floats,
    order: Ints,
    longest: int,
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
    """Fill the results of `whole_track.fit_whole_tracks`, track by track.

    ``order`` lists the views, nearest first, of which at most ``longest`` are used; ``gates`` and ``tail_gates`` are
    those of `whole_track.window_gates`; ``normal`` and ``normal_cov`` of the plane are empty where there is none,
    ``cov`` where it is not asked for.
    """
    t, px, py = np.empty(longest), np.empty(longest), np.empty(longest)
    sums = np.zeros((longest + 1, _N_SUMS))
    s, step, step_near = np.empty(5), np.empty(5), np.empty(5)
    for i in range(xy.shape[1]):
        if not sigma[i] > 0.0:
            continue
        m = 0
        for place in order:
            if m == longest:
                break
            # A sum is finite where all of its terms are.
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
        n = m
        s[:] = 0.0
        _add_up(t, px, py, m, s, inverse, True, sums)
        _solve(sums[m], prior, s[4], c_low, c_high, 1.0 / span, step)
        s += step
        for count in range(_MAX_STEPS):
            n = m if count < _WINDOW_STEPS else n
            _add_up(t, px, py, n, s, inverse, False, sums)
            fall = _solve(sums[n], prior, s[4], c_low, c_high, 1.0 / span, step)
            while n > LEAST_FRAMES:
                whole = sums[n, 13] - fall
                if whole <= gates[n]:
                    k = max(n - TAIL, LEAST_FRAMES)
                    near = sums[k, 13] - _solve(sums[k], prior, s[4], c_low, c_high, 1.0 / span, step_near)
                    if whole - near <= tail_gates[n - k]:
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
        _store(sums[n], n, s, x0, y0, _LEAST_INFO * prior, i, state, cov, info_w)


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
def _store(
    row: Floats,
    n: int,
    s: Floats,
    x0: float,
    y0: float,
    least_info_c: float,
    i: int,
    state: Floats,
    cov: Floats,
    info_w: Floats,
) -> None:
    """State, covariance and information of track i, moved back to the picture plane about its own origin.

    The covariance stays NaN where the views say less of c than ``least_info_c``; ``cov (N, 5, 5)`` may be empty.
    """
    state[i, 0], state[i, 1] = s[0] + x0, s[1] + y0
    state[i, 2], state[i, 3], state[i, 4] = s[2] + s[4] * x0, s[3] + s[4] * y0, s[4]
    rest = 1.0 / row[0]
    info_aa = row[2] - row[1] * row[1] * rest
    info_ac, info_bc = row[1] * row[3] * rest - row[4], row[1] * row[5] * rest - row[6]
    info_cc = row[7] - (row[3] * row[3] + row[5] * row[5]) * rest
    # a = a' + c x0: the information of (a', b', c), seen from (a, b, c).
    info_w[i, 0, 0] = info_w[i, 1, 1] = info_aa
    info_w[i, 0, 2] = info_w[i, 2, 0] = info_ac - info_aa * x0
    info_w[i, 1, 2] = info_w[i, 2, 1] = info_bc - info_aa * y0
    info_w[i, 2, 2] = info_cc - 2.0 * (info_ac * x0 + info_bc * y0) + info_aa * (x0 * x0 + y0 * y0)
    if n < LEAST_FRAMES or len(cov) == 0:
        return
    inverse = 1.0 / (row[0] * row[2] - row[1] * row[1])
    # How x, y, a, b follow c along the valley of the likelihood: the part of the covariance that c makes.
    along = np.empty(5)
    along[0], along[2] = (row[2] * row[3] - row[1] * row[4]) * inverse, (row[0] * row[4] - row[1] * row[3]) * inverse
    along[1], along[3] = (row[2] * row[5] - row[1] * row[6]) * inverse, (row[0] * row[6] - row[1] * row[5]) * inverse
    info_c = row[7] - row[3] * along[0] - row[4] * along[2] - row[5] * along[1] - row[6] * along[3]
    if not info_c > least_info_c:
        return
    along[2] += x0
    along[3] += y0
    along[4] = 1.0
    variance_c = 1.0 / info_c
    for j in range(5):
        for k in range(5):
            cov[i, j, k] = along[j] * along[k] * variance_c
    cov[i, 0, 0] += row[2] * inverse
    cov[i, 1, 1] += row[2] * inverse
    cov[i, 2, 2] += row[0] * inverse
    cov[i, 3, 3] += row[0] * inverse
    cov[i, 0, 2] -= row[1] * inverse
    cov[i, 2, 0] -= row[1] * inverse
    cov[i, 1, 3] -= row[1] * inverse
    cov[i, 3, 1] -= row[1] * inverse
