"""The inner loops of `rigid_path`: points on the paths of rigid things, and the paths by their points, compiled.

All arrays that a function fills are arguments of it. Rotations turn rays of past views into the present camera.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.model import Floats, Ints

N_STEPS = 2
"""Gauss-Newton steps on a point from its last rate, at most: the path changes little between two frames."""

# Residuals beyond this, in sigmas, count by their length (Huber), no longer by its square. In `whole_track_descent` and
# the files that follow it their weight is 1 / r^2, and chi-square grows no further; here it tells to which thing a
# track belongs, and has to grow with the misfit. Where a path is corrected (`_add_up`), the scale is that of Cauchy's
# weight, which lets go of outliers.
_ROBUST_SIGMAS = 3.0
# Gauss-Newton on a point ends after a step that lowers chi-square by less than this: the step is taken, its fall is
# what the linearisation says.
_SMALL_FALL = 0.1
# The depth of a point over that at time 0, 1 + rho T_z, is taken as at least this. Not the 0.1 of `whole_track_on_path`
# and `shared_path_descent`, where it limits the rate: here a rate of the wrong path is fitted, too, and only the
# prediction is kept from its pole.
_LEAST_DEPTH_RATIO = 0.05
# Least z of a turned unit ray that still has a place in the plane z = 1, as in `rotation.turned_into_plane`.
_LEAST_FORWARD = 0.05
# Weight of a point falls to a half where its misfit is twice the typical one, which counts as this at the least.
_HALF_WEIGHT, _LEAST_TYPICAL_MISFIT = 2.0, 0.25
# Paths shorter than this have no scale to keep.
_NO_LENGTH = 1e-9


@compiled
def fit_each(
    rays: Floats,
    track: Ints,
    thing: Ints,
    rotations: Floats,
    paths: Floats,
    sigma: Floats,
    start: Floats,
    least: Floats,
    n_steps: int,
    place: Floats,
    rate: Floats,
    rate_sigma: Floats,
    misfit: Floats,
    n_views: Ints,
) -> None:
    """Fill the results of `rigid_path.fit_on_paths`, point by point."""
    views = np.empty((len(rays), 2))
    for m in range(len(track)):
        path, n = paths[thing[m]], _turn_into_plane(rays, track[m], rotations[thing[m]], views)
        n_views[m] = n
        if n < 2:
            place[m], rate[m], rate_sigma[m], misfit[m] = np.nan, np.nan, np.nan, 0.0
            continue
        x, y, rho, information, chi2 = _fit(views, path, start[m], sigma[track[m]], least[m], n_steps)
        place[m, 0], place[m, 1], rate[m] = x, y, rho
        rate_sigma[m], misfit[m] = 1.0 / np.sqrt(information), chi2 / (2 * n - 3 if n > 2 else 1)


@compiled
def refine_each(
    rays: Floats,
    track: Ints,
    order: Ints,
    first: Ints,
    sigma: Floats,
    since_s: Floats,
    expected: Floats,
    turn_sigma: Floats,
    shift_sigma: Floats,
    n_steps: Ints,
    weight: Floats,
    rotations: Floats,
    paths: Floats,
    rate: Floats,
) -> None:
    """Draw ``rotations (K, L, 3, 3)`` and ``paths (K, L, 3)`` towards what the points show, in place.

    Points of thing b are ``order[first[b] : first[b + 1]]``; their ``rate (M,)`` are starts and results.
    """
    n_frames, n_most = len(rays), 0
    for b in range(len(paths)):
        n_most = max(n_most, first[b + 1] - first[b])
    views, place = np.empty((n_most, n_frames, 2)), np.empty((n_most, 2))
    misfit, used = np.empty(n_most), np.empty(n_most)
    normal, score = np.empty((n_frames, 6, 6)), np.empty((n_frames, 6))
    for b in range(len(paths)):
        members = order[first[b] : first[b + 1]]
        for _ in range(n_steps[b]):
            n_used = 0
            for c in range(len(members)):
                m = members[c]
                n = _turn_into_plane(rays, track[m], rotations[b], views[c])
                if n < 2:
                    rate[m] = np.nan
                    continue
                x, y, rate[m], _, chi2 = _fit(views[c], paths[b], rate[m], sigma[track[m]], 0.0, N_STEPS)
                place[c, 0], place[c, 1], misfit[c] = x, y, chi2 / (2 * n - 3 if n > 2 else 1)
                if weight[m] > 0.0:
                    used[n_used] = misfit[c]
                    n_used += 1
            if n_used == 0:
                break
            typical = max(np.median(used[:n_used]), _LEAST_TYPICAL_MISFIT)
            normal[:], score[:] = 0.0, 0.0
            for c in range(len(members)):
                m = members[c]
                if weight[m] > 0.0 and np.isfinite(rate[m]):
                    w = weight[m] / (1.0 + misfit[c] / (_HALF_WEIGHT * typical))
                    _add_up(views[c], paths[b], place[c], rate[m], sigma[track[m]], w, normal, score)
            _correct(since_s, expected, turn_sigma, shift_sigma, normal, score, rotations[b], paths[b])


@compiled
def _turn_into_plane(rays: Floats, i: int, rotation: Floats, views: Floats) -> int:
    """Fill ``views (L, 2)`` with where track i was seen, as if its thing had not turned, NaN: not observed; how often.

    None at all if it is not seen now.
    """
    n = 0
    for k in range(len(rays)):
        a, b, c = rays[k, i, 0], rays[k, i, 1], rays[k, i, 2]
        depth = rotation[k, 2, 0] * a + rotation[k, 2, 1] * b + rotation[k, 2, 2] * c
        if depth > _LEAST_FORWARD:
            views[k, 0] = (rotation[k, 0, 0] * a + rotation[k, 0, 1] * b + rotation[k, 0, 2] * c) / depth
            views[k, 1] = (rotation[k, 1, 0] * a + rotation[k, 1, 1] * b + rotation[k, 1, 2] * c) / depth
            n += 1
        else:
            views[k, 0] = np.nan
    return 0 if np.isnan(views[len(rays) - 1, 0]) else n


@compiled
def _fit(
    views: Floats, path: Floats, start: float, sigma: float, least: float, n_steps: int
) -> tuple[float, float, float, float, float]:
    """Place x, y and rate by robust Gauss-Newton, the rate's information, and chi-square (Huber's).

    It starts where the point is seen now, and with so few steps a point that does not fit stays near there. The same
    unknowns as in `whole_track_on_path`, `shared_path_descent`: there without a last rate, to convergence.
    """
    last, information, chi2, inverse = len(views) - 1, 0.0, 0.0, 1.0 / (sigma * sigma)
    x, y, rho = views[last, 0], views[last, 1], max(start, least)
    for count in range(n_steps + 1):
        one, by_x, by_y, both, score_x, score_y, score, chi2 = _sums(views, path, x, y, rho, inverse)
        information = both - (by_x * by_x + by_y * by_y) / one
        if count == n_steps:
            break
        across = score - (by_x * score_x + by_y * score_y) / one
        change = max(across / information, least - rho) if information > 0.0 else 0.0
        x += (score_x - by_x * change) / one
        y += (score_y - by_y * change) / one
        rho += change
        fall = (score_x * score_x + score_y * score_y) / one + change * (2.0 * across - information * change)
        if fall < _SMALL_FALL:
            chi2 = max(chi2 - fall, 0.0)
            break
    return x, y, rho, information, chi2


@compiled
def _sums(
    views: Floats, path: Floats, x: float, y: float, rho: float, inverse: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Normal equations of x, y, rho over the views ``(L, 2)`` of a point, and the robust chi-square.

    Returns the information on x (and y), the couplings of x and y with rho, the information on rho, the score of x, y,
    rho, and chi-square (Huber). With h = 1 / (1 + rho T_z), d (px, py) / d (x, y, rho) has the rows (h, 0, j_x) and
    (0, h, j_y), j = h (T_xy - (px, py) T_z).
    """
    one, by_x, by_y, both, score_x, score_y, score, chi2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    limit = _ROBUST_SIGMAS * _ROBUST_SIGMAS
    for k in range(len(views)):
        if np.isnan(views[k, 0]):
            continue
        h = 1.0 / max(1.0 + rho * path[k, 2], _LEAST_DEPTH_RATIO)
        px, py = (x + rho * path[k, 0]) * h, (y + rho * path[k, 1]) * h
        rx, ry = views[k, 0] - px, views[k, 1] - py
        square = (rx * rx + ry * ry) * inverse
        w = inverse
        if square > limit:
            length = np.sqrt(square)
            w *= _ROBUST_SIGMAS / length
            square = 2.0 * _ROBUST_SIGMAS * length - limit
        chi2 += square
        jx, jy = (path[k, 0] - px * path[k, 2]) * h, (path[k, 1] - py * path[k, 2]) * h
        wh = w * h
        one += wh * h
        by_x += wh * jx
        by_y += wh * jy
        both += w * (jx * jx + jy * jy)
        score_x += wh * rx
        score_y += wh * ry
        score += w * (jx * rx + jy * ry)
    return one, by_x, by_y, both, score_x, score_y, score, chi2


@compiled
def _add_up(
    views: Floats,
    path: Floats,
    place: Floats,
    rho: float,
    sigma: float,
    weight: float,
    normal: Floats,
    score: Floats,
) -> None:
    """Add a point to ``normal (L, 6, 6)``, its lower half, and ``score (L, 6)`` of each past view.

    A point seen at p = (x, y, 1) moves in the picture by B (omega x p + g s) when the view turns by omega and the
    thing shifts by s, with B = [[1, 0, -x], [0, 1, -y]] and g = rho / (1 + rho T_z). Rotations come first.
    """
    inverse = 1.0 / (sigma * sigma)
    soft = inverse / (_ROBUST_SIGMAS * _ROBUST_SIGMAS)
    for k in range(len(views) - 1):
        depth = 1.0 + rho * path[k, 2]
        if np.isnan(views[k, 0]) or depth < _LEAST_DEPTH_RATIO:
            continue
        h = 1.0 / depth
        x, y = (place[0] + rho * path[k, 0]) * h, (place[1] + rho * path[k, 1]) * h
        rx, ry = views[k, 0] - x, views[k, 1] - y
        w = weight * inverse / (1.0 + (rx * rx + ry * ry) * soft)
        g = rho * h
        xx, yy, xyw, wg = 1.0 + x * x, 1.0 + y * y, w * x * y, w * g
        normal[k, 0, 0] += w * yy * yy + xyw * x * y
        normal[k, 1, 0] -= xyw * (xx + yy)
        normal[k, 1, 1] += w * xx * xx + xyw * x * y
        normal[k, 2, 0] -= w * x
        normal[k, 2, 1] -= w * y
        normal[k, 2, 2] += w * (x * x + y * y)
        normal[k, 3, 0] -= xyw * g
        normal[k, 3, 1] += wg * xx
        normal[k, 3, 2] -= wg * y
        normal[k, 4, 0] -= wg * yy
        normal[k, 4, 1] += xyw * g
        normal[k, 4, 2] += wg * x
        normal[k, 5, 0] += wg * y * (xx + y * y)
        normal[k, 5, 1] -= wg * x * (xx + y * y)
        normal[k, 3, 3] += wg * g
        normal[k, 4, 4] += wg * g
        normal[k, 5, 3] -= wg * g * x
        normal[k, 5, 4] -= wg * g * y
        normal[k, 5, 5] += wg * g * (x * x + y * y)
        score[k, 0] -= xyw * rx + w * yy * ry
        score[k, 1] += w * xx * rx + xyw * ry
        score[k, 2] += w * (x * ry - y * rx)
        score[k, 3] += wg * rx
        score[k, 4] += wg * ry
        score[k, 5] -= wg * (x * rx + y * ry)


@compiled
def _correct(
    since_s: Floats,
    expected: Floats,
    turn_sigma: Floats,
    shift_sigma: Floats,
    normal: Floats,
    score: Floats,
    rotation: Floats,
    path: Floats,
) -> None:
    """Turn the past views and shift the path of one thing by robust least squares with Gaussian priors.

    The priors draw rotations towards ``expected (L, 3, 3)`` and the path towards a steady straight one; the path keeps
    the length of its farthest view.
    """
    off, start, before = np.empty(3), path[0].copy(), _longest(path)
    for k in range(len(path) - 1):
        a, b, turn_precision = normal[k], score[k], 1.0 / turn_sigma[k] ** 2
        shift_precision, part = 1.0 / (shift_sigma[k] * (_length(path[k]) + 1e-9)) ** 2, since_s[k] / since_s[0]
        _vector_between(expected[k], rotation[k], off)
        for i in range(3):
            a[i, i] += turn_precision
            b[i] -= off[i] * turn_precision
            a[3 + i, 3 + i] += shift_precision
            b[3 + i] -= (path[k, i] - part * start[i]) * shift_precision
        _solve(a, b)
        _turn_back(b[:3], rotation[k])
        for i in range(3):
            path[k, i] += b[3 + i]
    after = _longest(path)
    if min(before, after) > _NO_LENGTH:
        for k in range(len(path)):
            for i in range(3):
                path[k, i] *= before / after


@compiled
def _longest(path: Floats) -> float:
    longest = 0.0
    for k in range(len(path)):
        longest = max(longest, _length(path[k]))
    return longest


@compiled
def _length(v: Floats) -> float:
    length: float = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return length


@compiled
def _solve(a: Floats, b: Floats) -> None:
    """Solve ``a x = b`` in place by Cholesky's decomposition, given the lower half of ``a (6, 6)``.

    Half the work of the elimination in `two_view_descent` and `shared_path_descent`, which keep their matrix.
    """
    for i in range(6):
        for j in range(i + 1):
            value = a[i, j]
            for c in range(j):
                value -= a[i, c] * a[j, c]
            a[i, j] = np.sqrt(value) if i == j else value / a[j, j]
    for i in range(6):
        for j in range(i):
            b[i] -= a[i, j] * b[j]
        b[i] /= a[i, i]
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            b[i] -= a[j, i] * b[j]
        b[i] /= a[i, i]


@compiled
def _vector_between(expected: Floats, rotation: Floats, vector: Floats) -> None:
    """Fill the rotation vector of ``expected rotation'``, by its odd part: for angles well under pi."""
    trace = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        vector[i] = 0.0
        for c in range(3):
            trace += expected[i, c] * rotation[i, c]
            vector[i] += 0.5 * (expected[k, c] * rotation[j, c] - expected[j, c] * rotation[k, c])
    sine = _length(vector)
    if sine > 0.0:
        scale = np.arctan2(sine, 0.5 * (trace - 1.0)) / sine
        for i in range(3):
            vector[i] *= scale


@compiled
def _turn_back(turn: Floats, rotation: Floats) -> None:
    """``rotation`` turned further by minus the vector ``turn``, by way of the quaternion, and orthonormal again.

    The turn is that of `rotation.rotation_from_vector`, whose file a compiled function may not call.
    """
    angle = _length(turn)
    scale = -0.5 if angle < 1e-12 else -np.sin(0.5 * angle) / angle
    w, x, y, z = np.cos(0.5 * angle), scale * turn[0], scale * turn[1], scale * turn[2]
    for c in range(3):
        a, b, d = rotation[0, c], rotation[1, c], rotation[2, c]
        # v + 2 w (q x v) + 2 q x (q x v).
        p, q, r = 2.0 * (y * d - z * b), 2.0 * (z * a - x * d), 2.0 * (x * b - y * a)
        rotation[0, c] = a + w * p + y * r - z * q
        rotation[1, c] = b + w * q + z * p - x * r
        rotation[2, c] = d + w * r + x * q - y * p
    # One step of Newton's towards the nearest rotation, R (3 - R'R) / 2: products that go on for ever cease to be some.
    square = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            square[i, j] = 3.0 if i == j else 0.0
            for c in range(3):
                square[i, j] -= rotation[c, i] * rotation[c, j]
    for i in range(3):
        a, b, d = rotation[i, 0], rotation[i, 1], rotation[i, 2]
        for j in range(3):
            rotation[i, j] = 0.5 * (a * square[0, j] + b * square[1, j] + d * square[2, j])
