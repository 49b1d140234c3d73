"""Points of rigid bodies by their rays in past views, which the body's rotation turns into the present camera.

``ways (K, 12, M)`` hold the rotation (9) and the path (3) of each body in each view, ``rays (N, 3, M)`` the tracks, NaN
where not seen; the last view is the present one. Points are given by the number of their track and of their body.
"""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled_for
from ttcvid.geometry.kernels import path_point
from ttcvid.geometry.kernels.rotations import fill_rotation, fill_vectors
from ttcvid.geometry.kernels.solve import solve
from ttcvid.model import Bools, Floats, Ints

NO_LENGTH = 1e-9
"""Paths shorter than this have no scale."""

# Gauss-Newton on a point ends after a step that lowers chi-square by less than this: the step is taken, its fall is
# what the linearisation says.
_SMALL_FALL = 0.1
_OWN, _WITH_X, _WITH_Y, _INFO = path_point.OWN, path_point.WITH_X, path_point.WITH_Y, path_point.INFO
_SCORE_X, _SCORE_Y, _CHI2 = path_point.SCORE_X, path_point.SCORE_Y, path_point.CHI2
_X, _Y, _INVERSE = path_point.X, path_point.Y, path_point.INVERSE
_PATH_X, _PATH_Y, _PATH_Z = path_point.PATH_X, path_point.PATH_Y, path_point.PATH_Z
_N_ROWS, _N_SUMS, _LIMIT = path_point.N_ROWS, path_point.N_SUMS, path_point.ROBUST_SIGMAS**2
_LEAST_DEPTH_RATIO = path_point.LEAST_DEPTH_RATIO
_add_views = path_point.add_views_by_length
_rate_equation, _first_lane, _list_turned = path_point.rate_equation, path_point.first_lane, path_point.list_turned


@compiled_for(
    "(f8[:, :, ::1], i8[::1], i8[::1], f8[:, :, ::1], f8[::1], Tuple((f8[::1], f8[::1])), i8, "
    "Tuple((f8[:, ::1], f8[::1], f8[::1], f8[::1], i8[::1])))"
)
def fit_rigid_points(
    rays: Floats,
    track: Ints,
    body: Ints,
    ways: Floats,
    sigma: Floats,
    rates: tuple[Floats, Floats],
    n_steps: int,
    found: tuple[Floats, Floats, Floats, Floats, Ints],
) -> None:
    """Fill the results ``found`` of `rigid_motion.fit_on_paths`, by point; ``rates`` to start from and least ones.

    It starts where the point is seen now, in the last view, and with so few steps a point that does not fit stays near
    there. No views at all if it is not seen now.
    """
    place, rate, rate_sigma, redchi, n_views = found
    start, least = rates
    views, sums, s = np.empty((_N_ROWS, rays.shape[2])), np.empty(_N_SUMS), np.empty(3)
    last = rays.shape[2] - 1
    for m in range(len(track)):
        first = _first_lane(rays, track[m])
        n = _list_turned(rays, track[m], first, ways, body[m], 1.0 / sigma[track[m]], views)
        n_views[m] = n if views[_INVERSE, last] > 0.0 else 0
        if n_views[m] < 2:
            place[m], rate[m], rate_sigma[m], redchi[m] = np.nan, np.nan, np.nan, 0.0
            continue
        s[0], s[1], s[2] = views[_X, last], views[_Y, last], max(start[m] if np.isfinite(start[m]) else 0.0, least[m])
        info, chi2 = 0.0, 0.0
        for count in range(n_steps + 1):
            sums[:] = 0.0
            _add_views(views, first, last + 1, s, _LIMIT, sums)
            info, score = _rate_equation(sums)
            chi2 = sums[_CHI2]
            if count == n_steps:
                break
            change, own = max(score / info, least[m] - s[2]) if info > 0.0 else 0.0, sums[_OWN]
            s[0] += (sums[_SCORE_X] - sums[_WITH_X] * change) / own
            s[1] += (sums[_SCORE_Y] - sums[_WITH_Y] * change) / own
            s[2] += change
            square = sums[_SCORE_X] * sums[_SCORE_X] + sums[_SCORE_Y] * sums[_SCORE_Y]
            fall = square / own + change * (2.0 * score - info * change)
            if fall < _SMALL_FALL:
                chi2 = max(chi2 - fall, 0.0)
                break
        place[m, 0], place[m, 1], rate[m], rate_sigma[m] = s[0], s[1], s[2], 1.0 / np.sqrt(info)
        redchi[m] = chi2 / (2 * n - 3 if n > 2 else 1)


@compiled_for(
    "(f8[:, :, ::1], i8[::1], i8[::1], f8[:, :, ::1], f8[::1], Tuple((f8[:, ::1], f8[::1], f8[::1])), b1[::1], "
    "Tuple((f8[::1], f8[:, :, ::1], f8[::1], f8[::1])))"
)
def correct_ways(
    rays: Floats,
    track: Ints,
    body: Ints,
    ways: Floats,
    sigma: Floats,
    points: tuple[Floats, Floats, Floats],
    is_asked: Bools,
    priors: tuple[Floats, Floats, Floats, Floats],
) -> None:
    """Turn and shift each past view of the bodies that are asked, ``is_asked (K,)``, as their points show it, in place.

    ``points`` are places (N, 2), rates and weights, 0 of points that say nothing; ``priors`` times of the views (L,),
    rotations expected (L, 3, 3), without any those that the views have, and precisions (L,) of turns and of shifts over
    the length of the path.

    A point seen at p = (x, y, 1) moves in the picture by B (omega x p + g s) when the view turns by omega and the body
    shifts by s, with B = [[1, 0, -x], [0, 1, -y]] and g = rho / (1 + rho T_z): the columns of J. Residuals far off lose
    weight as Cauchy has it, which lets go of outliers. The sums of a view are the lower triangle of J' J, with the
    residuals last.
    """
    place, rate, weight = points
    n_views = rays.shape[2]
    views, rows, sums = np.empty((_N_ROWS, n_views)), np.empty((7, 2 * n_views)), np.zeros((len(ways), 28, n_views))
    for m in range(len(track)):
        if not weight[m] > 0.0:
            continue
        b, x0, y0, rho = body[m], place[m, 0], place[m, 1], rate[m]
        first = _first_lane(rays, track[m])
        _list_turned(rays, track[m], first, ways, b, 1.0 / sigma[track[m]], views)
        for k in range(np.uint64(first), np.uint64(n_views)):
            tx, ty, tz = views[_PATH_X, k], views[_PATH_Y, k], views[_PATH_Z, k]
            depth = 1.0 + rho * tz
            is_near, inverse = depth < _LEAST_DEPTH_RATIO, views[_INVERSE, k]
            h = 1.0 / (1.0 if is_near else depth)
            x, y = (x0 + rho * tx) * h, (y0 + rho * ty) * h
            rx, ry = (views[_X, k] - x) * inverse, (views[_Y, k] - y) * inverse
            root = 0.0 if is_near else np.sqrt(weight[m] / (1.0 + (rx * rx + ry * ry) * (1.0 / _LIMIT)))
            w, g, other = root * inverse, root * inverse * rho * h, k + np.uint64(n_views)
            rows[0, k], rows[1, k], rows[2, k] = -w * x * y, w * (1.0 + x * x), -w * y
            rows[0, other], rows[1, other], rows[2, other] = -w * (1.0 + y * y), w * x * y, w * x
            rows[3, k], rows[4, k], rows[5, k], rows[6, k] = g, 0.0, -g * x, root * rx
            rows[3, other], rows[4, other], rows[5, other], rows[6, other] = 0.0, g, -g * y, root * ry
        place_of_sum = 0
        for c in range(7):
            for d in range(c + 1):
                for k in range(np.uint64(first), np.uint64(n_views)):
                    other = k + np.uint64(n_views)
                    sums[b, place_of_sum, k] += rows[c, k] * rows[d, k] + rows[c, other] * rows[d, other]
                place_of_sum += 1
    since_s, expected, turn_precision, shift_precision = priors
    matrix, change, turn = np.empty((6, 6)), np.empty(6), np.empty((3, 3))
    off, off_rad, before = np.empty((1, 3, 3)), np.empty((1, 3)), np.empty((4, 3))
    first = n_views - len(since_s)
    for b in range(len(ways)):
        if not is_asked[b]:
            continue
        way, longest, longest_now = ways[b], 0.0, 0.0
        oldest = way[9, first], way[10, first], way[11, first]
        for k in range(first, n_views - 1):
            view, place_of_sum = k - first, 0
            for j in range(3):
                for c in range(4):
                    before[c, j] = way[3 * c + j, k]
            length = np.sqrt(before[3, 0] ** 2 + before[3, 1] ** 2 + before[3, 2] ** 2)
            longest = max(longest, length)
            of_shift = shift_precision[view] / (length + NO_LENGTH) ** 2
            for c in range(6):
                for d in range(c + 1):
                    matrix[c, d] = sums[b, place_of_sum, k]
                    place_of_sum += 1
                matrix[c, c] += turn_precision[view] if c < 3 else of_shift
            for j in range(6):
                change[j] = sums[b, place_of_sum + j, k]
            for j in range(3):
                change[3 + j] -= of_shift * (before[3, j] - since_s[view] / since_s[0] * oldest[j])
            if len(expected) > 0:
                for i in range(3):
                    for j in range(3):
                        off[0, i, j] = 0.0
                        for c in range(3):
                            off[0, i, j] += expected[view, i, c] * before[j, c]
                fill_vectors(off, off_rad)
                for j in range(3):
                    change[j] -= turn_precision[view] * off_rad[0, j]
            solve(matrix, change)
            fill_rotation(-change[0], -change[1], -change[2], turn)
            for j in range(3):
                for i in range(3):
                    way[3 * i + j, k] = (
                        turn[i, 0] * before[0, j] + turn[i, 1] * before[1, j] + turn[i, 2] * before[2, j]
                    )
                way[9 + j, k] += change[3 + j]
            longest_now = max(longest_now, np.sqrt(way[9, k] ** 2 + way[10, k] ** 2 + way[11, k] ** 2))
        if min(longest, longest_now) > NO_LENGTH:
            for j in range(9, 12):
                for k in range(first, n_views - 1):
                    way[j, k] *= longest / longest_now


@compiled_for(
    "(f8[:, :, ::1], i8[::1], i8[::1], f8[:, :, ::1], f8[::1], Tuple((f8[:, ::1], f8[::1], f8[::1])), f8[:, ::1], "
    "f8[:, :, ::1])"
)
def add_last_steps(
    rays: Floats,
    track: Ints,
    body: Ints,
    ways: Floats,
    sigma: Floats,
    points: tuple[Floats, Floats, Floats],
    middle: Floats,
    equations: Floats,
) -> None:
    """Add to ``equations (K, 7, 6)`` what the points say of a turn w and a shift s of their body now.

    Information, and in the last row the score. The present view, at (x, y, 1), moves by
    B (w x ((x, y, 1) - rho C) + rho s), with B = [[1, 0, -x], [0, 1, -y]] and ``middle (K, 3)``, C, about which a body
    turns. A point of which nothing but this is known could be anywhere: with the information N of all views on x, y,
    rho, and that of a coordinate of the present view, i, what the residual there says of B (...) weighs i - i^2 N^-1.
    """
    place, rate, weight = points
    views, sums, s = np.empty((_N_ROWS, rays.shape[2])), np.empty(_N_SUMS), np.empty(3)
    last = rays.shape[2] - 1
    for m in range(len(track)):
        if not weight[m] > 0.0:
            continue
        b, x0, y0, rho = body[m], place[m, 0], place[m, 1], rate[m]
        first = _first_lane(rays, track[m])
        _list_turned(rays, track[m], first, ways, b, 1.0, views)
        for k in range(first, last + 1):
            views[_INVERSE, k] *= 1.0 if 1.0 + rho * views[_PATH_Z, k] >= _LEAST_DEPTH_RATIO else 0.0
        s[0], s[1], s[2], sums[:] = x0, y0, rho, 0.0
        # By least squares: nothing is far off.
        _add_views(views, first, last + 1, s, 1e300, sums)
        info, score = _rate_equation(sums)
        if not info > 0.0:
            continue
        # Of the point by all views, and the residual of the present one, the last.
        one, along_x, along_y, change = sums[_OWN], sums[_WITH_X] / sums[_OWN], sums[_WITH_Y] / sums[_OWN], score / info
        xx, xy = 1.0 - 1.0 / one - along_x * along_x / info, -along_x * along_y / info
        yy = 1.0 - 1.0 / one - along_y * along_y / info
        x, y, z = x0 - rho * middle[b, 0], y0 - rho * middle[b, 1], 1.0 - rho * middle[b, 2]
        row_x, row_y = (-x0 * y, z + x0 * x, -y, rho, 0.0, -rho * x0), (-z - y0 * y, y0 * x, x, 0.0, rho, -rho * y0)
        rx = views[_X, last] - x0 - sums[_SCORE_X] / one + along_x * change
        ry = views[_Y, last] - y0 - sums[_SCORE_Y] / one + along_y * change
        known = weight[m] / (sigma[track[m]] * sigma[track[m]])
        for j in range(6):
            by_x, by_y = known * (xx * row_x[j] + xy * row_y[j]), known * (xy * row_x[j] + yy * row_y[j])
            equations[b, 6, j] += known * (row_x[j] * rx + row_y[j] * ry)
            for k in range(6):
                equations[b, j, k] += by_x * row_x[k] + by_y * row_y[k]
