"""The inner loops of `shared_trajectory`: Gauss-Newton on K paths and on places and rates of their points, compiled.

All arrays that a function fills are arguments of it. Points stand in order of their paths: those of path k are
``first[k] ... first[k + 1] - 1``. What the points of a path share is counted in the axes ``basis (3, 3)`` of the
path, whose last column is its believed direction: u along the first two (a speed is no unknown), v along all three,
and a rotation rate about x, y, z of the camera: `N_LOCAL` unknowns.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.geometry.kernels.arrays import copy, copy_rows
from ttcvid.geometry.kernels.medians import median
from ttcvid.geometry.kernels.solve import solve
from ttcvid.model import Floats, Ints

N_LOCAL = 8
"""Unknowns that the points of a path share."""

LEAST_VIEWS = 3
"""Fewer views say nothing of a path beside the place and the rate of their point."""

# Joint steps end after so many, or after one shorter than this (squared, in sigmas of the estimate).
_MAX_STEPS, _CONVERGED_CHI2 = 6, 0.1
# A point whose window has less than this part of its views, over the same of the median point, is left out.
_LOYAL_SHARE = 0.7
# As in the fit of each point (`whole_track_on_path`), weights 1 / r^2 too; a compiled function may not call its file.
_ROBUST_SIGMAS, _LEAST_DEPTH_RATIO = 3.0, 0.1
# Views of a point are worked at so many at a time, as fits the processor's registers; what is left over stands before
# the first view, so that a track of few views, the last ones, needs few of them.
_LANES = 8
# Numbers of a view: the rotation that turns it back (9), where the thing was (3), the time.
_N_WAY, _TIME = 13, 12
# Sums are made of u (3), v (3) and the rotation rate (3) in the axes of the camera, where most of their products are
# alike or nothing; `_project` goes over to the axes of the path.
_N_CAMERA = 9
# Kept of a point while what it shares is solved for, (4, 9): couplings of x, y and rho with what is shared; last the
# information on its place, couplings of x and y with rho, information on rho, score of x, y, rho, squared residuals.
_OWN = 3

_Points = tuple[Floats, Floats, Floats, Ints, Ints, Ints]
"""Views ``xy (L, N, 2)`` of the times ``t_s (L,)``, with the noise ``sigma (N,)``; point i is seen at the times
``seen[i, : n_views[i]]``, nearest first; the points of path k begin at ``first[k]``, ``(K + 1,)``.
"""


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], f8[::1], i8[:, ::1], i8[::1], i8[::1])), f8[:, :, ::1], f8[:, :, ::1], "
    "f8[:, ::1], f8[::1])"
)
def start_points(points: _Points, base: Floats, basis: Floats, state: Floats, relative: Floats) -> None:
    """Fills ``state (N, 3)`` (x, y, rho) on believed paths ``base (K, L, 3)``, and the mean square residuals (N,)."""
    xy, t_s, sigma, seen, n_views, first = points
    n_lanes = -(-len(t_s) // _LANES) * _LANES
    way, views, before = np.zeros((_N_WAY, n_lanes)), np.empty((xy.shape[1], 2, n_lanes)), n_lanes - len(t_s)
    nothing = np.zeros(N_LOCAL)
    for k in range(len(first) - 1):
        _set_way(t_s, base[k], basis[k], nothing, way)
        for i in range(first[k], first[k + 1]):
            _list_views(xy, i, seen, n_views[i], views)
            relative[i] = _start(views, way, i, before, seen, n_views[i], sigma[i], state)


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], f8[::1], i8[:, ::1], i8[::1], i8[::1])), f8[:, :, ::1], f8[:, :, ::1], "
    "f8[:, :, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[:, ::1])"
)
def descend_together(
    points: _Points,
    base: Floats,
    basis: Floats,
    believed: Floats,
    state: Floats,
    relative: Floats,
    offset: Floats,
    left: Floats,
) -> None:
    """Paths and points together, over all views: ``state (N, 3)`` (x, y, rho) and its mean square residual in and out.

    Fills ``offset (K, 8)``; and ``left (K, 2)``, before the last step: sum of squared residuals in sigmas, none counted
    for more than the robust limit, and the points' median by the degree of freedom.

    No view is cut off: a believed path may be wrong by hundreds of sigmas at its far end, where a window would end at
    once and nothing be learned of it. A view loses weight beyond three times the usual residual of its path's points.

    Parameters
    ----------
    base : (K, L, 3) believed paths; ``believed (K, 8, 8)`` information on offsets from them.
    """
    xy, t_s, sigma, seen, n_views, first = points
    n, n_lanes = xy.shape[1], -(-len(t_s) // _LANES) * _LANES
    before = n_lanes - len(t_s)
    way, views, begin = np.zeros((_N_WAY, n_lanes)), np.empty((n, 2, n_lanes)), np.empty(n, dtype=np.int64)
    information, score, step = np.empty((N_LOCAL, N_LOCAL)), np.empty(N_LOCAL), np.empty(N_LOCAL)
    sums, kept, moved = np.empty((_N_CAMERA + 1, _N_CAMERA)), np.empty((n, _OWN + 1, _N_CAMERA)), np.empty(_N_CAMERA)
    for k in range(len(first) - 1):
        low, high, axes = first[k], first[k + 1], basis[k]
        offset[k], left[k] = 0.0, 0.0
        if low == high:
            continue
        _set_way(t_s, base[k], axes, offset[k], way)
        for i in range(low, high):
            begin[i] = _list_views(xy, i, seen, n_views[i], views)
        usual = median(relative[low:high].copy())
        for _ in range(_MAX_STEPS):
            misfit = max(1.0, np.sqrt(usual))
            limit = (_ROBUST_SIGMAS * misfit) ** 2
            sums[:] = 0.0
            for i in range(low, high):
                slowest, fastest = _rate_limits(way, i, before, seen, n_views[i])
                if not slowest < state[i, 2] < fastest:
                    _start(views, way, i, before, seen, n_views[i], sigma[i], state)
                relative[i] = _add_point(views, begin[i], way, i, state, sigma[i], limit, kept, sums)
            usual = median(relative[low:high].copy())
            left[k, 0], left[k, 1] = 0.0, usual
            for i in range(low, high):
                left[k, 0] += kept[i, _OWN, 7]
            # What the belief says at an offset from it.
            copy_rows(believed[k], information)
            score[:] = 0.0
            for j in range(N_LOCAL):
                for m in range(N_LOCAL):
                    score[j] -= believed[k, j, m] * offset[k, m]
            _project(sums, axes, information, score)
            copy(score, step)
            fall = solve(information, step)
            offset[k] += step
            _set_way(t_s, base[k], axes, offset[k], way)
            _in_camera(axes, step, moved)
            for i in range(low, high):
                _follow(i, kept, moved, state)
            if fall < _CONVERGED_CHI2 * misfit * misfit:
                break


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], f8[::1], i8[:, ::1], i8[::1], i8[::1])), f8[:, :, ::1], f8[:, :, ::1], "
    "i8[::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1])"
)
def add_up_windows(
    points: _Points, path: Floats, basis: Floats, n_frames: Ints, state: Floats, information: Floats, score: Floats
) -> None:
    """Adds what the windows ``n_frames (N,)`` of all points say: ``information (K, 8, 8)``, ``score (K, 8)``.

    Points that leave their path much sooner than others do move otherwise, and are left out. Views are turned back,
    ``path (K, L, 3)`` are the paths at which the points were fitted.
    """
    xy, t_s, sigma, seen, n_views, first = points
    n_points, n_lanes, limit = len(sigma), -(-len(t_s) // _LANES) * _LANES, _ROBUST_SIGMAS * _ROBUST_SIGMAS
    way, views, nothing = np.zeros((_N_WAY, n_lanes)), np.empty((n_points, 2, n_lanes)), np.zeros(N_LOCAL)
    sums, kept, share = np.empty((_N_CAMERA + 1, _N_CAMERA)), np.empty((n_points, 4, _N_CAMERA)), n_frames / n_views
    for k in range(len(first) - 1):
        low, high = first[k], first[k + 1]
        if low == high:
            continue
        least = _LOYAL_SHARE * median(share[low:high].copy())
        _set_way(t_s, path[k], basis[k], nothing, way)
        sums[:] = 0.0
        for i in range(low, high):
            if share[i] >= least and n_frames[i] >= LEAST_VIEWS and np.isfinite(state[i, 2]):
                begin = _list_views(xy, i, seen, n_frames[i], views)
                _add_point(views, begin, way, i, state, sigma[i], limit, kept, sums)
        _project(sums, basis[k], information[k], score[k])


@compiled
def _list_views(xy: Floats, i: int, seen: Ints, n: int, views: Floats) -> int:
    """Fills ``views[i] (2, M)`` with the first n of the views ``xy (L, N, 2)`` of point i; NaN: not seen.

    Returns where the first lanes begin in which there are any.
    """
    before, first = views.shape[2] - len(xy), views.shape[2]
    for k in range(views.shape[2]):
        views[i, 0, k] = views[i, 1, k] = np.nan
    for nearest in range(n):
        k = seen[i, nearest]
        views[i, 0, before + k], views[i, 1, before + k] = xy[k, i, 0], xy[k, i, 1]
        first = min(first, before + k)
    begin: int = first // _LANES * _LANES
    return begin


@compiled
def _add_point(
    views: Floats, begin: int, way: Floats, i: int, state: Floats, sigma: float, far: float, kept: Floats, sums: Floats
) -> float:
    """Adds what the views of point i say of what it shares, once x, y, rho follow; returns the mean square residual.

    With h = 1 / (1 + rho T_z), d x / d(x, rho, T) = h (1, T_x - x T_z, rho (1, 0, -x)); T follows u as t and v as
    t^2 / 2; a turn left in the views by t moves them as the ray (x, y, 1) does. The sums of x, y, rho are those of
    `kernels.path_point`.

    Adds to ``sums (10, 9)`` the information on what is shared, its lower half, and in the last row the score, less what
    x, y, rho take of these when they follow (Schur complement). No information on rho adds nothing. Fills ``kept[i]``
    with the sums of rho after x and y are eliminated.
    """
    sx, sy, rho, inverse = state[i, 0], state[i, 1], state[i, 2], 1.0 / sigma
    i00 = i02 = i12 = i22 = p0 = p1 = p2 = total = squares = n = 0.0
    g0 = g1 = g2 = g3 = g4 = g5 = g6 = g7 = g8 = g9 = g10 = g11 = 0.0
    c0 = c1 = c2 = c3 = c4 = c5 = c6 = c7 = c8 = c9 = c10 = c11 = c12 = c13 = 0.0
    r00 = r10 = r11 = r20 = r21 = r22 = s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = 0.0
    a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = a8 = a9 = a10 = b0 = b1 = b2 = b3 = b4 = b5 = b6 = b7 = b8 = 0.0
    # Without a branch, and by an index without a sign: one that may count from the end takes the lanes apart.
    for k in range(np.uint64(begin), np.uint64(views.shape[2])):
        seen_x, seen_y, t, tx, ty, tz = views[i, 0, k], views[i, 1, k], way[_TIME, k], way[9, k], way[10, k], way[11, k]
        is_seen = np.isfinite(seen_x)
        ahead = 1.0 / (way[6, k] * seen_x + way[7, k] * seen_y + way[8, k])
        # Where the point is seen, its rate keeps the depth from this limit.
        h = 1.0 / max(1.0 + rho * tz, 0.5 * _LEAST_DEPTH_RATIO)
        x, y = (sx + rho * tx) * h, (sy + rho * ty) * h
        rx = ((way[0, k] * seen_x + way[1, k] * seen_y + way[2, k]) * ahead - x) * inverse if is_seen else 0.0
        ry = ((way[3, k] * seen_x + way[4, k] * seen_y + way[5, k]) * ahead - y) * inverse if is_seen else 0.0
        square = rx * rx + ry * ry
        weight = far / max(square, far) if is_seen else 0.0
        n += 1.0 if is_seen else 0.0
        total += weight * square
        squares += min(square, _ROBUST_SIGMAS * _ROBUST_SIGMAS)
        a, half, turned = h * inverse, 0.5 * t, inverse * t
        jx, jy, g = a * (tx - x * tz), a * (ty - y * tz), rho * a * t
        wa, wx, wy, wjx, wjy = weight * a, weight * rx, weight * ry, weight * jx, weight * jy
        i00, i02, i12, i22 = i00 + wa * a, i02 + wa * jx, i12 + wa * jy, i22 + wjx * jx + wjy * jy
        p0, p1, p2 = p0 + wa * rx, p1 + wa * ry, p2 + jx * wx + jy * wy
        xx, yy, xy, both, quarter = 1.0 + x * x, 1.0 + y * y, x * y, x * x + y * y, half * half
        m = weight * g * g
        mx, my, mb = m * x, m * y, m * both
        g0, g1, g2, g3 = g0 + m, g1 + mx, g2 + my, g3 + mb
        g4, g5, g6, g7 = g4 + half * m, g5 + half * mx, g6 + half * my, g7 + half * mb
        g8, g9, g10, g11 = g8 + quarter * m, g9 + quarter * mx, g10 + quarter * my, g11 + quarter * mb
        c = weight * g * turned
        cxy, cxx, cyy, cx, cy = c * xy, c * xx, c * yy, c * x, c * y
        cbx, cby = cx * (1.0 + both), cy * (1.0 + both)
        c0, c1, c2, c3, c4, c5, c6 = c0 + cxy, c1 + cxx, c2 + cyy, c3 + cx, c4 + cy, c5 + cbx, c6 + cby
        c7, c8, c9, c10 = c7 + half * cxy, c8 + half * cxx, c9 + half * cyy, c10 + half * cx
        c11, c12, c13 = c11 + half * cy, c12 + half * cbx, c13 + half * cby
        r = weight * turned * turned
        r00, r10 = r00 + r * (xy * xy + yy * yy), r10 - r * xy * (xx + yy)
        r11, r20 = r11 + r * (xx * xx + xy * xy), r20 - r * x
        r21, r22 = r21 - r * y, r22 + r * both
        sgx, sgy = g * wx, g * wy
        sgz = -(x * sgx + y * sgy)
        s0, s1, s2, s3, s4, s5 = s0 + sgx, s1 + sgy, s2 + sgz, s3 + half * sgx, s4 + half * sgy, s5 + half * sgz
        s6 -= turned * (xy * wx + yy * wy)
        s7 += turned * (xx * wx + xy * wy)
        s8 += turned * (x * wy - y * wx)
        wag, wat = wa * g, wa * turned
        wagx, wagy = wag * x, wag * y
        a0, a1, a2, a3, a4, a5 = a0 + wag, a1 + wagx, a2 + wagy, a3 + half * wag, a4 + half * wagx, a5 + half * wagy
        a6, a7, a8, a9, a10 = a6 + wat * xy, a7 + wat * xx, a8 + wat * yy, a9 + wat * x, a10 + wat * y
        bgx, bgy = g * wjx, g * wjy
        bgz = -(x * bgx + y * bgy)
        b0, b1, b2, b3, b4, b5 = b0 + bgx, b1 + bgy, b2 + bgz, b3 + half * bgx, b4 + half * bgy, b5 + half * bgz
        b6 -= turned * (xy * wjx + yy * wjy)
        b7 += turned * (xx * wjx + xy * wjy)
        b8 += turned * (x * wjy - y * wjx)
    rest = 1.0 / i00
    i02r, i12r = i02 * rest, i12 * rest
    known = i22 - i02 * i02r - i12 * i12r
    is_known = known > 0.0
    p2 -= i02r * p0 + i12r * p1
    own = (i00, i02, i12, known if is_known else 0.0, p0, p1, p2, squares, 0.0)
    by_x, by_y = (a0, 0.0, -a1, a3, 0.0, -a4, -a6, a7, -a10), (0.0, a0, -a2, 0.0, a3, -a5, -a8, a6, a9)
    by_rho, scores = (b0, b1, b2, b3, b4, b5, b6, b7, b8), (s0, s1, s2, s3, s4, s5, s6, s7, s8)
    for j in range(_N_CAMERA):
        kept[i, 0, j], kept[i, 1, j], kept[i, _OWN, j] = by_x[j], by_y[j], own[j]
        kept[i, 2, j] = by_rho[j] - i02r * by_x[j] - i12r * by_y[j]
    if is_known:
        of_u = (g0, 0.0, g0, -g1, -g2, g3)
        of_v = (g4, 0.0, -g5, g8, 0.0, g4, -g6, 0.0, g8, -g5, -g6, g7, -g9, -g10, g11)
        of_x, of_y = (-c0, -c2, c6, -c7, -c9, c13, r00), (c1, c0, -c5, c8, c7, -c12, r10, r11)
        whole, place = (*of_u, *of_v, *of_x, *of_y, -c4, c3, 0.0, -c11, c10, 0.0, r20, r21, r22), 0
        for j in range(_N_CAMERA):
            along_x, along_y, along = kept[i, 0, j] * rest, kept[i, 1, j] * rest, kept[i, 2, j] / known
            for k in range(_N_CAMERA):
                sums[j, k] -= along_x * kept[i, 0, k] + along_y * kept[i, 1, k] + along * kept[i, 2, k]
            for k in range(j + 1):
                sums[j, k] += whole[place]
                place += 1
            sums[_N_CAMERA, j] += scores[j] - along_x * p0 - along_y * p1 - along * p2
    return total / (2.0 * n - 3.0)


@compiled
def _project(sums: Floats, basis: Floats, information: Floats, score: Floats) -> None:
    """Adds to ``information (8, 8)`` and ``score (8,)`` what the sums of all points say, in the axes of their path."""
    half, into = np.zeros((_N_CAMERA, N_LOCAL)), np.zeros((_N_CAMERA, N_LOCAL))
    for j in range(3):
        into[j, 0], into[j, 1], into[6 + j, 5 + j] = basis[j, 0], basis[j, 1], 1.0
        for k in range(3):
            into[3 + j, 2 + k] = basis[j, k]
    for m in range(_N_CAMERA):
        for n in range(_N_CAMERA):
            for k in range(N_LOCAL):
                half[m, k] += sums[max(m, n), min(m, n)] * into[n, k]
    for m in range(_N_CAMERA):
        for j in range(N_LOCAL):
            score[j] += into[m, j] * sums[_N_CAMERA, m]
            for k in range(N_LOCAL):
                information[j, k] += into[m, j] * half[m, k]


@compiled
def _in_camera(basis: Floats, local: Floats, camera: Floats) -> None:
    """Fills ``camera (9,)``: shared unknowns ``local (8,)``, those of the path's axes in the camera's."""
    for j in range(3):
        camera[j] = basis[j, 0] * local[0] + basis[j, 1] * local[1]
        camera[3 + j] = basis[j, 0] * local[2] + basis[j, 1] * local[3] + basis[j, 2] * local[4]
        camera[6 + j] = local[5 + j]


@compiled
def _follow(i: int, kept: Floats, step: Floats, state: Floats) -> None:
    """Moves point i by its own part of a joint step: what was eliminated, put back."""
    x, y, rate, known = kept[i, _OWN, 4], kept[i, _OWN, 5], kept[i, _OWN, 6], kept[i, _OWN, 3]
    for j in range(_N_CAMERA):
        x -= kept[i, 0, j] * step[j]
        y -= kept[i, 1, j] * step[j]
        rate -= kept[i, 2, j] * step[j]
    rate, rest = (rate / known, 1.0 / kept[i, _OWN, 0]) if known > 0.0 else (0.0, 0.0)
    state[i, 0] += (x - kept[i, _OWN, 1] * rate) * rest
    state[i, 1] += (y - kept[i, _OWN, 2] * rate) * rest
    state[i, 2] += rate


@compiled
def _start(views: Floats, way: Floats, i: int, before: int, seen: Ints, n: int, sigma: float, state: Floats) -> float:
    """Fills ``state[i]`` by the linear solve of x + rho (T_x - x_i T_z) = x_i; returns its mean square residual."""
    x0, y0 = _turned(views, way, i, before + seen[i, 0])
    slowest, fastest = _rate_limits(way, i, before, seen, n)
    sum_x, sum_y, sum_jj, right_x, right_y, right, total, rest = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / n
    for nearest in range(n):
        k = before + seen[i, nearest]
        x, y = _turned(views, way, i, k)
        jx, jy = way[9, k] - x * way[11, k], way[10, k] - y * way[11, k]
        x, y = x - x0, y - y0
        sum_x += jx
        sum_y += jy
        sum_jj += jx * jx + jy * jy
        right_x += x
        right_y += y
        right += jx * x + jy * y
        total += x * x + y * y
    information = sum_jj - (sum_x * sum_x + sum_y * sum_y) * rest
    along = right - (sum_x * right_x + sum_y * right_y) * rest
    rate = along / information if information > 0.0 else 0.0
    held = min(max(rate, 0.5 * slowest), 0.5 * fastest)
    state[i, 0], state[i, 1] = x0 + (right_x - sum_x * held) * rest, y0 + (right_y - sum_y * held) * rest
    state[i, 2] = held
    total -= (right_x * right_x + right_y * right_y) * rest + rate * along
    return max(total, 0.0) / (sigma * sigma * (2 * n - 3))


@compiled
def _turned(views: Floats, way: Floats, i: int, k: int) -> tuple[float, float]:
    """View k of point i, turned back."""
    x, y = views[i, 0, k], views[i, 1, k]
    ahead = 1.0 / (way[6, k] * x + way[7, k] * y + way[8, k])
    return (way[0, k] * x + way[1, k] * y + way[2, k]) * ahead, (way[3, k] * x + way[4, k] * y + way[5, k]) * ahead


@compiled
def _rate_limits(way: Floats, i: int, before: int, seen: Ints, n: int) -> tuple[float, float]:
    """Rates between which the first n views of point i are in front of the camera."""
    nearest, farthest = 0.0, 0.0
    for view in range(n):
        depth = way[11, before + seen[i, view]]
        nearest, farthest = min(nearest, depth), max(farthest, depth)
    return -(1.0 - _LEAST_DEPTH_RATIO) / max(farthest, 1e-12), (1.0 - _LEAST_DEPTH_RATIO) / max(-nearest, 1e-12)


@compiled
def _set_way(t_s: Floats, base: Floats, basis: Floats, offset: Floats, way: Floats) -> None:
    """Fills ``way (13, M)`` at an offset from the path ``base (L, 3)``; 0 where that is not known.

    The rotations are `rotation.rotation_from_vector` of minus t times the rate.
    """
    wx, wy, wz = offset[5], offset[6], offset[7]
    rate = np.sqrt(wx * wx + wy * wy + wz * wz)
    before = way.shape[1] - len(t_s)
    for place in range(len(t_s)):
        k, t = before + place, t_s[place]
        for j in range(3):
            way[9 + j, k] = base[place, j] if np.isfinite(base[place, j]) else 0.0
            for m in range(3):
                u = offset[m] if m < 2 else 0.0
                way[9 + j, k] += basis[j, m] * (t * u + 0.5 * t * t * offset[2 + m])
        sine = np.sin(rate * t) / rate if rate > 0.0 else t
        half = np.sin(0.5 * rate * t) / rate if rate > 0.0 else 0.5 * t
        versed = 2.0 * half * half
        way[0, k], way[4, k] = 1.0 - versed * (wy * wy + wz * wz), 1.0 - versed * (wx * wx + wz * wz)
        way[8, k], way[_TIME, k] = 1.0 - versed * (wx * wx + wy * wy), t
        way[1, k], way[3, k] = versed * wx * wy + sine * wz, versed * wx * wy - sine * wz
        way[2, k], way[6, k] = versed * wx * wz - sine * wy, versed * wx * wz + sine * wy
        way[5, k], way[7, k] = versed * wy * wz + sine * wx, versed * wy * wz - sine * wx
