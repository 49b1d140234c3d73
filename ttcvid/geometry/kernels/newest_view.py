"""Which views of a point are displaced: the newest, if it is not where the earlier ones lead, and single earlier ones.

By the path of its body, and the newest also by its own course.
"""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled, compiled_for
from ttcvid.geometry.kernels import path_point
from ttcvid.model import Bools, Floats, Ints

# A track goes straight on over so many views. On a parabola it then leaves their line by so many times as much as each
# of them is off the middle of its neighbours.
_STRAIGHT_VIEWS, _BEND = 4, 5.0
# Noise bends three views by less than so many times its variance in 19 cases of 20 (1.5 in each of two coordinates).
_NOT_BENT = 9.0
# Gauss-Newton steps on a point from its last rate, and with further ones, which let go of views far off (but for the
# first): fewer where they no longer lower chi-square, and no further ones where no view is far off.
_N_STEPS, _N_ALL_STEPS, _NO_FALL = 4, 7, 1e-6
# An earlier view is displaced if its squared residual exceeds the second and that of a later view is within the first.
# So many views, and this part of all, have to be within the first.
_IN, _OFF, _LEAST_IN, _LEAST_PART_IN = 3.0**2, 6.0**2, 4, 0.5
_OWN, _WITH_X, _WITH_Y = path_point.OWN, path_point.WITH_X, path_point.WITH_Y
_SCORE_X, _SCORE_Y = path_point.SCORE_X, path_point.SCORE_Y
_X, _Y, _INVERSE, _TIME = path_point.X, path_point.Y, path_point.INVERSE, path_point.TIME
_PATH_X, _PATH_Y, _PATH_Z = path_point.PATH_X, path_point.PATH_Y, path_point.PATH_Z
_N_ROWS, _N_SUMS, _LIMIT = path_point.N_ROWS, path_point.N_SUMS, path_point.ROBUST_SIGMAS**2
_add_views, _add_views_near = path_point.add_views_by_length, path_point.add_views
_rate_equation, _first_lane, _list_turned = path_point.rate_equation, path_point.first_lane, path_point.list_turned
_LEAST_DEPTH_RATIO = path_point.LEAST_DEPTH_RATIO


@compiled_for(
    "(f8[:, :, ::1], i8[::1], i8[::1], f8[:, :, ::1], f8[::1], f8[::1], f8[::1], "
    "Tuple((f8[:, ::1], f8[::1], f8[::1], f8[::1], b1[:, ::1])))"
)
def predict_newest(
    rays: Floats,
    track: Ints,
    body: Ints,
    ways: Floats,
    sigma: Floats,
    since_s: Floats,
    start: Floats,
    found: tuple[Floats, Floats, Floats, Floats, Bools],
) -> None:
    """Fill ``found``, the fields of `rigid_motion.Surprise`, point by point.

    Arguments as of `rigid_points.fit_rigid_points`; ``start (M,)`` are rates to start from.
    """
    off, chi2, line_chi2, past_redchi, is_past_off = found
    views, sums, s = np.empty((_N_ROWS, rays.shape[2])), np.empty(_N_SUMS), np.empty(3)
    of_all, sums_of_all, square = np.empty(3), np.empty(_N_SUMS), np.empty(rays.shape[2])
    last, before = rays.shape[2] - 1, rays.shape[2] - len(since_s)
    for k in range(rays.shape[2]):
        views[_TIME, k] = since_s[k - before] if k >= before else 0.0
    for m in range(len(track)):
        first = _first_lane(rays, track[m])
        n = _list_turned(rays, track[m], first, ways, body[m], 1.0 / sigma[track[m]], views)
        off[m, 0], off[m, 1], chi2[m], line_chi2[m], past_redchi[m], is_past_off[m] = 0.0, 0.0, 0.0, 0.0, 0.0, False
        # With fewer than three earlier views nothing tells how straight the point went.
        if n < 4 or not views[_INVERSE, last] > 0.0:
            continue
        # Place and rate by the views before the last. They start from where the latest of them leads: from the last,
        # if that is wrong, few steps do not come back.
        k = last - 1
        while not views[_INVERSE, k] > 0.0:
            k -= 1
        s[2] = start[m] if start[m] > 0.0 else 0.0
        s[0] = views[_X, k] * (1.0 + s[2] * views[_PATH_Z, k]) - s[2] * views[_PATH_X, k]
        s[1] = views[_Y, k] * (1.0 + s[2] * views[_PATH_Z, k]) - s[2] * views[_PATH_Y, k]
        count = 0
        while True:
            sums[:] = 0.0
            if count <= _N_STEPS:
                _add_views(views, first, last, s, _LIMIT, sums)
            else:
                _add_views_near(views, first, last, s, _LIMIT, 1.0, sums)
            if count == _N_STEPS:
                # One view is the last, and three unknowns are fitted to the others.
                past_redchi[m] = sums[path_point.CHI2] / (2 * n - 5)
                of_all[:], sums_of_all[:] = s, sums
            if count == _N_ALL_STEPS:
                break
            info, score = _rate_equation(sums)
            change = max(score / info, -s[2]) if info > 0.0 else 0.0
            s[0] += (sums[_SCORE_X] - sums[_WITH_X] * change) / sums[_OWN]
            s[1] += (sums[_SCORE_Y] - sums[_WITH_Y] * change) / sums[_OWN]
            s[2] += change
            fall = (sums[_SCORE_X] ** 2 + sums[_SCORE_Y] ** 2) / sums[_OWN] + change * (2.0 * score - info * change)
            if count == _N_STEPS and fall < _NO_FALL and sums[path_point.CHI2] < _LIMIT:
                # None is far off, to be let go of.
                break
            if count == _N_STEPS or not fall < _NO_FALL:
                count += 1
            else:
                count = _N_STEPS if count < _N_STEPS else _N_ALL_STEPS
        n_in = 0
        for k in range(first, last + 1):
            h = 1.0 / max(1.0 + s[2] * views[_PATH_Z, k], _LEAST_DEPTH_RATIO)
            rx = (views[_X, k] - (s[0] + s[2] * views[_PATH_X, k]) * h) * views[_INVERSE, k]
            ry = (views[_Y, k] - (s[1] + s[2] * views[_PATH_Y, k]) * h) * views[_INVERSE, k]
            square[k] = rx * rx + ry * ry
            n_in += 1 if k < last and views[_INVERSE, k] > 0.0 and square[k] < _IN else 0
        if n_in >= max(float(_LEAST_IN), _LEAST_PART_IN * (n - 1)):
            # Nothing is said of the last view, nor of a point that has left the path of its body for good.
            is_back = False
            for k in range(last, first - 1, -1):
                if views[_INVERSE, k] > 0.0:
                    is_past_off[m, k] = is_back and square[k] > _OFF
                    is_back = is_back or square[k] < _IN
        else:
            s[:], sums[:] = of_all, sums_of_all
        info, _ = _rate_equation(sums)
        # The place is known to 1 / own, and along (x, y) as rho is.
        rx, ry = views[_X, last] - s[0], views[_Y, last] - s[1]
        own, along_x, along_y = sums[_OWN], sums[_WITH_X] / sums[_OWN], sums[_WITH_Y] / sums[_OWN]
        variance = 1.0 / (views[_INVERSE, last] * views[_INVERSE, last]) + 1.0 / own
        along, known = along_x * rx + along_y * ry, variance * max(info, 0.0) + along_x * along_x + along_y * along_y
        off_path = (rx * rx + ry * ry - (along * along / known if known > 0.0 else 0.0)) / variance
        off[m, 0], off[m, 1], chi2[m], line_chi2[m] = rx, ry, off_path, _off_line(views, first, last)


@compiled
def _off_line(views: Floats, first: int, last: int) -> float:
    """How far the last view is off the line through those shortly before it, in chi-square; ``first`` is the earliest.

    A bent course leads off the line: as far as the straighter part of it is bent beyond noise, for a false view is off
    its neighbours too.
    """
    n, t_sum, tt_sum, x_sum, y_sum, tx_sum, ty_sum, bent = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.inf
    t1 = x1 = y1 = t2 = x2 = y2 = 0.0
    for k in range(last - 1, first - 1, -1):
        if not views[_INVERSE, k] > 0.0:
            continue
        t, x, y = views[_TIME, k], views[_X, k], views[_Y, k]
        n += 1
        t_sum += t
        tt_sum += t * t
        x_sum += x
        y_sum += y
        tx_sum += t * x
        ty_sum += t * y
        if n > 2:
            part = (t1 - t) / (t2 - t)
            bent = min(bent, (x1 - x - part * (x2 - x)) ** 2 + (y1 - y - part * (y2 - y)) ** 2)
        t1, x1, y1, t2, x2, y2 = t, x, y, t1, x1, y1
        if n >= _STRAIGHT_VIEWS:
            break
    spread, variance = n * tt_sum - t_sum * t_sum, 1.0 / (views[_INVERSE, last] * views[_INVERSE, last])
    x, y = (tt_sum * x_sum - t_sum * tx_sum) / spread, (tt_sum * y_sum - t_sum * ty_sum) / spread
    off = np.sqrt((views[_X, last] - x) ** 2 + (views[_Y, last] - y) ** 2)
    off -= _BEND * np.sqrt(max(bent - _NOT_BENT * variance, 0.0))
    return float(max(off, 0.0) ** 2 / (variance * (1.0 + tt_sum / spread)))
