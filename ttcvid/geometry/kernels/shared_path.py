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
from ttcvid.geometry.kernels.rotations import fill_rotation
from ttcvid.geometry.kernels.solve import eliminate, follow, solve
from ttcvid.model import Floats, Ints

N_LOCAL = 11
"""Unknowns that the points of a path share."""

# Unknowns of a point, and of it and its path together.
_N_OWN, _N_ALL = 3, 3 + N_LOCAL
# Joint steps end after so many, or after one shorter than this (squared, in sigmas of the estimate).
_MAX_STEPS, _CONVERGED_CHI2 = 6, 0.1
# So many views are worked at at a time.
_ROOM = 32
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
    equations = np.empty((_N_ALL + 1, _N_ALL))
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
                total, inside = _fill_equations(views, n, state[i], basis[k], far, equations)
                eliminate(equations, kept[i], information, score)
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
    equations, kept = np.empty((_N_ALL + 1, _N_ALL)), np.empty((_N_OWN, _N_ALL + 1))
    for k in range(len(paths)):
        for i in range(first[k], first[k + 1]):
            if n_views[i] > 0:
                list_views(xy, t_s, order, paths[k], 1.0 / sigma[i], i, views, limits)
                _fill_equations(views, n_views[i], state[i], basis[k], _LIMIT, equations)
                eliminate(equations, kept, information[k], score[k])


@compiled
def _fill_equations(
    views: Floats, n: int, s: Floats, basis: Floats, limit: float, equations: Floats
) -> tuple[float, float]:
    """Fill the ``equations`` of a point and what it shares by its first n views.

    Returns the sums of weighted squares, and of squares of which none counts for more than the robust limit.

    With h = 1 / (1 + rho T_z), d x / d(x, rho, T) = h (1, T_x - x T_z, rho (1, 0, -x)); T follows u as t, v as t^2 / 2
    and w as t^3 / 6; a turn by t that is left over moves x and y as the ray does. Squares beyond ``limit`` lose weight.
    """
    # Derivatives of x and y, and what is left of them: some views at a time.
    rows, rho, total, inside = np.empty((_N_ALL + 1, 2, _ROOM)), s[2], 0.0, 0.0
    equations[:] = 0.0
    for first in range(0, n, _ROOM):
        # By indices without a sign: several views are worked at at a time.
        stop = np.uint64(min(_ROOM, n - first))
        for k in range(stop):
            at = np.uint64(first) + k
            inverse, t = views[point.INVERSE, at], views[point.TIME, at]
            tx, ty, tz = views[point.PATH_X, at], views[point.PATH_Y, at], views[point.PATH_Z, at]
            h = 1.0 / max(1.0 + rho * tz, point.LEAST_DEPTH_RATIO)
            x, y = (s[0] + rho * tx) * h, (s[1] + rho * ty) * h
            rx, ry = (views[point.X, at] - x) * inverse, (views[point.Y, at] - y) * inverse
            square = rx * rx + ry * ry
            weight = limit / max(square, limit)
            total += weight * square
            inside += min(square, _LIMIT)
            root = np.sqrt(weight)
            a, turned = root * inverse * h, root * inverse * t
            g, half, sixth = rho * a * t, t / 2.0, t * t / 6.0
            rows[0, 0, k], rows[0, 1, k], rows[1, 0, k], rows[1, 1, k] = a, 0.0, 0.0, a
            rows[2, 0, k], rows[2, 1, k] = a * (tx - x * tz), a * (ty - y * tz)
            for c in range(3):
                by_x, by_y = g * (basis[0, c] - x * basis[2, c]), g * (basis[1, c] - y * basis[2, c])
                if c < 2:
                    rows[3 + c, 0, k], rows[3 + c, 1, k] = by_x, by_y
                rows[5 + c, 0, k], rows[5 + c, 1, k] = half * by_x, half * by_y
                rows[8 + c, 0, k], rows[8 + c, 1, k] = sixth * by_x, sixth * by_y
            rows[11, 0, k], rows[11, 1, k] = -turned * x * y, -turned * (1.0 + y * y)
            rows[12, 0, k], rows[12, 1, k] = turned * (1.0 + x * x), turned * x * y
            rows[13, 0, k], rows[13, 1, k] = -turned * y, turned * x
            rows[14, 0, k], rows[14, 1, k] = root * rx, root * ry
        for c in range(_N_ALL + 1):
            for d in range(min(c + 1, _N_ALL)):
                both = 0.0
                for k in range(stop):
                    both += rows[c, 0, k] * rows[d, 0, k] + rows[c, 1, k] * rows[d, 1, k]
                equations[c, d] += both
    return total, inside
