"""Place and rate of points whose relative path is known up to its scale, each over a window of its views."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import ZERO, compiled, compiled_for
from ttcvid.geometry.kernels import path_point
from ttcvid.geometry.kernels.windows import window_descent
from ttcvid.model import Floats, Ints

LEAST_FRAMES = 2
"""Views that the rate needs; a window is never cut below them."""

# The depth of a point over that at time 0, 1 + rho T_z, stays above this over the window.
_LEAST_DEPTH_RATIO = 0.1
_OWN, _WITH_X, _WITH_Y = path_point.OWN, path_point.WITH_X, path_point.WITH_Y
_X, _Y, _INVERSE, _TIME = path_point.X, path_point.Y, path_point.INVERSE, path_point.TIME
_PATH_X, _PATH_Y, _PATH_Z = path_point.PATH_X, path_point.PATH_Y, path_point.PATH_Z
_N_ROWS, _N_SUMS, _LIMIT = path_point.N_ROWS, path_point.N_SUMS, path_point.ROBUST_SIGMAS**2
_rate_equation, _start = path_point.rate_equation, path_point.start
_descend = window_descent(path_point.add_views, path_point.solve_between, path_point.solve_between)


@compiled_for(
    "(f8[:, :, ::1], f8[::1], f8[::1], i8[::1], Tuple((f8[:, :, ::1], i8[::1])), Tuple((f8[::1], f8[::1])), "
    "f8[:, ::1], Tuple((f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[::1], i8[::1])))"
)
def fit_points_on_known_paths(
    xy: Floats,
    t_s: Floats,
    sigma: Floats,
    order: Ints,
    paths_of_points: tuple[Floats, Ints],
    gates: tuple[Floats, Floats],
    start: Floats,
    found: tuple[Floats, Floats, Floats, Floats, Ints],
) -> None:
    """Fill the results ``found`` of `whole_track_on_path.fit_rates_on_paths`, point by point.

    ``order`` lists the views, nearest first, of which only so many are used as the first of the ``gates`` allows
    for, as in `windows`; ``start (N, 3)`` may be empty.
    """
    paths, path_of = paths_of_points
    state, cov, by_shared, chi2, n_frames = found
    views, limits, work = np.empty((_N_ROWS, len(gates[0]) - 1)), np.empty(2), (np.empty(_N_SUMS), np.empty(3))
    sums, s = np.empty(_N_SUMS), np.empty(3)
    for i in range(len(path_of)):
        if path_of[i] < 0 or not sigma[i] > 0.0:
            continue
        m = list_views(xy, t_s, order, paths[path_of[i]], 1.0 / sigma[i], i, views, limits)
        n_frames[i] = m
        if m < LEAST_FRAMES:
            continue
        has_start = len(start) > 0 and np.isfinite(start[i, 0] + start[i, 1])
        if has_start and limits[0] < start[i, 2] < limits[1]:
            s[0], s[1], s[2] = start[i, 0], start[i, 1], start[i, 2]
        else:
            _start(views, m, limits, s)
        n_frames[i], chi2[i] = _descend(views, m, LEAST_FRAMES, limits, gates, s, sums, work)
        info, _ = _rate_equation(sums)
        # Without information on the rate they stay NaN.
        if not info > 0.0:
            continue
        state[i, 0], state[i, 1], state[i, 2] = s[0], s[1], s[2]
        along = (-sums[_WITH_X] / sums[_OWN], -sums[_WITH_Y] / sums[_OWN], 1.0)
        for j in range(3):
            for k in range(3):
                cov[i, j, k] = along[j] * along[k] / info
        cov[i, 0, 0] += 1.0 / sums[_OWN]
        cov[i, 1, 1] += 1.0 / sums[_OWN]
        _fill_by_shared(views, n_frames[i], s, along[0], along[1], 1.0 / info, by_shared[i])


@compiled
def list_views(
    xy: Floats, t_s: Floats, order: Ints, path: Floats, inverse: float, i: int, views: Floats, limits: Floats
) -> int:
    """Fill the views of point i on its ``path (L, 3)``, nearest first, and the limits (2,) of its rate.

    Returns how many views it has.
    """
    nearest, farthest, m = 0.0, 0.0, ZERO
    for k in order:
        x, y, tx, tz = xy[k, i, 0], xy[k, i, 1], path[k, 0], path[k, 2]
        # A sum is finite where all of its terms are.
        if m < views.shape[1] and np.isfinite(x + y + tx + tz):
            views[_X, m], views[_Y, m], views[_INVERSE, m], views[_TIME, m] = x, y, inverse, t_s[k]
            views[_PATH_X, m], views[_PATH_Y, m], views[_PATH_Z, m] = tx, path[k, 1], tz
            nearest, farthest, m = min(nearest, tz), max(farthest, tz), m + 1
    limits[0] = -(1.0 - _LEAST_DEPTH_RATIO) / max(farthest, 1e-12)
    limits[1] = (1.0 - _LEAST_DEPTH_RATIO) / max(-nearest, 1e-12)
    return m


@compiled
def _fill_by_shared(
    views: Floats, n: int, s: Floats, along_x: float, along_y: float, variance: float, by_shared: Floats
) -> None:
    """What a wrong path and a wrong rotation of the first n views do to rho: ``by_shared (12,)`` of `PathRates`.

    ``along_x, along_y`` are how x and y follow rho, of which ``variance`` is that.
    """
    rho = s[2]
    u0 = u1 = u2 = v0 = v1 = v2 = w0 = w1 = w2 = turn0 = turn1 = turn2 = 0.0
    for k in range(np.uint64(n)):
        inverse, t = views[_INVERSE, k], views[_TIME, k]
        tx, ty, tz = views[_PATH_X, k], views[_PATH_Y, k], views[_PATH_Z, k]
        h = 1.0 / (1.0 + rho * tz)
        x, y = (s[0] + rho * tx) * h, (s[1] + rho * ty) * h
        rx, ry = (views[_X, k] - x) * inverse, (views[_Y, k] - y) * inverse
        # What a shift of this view by (dx, dy) does to rho, with x and y free.
        gain = _LIMIT / max(rx * rx + ry * ry, _LIMIT) * variance * h * inverse * inverse
        px, py = gain * (tx - x * tz + along_x), gain * (ty - y * tz + along_y)
        u, pz = rho * h * t, -(x * px + y * py)
        half, sixth = u * t / 2.0, u * t * t / 6.0
        u0 -= u * px
        u1 -= u * py
        u2 -= u * pz
        v0 -= half * px
        v1 -= half * py
        v2 -= half * pz
        w0 -= sixth * px
        w1 -= sixth * py
        w2 -= sixth * pz
        turn0 += t * (py - y * pz)
        turn1 -= t * (px - x * pz)
        turn2 -= t * (x * py - y * px)
    by_shared[0], by_shared[1], by_shared[2] = u0, u1, u2
    by_shared[3], by_shared[4], by_shared[5] = v0, v1, v2
    by_shared[6], by_shared[7], by_shared[8] = turn0, turn1, turn2
    by_shared[9], by_shared[10], by_shared[11] = w0, w1, w2
