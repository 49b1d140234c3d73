"""Points that share a path: Gauss-Newton on K paths and on the place and inverse depth of each of their points.

What the points of a path share is counted in its own axes ``basis (3, 3)``, whose last column is its believed
direction: an offset ``u t + v t^2 / 2 + w t^3 / 6`` with u along the first two (a speed is no unknown), v and w along
all three, and a rotation rate of the views about x, y, z of the camera.
"""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled, compiled_for
from ttcvid.geometry.kernels import path_point as point
from ttcvid.geometry.kernels.known_path import list_views
from ttcvid.geometry.kernels.medians import median
from ttcvid.geometry.kernels.normal_equations import add_equations
from ttcvid.geometry.kernels.rotations import fill_rotation
from ttcvid.geometry.kernels.solve import eliminate, follow, solve
from ttcvid.model import Floats, Ints

N_LOCAL = 11
"""Unknowns that the points of a path share."""

# Unknowns of a point, and of it and its path together.
_N_OWN, _N_ALL = 3, 3 + N_LOCAL
# Joint steps end after so many, or after one shorter than this (squared, in sigmas of the estimate).
_MAX_STEPS, _CONVERGED_CHI2 = 6, 0.1
# A square counts for no more than this beside a misfit of one.
_LIMIT = point.ROBUST_SIGMAS**2

_Points = tuple[Floats, Floats, Floats, Ints, Ints]
"""Views ``xy (L, N, 2)``, NaN where not seen, of the times ``t_s (L,)``, with the noise ``sigma (N,)``; ``order (L,)``
lists the views, nearest first; the points of path k are ``first[k] ... first[k + 1] - 1``, ``(K + 1,)``.
"""


@compiled_for("(Tuple((f8[:, :, ::1], f8[::1], f8[::1], i8[::1], i8[::1])), f8[:, :, ::1], f8[:, ::1], f8[::1])")
def start_points(points: _Points, paths: Floats, state: Floats, mean_square: Floats) -> None:
    """Fill ``state (N, 3)`` (x, y, rho) on ``paths (K, L, 3)`` by a linear solve, and mean square residuals (N,)."""
    xy, t_s, sigma, order, first = points
    views, limits = np.empty((point.N_ROWS, len(t_s))), np.empty(2)
    for k in range(len(paths)):
        for i in range(first[k], first[k + 1]):
            n = list_views(xy, t_s, order, paths[k], 1.0 / sigma[i], i, views, limits)
            mean_square[i] = point.start(views, n, limits, state[i]) / (sigma[i] * sigma[i] * (2 * n - 3))


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], f8[::1], i8[::1], i8[::1])), f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], "
    "f8[:, ::1], f8[::1], f8[:, ::1], f8[:, ::1])"
)
def descend_together(
    points: _Points,
    base: Floats,
    basis: Floats,
    believed: Floats,
    state: Floats,
    mean_square: Floats,
    offset: Floats,
    left: Floats,
) -> None:
    """Paths and points together, over all views: ``state (N, 3)`` and its mean square residual in and out.

    Fills ``offset (K, 11)`` from the paths ``base (K, L, 3)``, of which ``believed (K, 11, 11)`` is the information;
    and ``left (K, 2)``, before the last step: sum of squared residuals in sigmas, none counted for more than the robust
    limit, and the points' median by the degree of freedom.

    No view is cut off: a believed path may be wrong by hundreds of sigmas at its far end, where a window would end at
    once and nothing be learned of it. A view loses weight beyond three times the usual residual of its path's points.
    """
    xy, t_s, sigma, order, first = points
    path, rotations, turned = np.empty((len(t_s), 3)), np.empty((len(t_s), 3, 3)), np.empty((len(t_s), 1, 2))
    views, limits = np.empty((point.N_ROWS, len(t_s))), np.empty(2)
    work = np.empty((_N_ALL + 1, 2 * len(t_s))), np.empty((_N_ALL + 1, _N_ALL))
    kept = np.empty((len(sigma), _N_OWN, _N_ALL + 1))
    information, step = np.empty((N_LOCAL, N_LOCAL)), np.empty(_N_ALL)
    score = step[_N_OWN:]
    for k in range(len(base)):
        offset[k], left[k] = 0.0, 0.0
        low, high = first[k], first[k + 1]
        if low == high:
            continue
        median_chi2 = median(mean_square[low:high].copy())
        for _ in range(_MAX_STEPS):
            noise = max(1.0, np.sqrt(median_chi2))
            # The path at the offset, and the rotations back to time 0.
            for m in range(len(t_s)):
                t = t_s[m]
                fill_rotation(-t * offset[k, 8], -t * offset[k, 9], -t * offset[k, 10], rotations[m])
                for j in range(3):
                    path[m, j] = base[k, m, j] + t * (basis[k, j, 0] * offset[k, 0] + basis[k, j, 1] * offset[k, 1])
                    for c in range(3):
                        path[m, j] += 0.5 * t * t * basis[k, j, c] * (offset[k, 2 + c] + t / 3.0 * offset[k, 5 + c])
            # What the belief says at an offset from it.
            left[k, 0], score[:] = 0.0, 0.0
            for c in range(N_LOCAL):
                for d in range(N_LOCAL):
                    information[c, d] = believed[k, c, d]
                    score[c] -= believed[k, c, d] * offset[k, d]
            for i in range(low, high):
                for m in range(len(t_s)):
                    x, y, r = xy[m, i, 0], xy[m, i, 1], rotations[m]
                    ahead = 1.0 / (r[2, 0] * x + r[2, 1] * y + r[2, 2])
                    turned[m, 0, 0] = (r[0, 0] * x + r[0, 1] * y + r[0, 2]) * ahead
                    turned[m, 0, 1] = (r[1, 0] * x + r[1, 1] * y + r[1, 2]) * ahead
                n = list_views(turned, t_s, order, path, 1.0 / sigma[i], 0, views, limits)
                if not limits[0] < state[i, 2] < limits[1]:
                    point.start(views, n, limits, state[i])
                far = _LIMIT * noise * noise
                total, inside = _fill_equations(views, n, state[i], basis[k], far, work)
                eliminate(work[1], kept[i], information, score)
                mean_square[i] = total / (2 * n - 3)
                left[k, 0] += inside
            median_chi2 = median(mean_square[low:high].copy())
            left[k, 1] = median_chi2
            fall = solve(information, score)
            for c in range(N_LOCAL):
                offset[k, c] += score[c]
            for i in range(low, high):
                follow(kept[i], step)
                for c in range(_N_OWN):
                    state[i, c] += step[c]
            if fall < _CONVERGED_CHI2 * noise * noise:
                break


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], f8[::1], i8[::1], i8[::1])), f8[:, :, ::1], f8[:, :, ::1], i8[::1], f8[:, ::1], "
    "f8[:, :, ::1], f8[:, ::1])"
)
def add_windows(
    points: _Points, paths: Floats, basis: Floats, n_views: Ints, state: Floats, information: Floats, score: Floats
) -> None:
    """Add to ``information (K, 11, 11)``, its lower half, and ``score (K, 11)`` what the nearest ``n_views (N,)`` say.

    ``paths (K, L, 3)`` are those at which the points were fitted.
    """
    xy, t_s, sigma, order, first = points
    views, limits = np.empty((point.N_ROWS, len(t_s))), np.empty(2)
    work = np.empty((_N_ALL + 1, 2 * len(t_s))), np.empty((_N_ALL + 1, _N_ALL))
    kept = np.empty((_N_OWN, _N_ALL + 1))
    for k in range(len(paths)):
        for i in range(first[k], first[k + 1]):
            if n_views[i] > 0:
                list_views(xy, t_s, order, paths[k], 1.0 / sigma[i], i, views, limits)
                _fill_equations(views, n_views[i], state[i], basis[k], _LIMIT, work)
                eliminate(work[1], kept, information[k], score[k])


@compiled
def _fill_equations(
    views: Floats, n: int, s: Floats, basis: Floats, limit: float, work: tuple[Floats, Floats]
) -> tuple[float, float]:
    """Fill the equations of a point and what it shares by its first n views: ``work`` is its rows, and these.

    Returns the sums of weighted squares, and of squares of which none counts for more than the robust limit.

    With h = 1 / (1 + rho T_z), d x / d(x, rho, T) = h (1, T_x - x T_z, rho (1, 0, -x)); T follows u as t, v as t^2 / 2
    and w as t^3 / 6; a turn left in the views by t moves them as the ray (x, y, 1) does. Squares beyond the ``limit``
    lose weight.
    """
    (rows, equations), rho, total, inside = work, s[2], 0.0, 0.0
    # By an index without a sign: several views are worked at at a time.
    for k in range(np.uint64(n)):
        other, inverse, t, tz = k + np.uint64(n), views[point.INVERSE, k], views[point.TIME, k], views[point.PATH_Z, k]
        h = 1.0 / max(1.0 + rho * tz, point.LEAST_DEPTH_RATIO)
        x, y = (s[0] + rho * views[point.PATH_X, k]) * h, (s[1] + rho * views[point.PATH_Y, k]) * h
        rx, ry = (views[point.X, k] - x) * inverse, (views[point.Y, k] - y) * inverse
        square = rx * rx + ry * ry
        weight = limit / max(square, limit)
        total += weight * square
        inside += min(square, _LIMIT)
        root = np.sqrt(weight)
        a, turned = root * inverse * h, root * inverse * t
        g, half, third = rho * a * t, 0.5 * t, t / 3.0
        rows[0, k], rows[0, other], rows[1, k], rows[1, other] = a, 0.0, 0.0, a
        rows[2, k], rows[2, other] = a * (views[point.PATH_X, k] - x * tz), a * (views[point.PATH_Y, k] - y * tz)
        rows[3, k], rows[3, other] = g * (basis[0, 0] - x * basis[2, 0]), g * (basis[1, 0] - y * basis[2, 0])
        rows[4, k], rows[4, other] = g * (basis[0, 1] - x * basis[2, 1]), g * (basis[1, 1] - y * basis[2, 1])
        along_x, along_y = g * (basis[0, 2] - x * basis[2, 2]), g * (basis[1, 2] - y * basis[2, 2])
        rows[5, k], rows[5, other] = half * rows[3, k], half * rows[3, other]
        rows[6, k], rows[6, other] = half * rows[4, k], half * rows[4, other]
        rows[7, k], rows[7, other] = half * along_x, half * along_y
        rows[8, k], rows[8, other] = third * rows[5, k], third * rows[5, other]
        rows[9, k], rows[9, other] = third * rows[6, k], third * rows[6, other]
        rows[10, k], rows[10, other] = third * rows[7, k], third * rows[7, other]
        rows[11, k], rows[11, other] = -turned * x * y, -turned * (1.0 + y * y)
        rows[12, k], rows[12, other] = turned * (1.0 + x * x), turned * x * y
        rows[13, k], rows[13, other] = -turned * y, turned * x
        rows[14, k], rows[14, other] = root * rx, root * ry
    equations[:] = 0.0
    add_equations(rows, 2 * n, equations, equations[_N_ALL])
    return total, inside
