"""The inner loops of `rigid_path`: points on the paths of rigid things, and the paths by their points, compiled.

All arrays that a function fills are arguments of it. Rotations turn rays of past views into the present camera.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for, compiled_in_place
from ttcvid.model import Floats, Ints

N_STEPS = 2
"""Gauss-Newton steps on a point from its last rate, at most: the path changes little between two frames."""

LANES = 8
"""Views of a point, and points of a view, are worked at so many at a time, as fits the processor's registers.

Lanes that are left over stand before the first view: a track of few views, the last ones, needs few of them.
"""

# Residuals beyond this, in sigmas, count by their length (Huber), no longer by its square. In `whole_track_descent` and
# the files that follow it their weight is 1 / r^2, and chi-square grows no further; here it tells to which thing a
# track belongs, and has to grow with the misfit. Where a path is corrected (`_add_up`), the scale is that of Cauchy's
# weight, which lets go of outliers.
_ROBUST_SIGMAS = 3.0
# Gauss-Newton on a point ends after a step that lowers chi-square by less than this: the step is taken, its fall is
# what the linearisation says.
_SMALL_FALL = 0.1
# The depth of a point over that at time 0, 1 + rho T_z, is taken as at least this. `whole_track_on_path` and
# `shared_path_descent` have 0.1 to limit the rate: here, on wrong paths too, only the prediction is kept from its pole.
_LEAST_DEPTH_RATIO = 0.05
# Least z of a turned unit ray that still has a place in the plane z = 1, as in `rotation.turned_into_plane`.
_LEAST_FORWARD = 0.05
# Weight of a point falls to a half where its misfit is twice the typical one, which counts as this at the least.
_HALF_WEIGHT, _LEAST_TYPICAL_MISFIT = 2.0, 0.25
# Numbers of a view: its rotation (9) and shift (3); of a point: place (2), rate, information, weight.
_N_WAY, _N_POINT = 12, 5
# Paths shorter than this have no scale to keep.
_NO_LENGTH = 1e-9
# By view: the rotations expected, and the standard deviations of turns and shifts (`rigid_path.PathPriors`).
_Priors = tuple[Floats, Floats, Floats]


@compiled_for(
    "(f8[:, :, ::1], i8[::1], i8[::1], f8[:, :, :, ::1], f8[:, :, ::1], f8[::1], f8[::1], f8[::1], i8, "
    "f8[:, ::1], f8[::1], f8[::1], f8[::1], i8[::1])"
)
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
    ways = np.zeros((len(paths), _N_WAY, rays.shape[2]))
    for b in range(len(paths)):
        _list_way(rotations, paths, b, ways, b)
    for m in range(len(track)):
        i, rho = track[m], start[m] if np.isfinite(start[m]) else 0.0
        x, y, rho, information, chi2, n = _fit(rays, i, ways, thing[m], rho, sigma[i], least[m], n_steps)
        n_views[m] = n
        if n < 2:
            place[m], rate[m], rate_sigma[m], misfit[m] = np.nan, np.nan, np.nan, 0.0
            continue
        place[m, 0], place[m, 1], rate[m] = x, y, rho
        rate_sigma[m], misfit[m] = 1.0 / np.sqrt(information), chi2 / (2 * n - 3 if n > 2 else 1)


@compiled_for(
    "(f8[:, :, ::1], i8[::1], i8[::1], i8[::1], f8[::1], f8[::1], Tuple((f8[:, :, ::1], f8[::1], f8[::1])), "
    "i8[::1], f8[::1], f8[:, :, :, ::1], f8[:, :, ::1], f8[::1])"
)
def refine_each(
    rays: Floats,
    track: Ints,
    order: Ints,
    first: Ints,
    sigma: Floats,
    since_s: Floats,
    priors: _Priors,
    n_steps: Ints,
    weight: Floats,
    rotations: Floats,
    paths: Floats,
    rate: Floats,
) -> None:
    """Draw ``rotations (K, L, 3, 3)`` and ``paths (K, L, 3)`` towards what the points show, in place.

    Points of thing b are ``order[first[b] : first[b + 1]]``; their ``rate (M,)`` are starts and results. Of a
    single thing the rotations may be those of the priors, too: then each step is expected to change nothing.
    """
    n_frames, m = paths.shape[1], len(order)
    points, misfit, used = np.empty((_N_POINT, m + LANES)), np.empty(m), np.empty(m)
    views, way = np.empty((n_frames, 3, m + LANES)), np.zeros((1, _N_WAY, rays.shape[2]))
    normal, score = np.empty((n_frames, 6, 6)), np.empty((n_frames, 6))
    for b in range(len(paths)):
        members = order[first[b] : first[b + 1]]
        n_lanes = -(-len(members) // LANES) * LANES
        _list_views(rays, track, members, views)
        for _ in range(n_steps[b]):
            _list_way(rotations, paths, b, way, 0)
            points[:, :n_lanes], n_used = 0.0, 0
            for c in range(len(members)):
                m = members[c]
                rate[m] = rate[m] if np.isfinite(rate[m]) else 0.0
                x, y, rho, _, chi2, n = _fit(rays, track[m], way, 0, rate[m], sigma[track[m]], 0.0, N_STEPS)
                if n < 2:
                    rate[m] = np.nan
                    continue
                rate[m], misfit[c] = rho, chi2 / (2 * n - 3 if n > 2 else 1)
                points[0, c], points[1, c], points[2, c], points[3, c] = x, y, rho, sigma[track[m]] ** -2.0
                if weight[m] > 0.0:
                    used[n_used] = misfit[c]
                    n_used += 1
            if n_used == 0:
                break
            typical = max(np.median(used[:n_used]), _LEAST_TYPICAL_MISFIT)
            for c in range(len(members)):
                if points[3, c] > 0.0:
                    points[4, c] = weight[members[c]] / (1.0 + misfit[c] / (_HALF_WEIGHT * typical))
            for k in range(n_frames - 1):
                _add_up(views[k], n_lanes, rotations[b, k], paths[b, k], points, normal[k], score[k])
            _correct(since_s, priors, normal, score, rotations[b], paths[b])


@compiled
def _list_views(rays: Floats, track: Ints, members: Ints, views: Floats) -> None:
    """Fill ``views (L, 3, M)`` with the rays of points, side by side; the last point fills up the last block.

    A block of points at a time, view by view: that reads and writes next to where it did before.
    """
    rows, before = np.empty(LANES, dtype=np.uint64), np.uint64(rays.shape[2] - len(views))
    for start in range(0, len(members), LANES):
        for c in range(LANES):
            rows[c] = track[members[min(start + c, len(members) - 1)]]
        for k in range(np.uint64(len(views))):
            for i in range(np.uint64(3)):
                for c in range(np.uint64(LANES)):
                    views[k, i, np.uint64(start) + c] = rays[rows[c], i, before + k]


@compiled
def _list_way(rotations: Floats, paths: Floats, b: int, ways: Floats, place: int) -> None:
    """Fill ``ways[place] (12, M)``, view by view: the rotation ``rotations[b, k]``, row by row, and ``paths[b, k]``."""
    before = ways.shape[2] - paths.shape[1]
    for k in range(paths.shape[1]):
        for i in range(3):
            for j in range(3):
                ways[place, 3 * i + j, before + k] = rotations[b, k, i, j]
            ways[place, 9 + i, before + k] = paths[b, k, i]


@compiled_in_place
def _fit(
    rays: Floats, i: int, ways: Floats, q: int, start: float, sigma: float, least: float, n_steps: int
) -> tuple[float, float, float, float, float, int]:
    """Place x, y and rate by robust Gauss-Newton, the rate's information, chi-square (Huber's), and the views.

    Of track i on path q. It starts where the point is seen now, in the last view, and with so few steps a point that
    does not fit stays near there. No views at all if it is not seen now. The same unknowns as in `whole_track_on_path`,
    `shared_path_descent`: there without a last rate, to convergence.
    """
    last, first = rays.shape[2] - 1, 0
    a, b, c = rays[i, 0, last], rays[i, 1, last], rays[i, 2, last]
    depth = ways[q, 6, last] * a + ways[q, 7, last] * b + ways[q, 8, last] * c
    if not depth > _LEAST_FORWARD:
        return np.nan, np.nan, np.nan, 0.0, 0.0, 0
    while np.isnan(rays[i, 0, first]):
        first += 1
    first -= first % LANES
    x = (ways[q, 0, last] * a + ways[q, 1, last] * b + ways[q, 2, last] * c) / depth
    y = (ways[q, 3, last] * a + ways[q, 4, last] * b + ways[q, 5, last] * c) / depth
    rho, information, chi2, n_views, inverse = max(start, least), 0.0, 0.0, 0.0, 1.0 / (sigma * sigma)
    for count in range(n_steps + 1):
        one, by_x, by_y, both, score_x, score_y, score, chi2, n_views = _sums(
            rays, i, first, ways, q, x, y, rho, inverse
        )
        information = both - (by_x * by_x + by_y * by_y) / one
        if count == n_steps or n_views < 2.0:
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
    return x, y, rho, information, chi2, int(n_views)


@compiled_in_place
def _sums(
    rays: Floats, i: int, first: int, ways: Floats, q: int, x: float, y: float, rho: float, inverse: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Normal equations of x, y, rho over the views of track i, from ``first`` on, the robust chi-square, and the views.

    Returns the information on x (and y), the couplings of x and y with rho, the information on rho, the score of x, y,
    rho, chi-square (Huber), and how often the point was seen. With h = 1 / (1 + rho T_z), d (px, py) / d (x, y, rho)
    has the rows (h, 0, j_x) and (0, h, j_y), j = h (T_xy - (px, py) T_z). Without a branch: views are worked at
    `LANES` at a time, and turned anew at each call, which costs less than to keep them.
    """
    one = by_x = by_y = both = score_x = score_y = score = chi2 = n = 0.0
    limit = _ROBUST_SIGMAS * _ROBUST_SIGMAS
    # An index without a sign: one that may count from the end takes the lanes apart.
    for k in range(np.uint64(first), np.uint64(rays.shape[2])):
        a, b, c, tx, ty, tz = rays[i, 0, k], rays[i, 1, k], rays[i, 2, k], ways[q, 9, k], ways[q, 10, k], ways[q, 11, k]
        depth = ways[q, 6, k] * a + ways[q, 7, k] * b + ways[q, 8, k] * c
        is_seen = depth > _LEAST_FORWARD
        forward, h = 1.0 / depth, 1.0 / max(1.0 + rho * tz, _LEAST_DEPTH_RATIO)
        px, py = (x + rho * tx) * h, (y + rho * ty) * h
        rx = (ways[q, 0, k] * a + ways[q, 1, k] * b + ways[q, 2, k] * c) * forward - px if is_seen else 0.0
        ry = (ways[q, 3, k] * a + ways[q, 4, k] * b + ways[q, 5, k] * c) * forward - py if is_seen else 0.0
        n += 1.0 if is_seen else 0.0
        w = inverse if is_seen else 0.0
        square = (rx * rx + ry * ry) * inverse
        length, is_far = np.sqrt(square), square > limit
        w = w * _ROBUST_SIGMAS / length if is_far else w
        chi2 += 2.0 * _ROBUST_SIGMAS * length - limit if is_far else square
        jx, jy = (tx - px * tz) * h, (ty - py * tz) * h
        wh = w * h
        one += wh * h
        by_x += wh * jx
        by_y += wh * jy
        both += w * (jx * jx + jy * jy)
        score_x += wh * rx
        score_y += wh * ry
        score += w * (jx * rx + jy * ry)
    return one, by_x, by_y, both, score_x, score_y, score, chi2, n


@compiled
def _add_up(
    views: Floats, n_lanes: int, rotation: Floats, path: Floats, points: Floats, normal: Floats, score: Floats
) -> None:
    """Fill ``normal (6, 6)``, its lower half, and ``score (6,)`` of a past view, by rays ``(3, M)`` of its points.

    A point seen at p = (x, y, 1) moves in the picture by B (omega x p + g s) when the view turns by omega and the
    thing shifts by s, with B = [[1, 0, -x], [0, 1, -y]] and g = rho / (1 + rho T_z). Rotations come first.
    ``points (5, M)`` are place (2), rate, information of one coordinate, and weight of each.
    """
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    tx, ty, tz, soft = path[0], path[1], path[2], 1.0 / (_ROBUST_SIGMAS * _ROBUST_SIGMAS)
    n00 = n10 = n11 = n20 = n21 = n22 = n30 = n31 = n32 = n33 = n40 = n42 = n50 = n51 = n53 = n54 = n55 = 0.0
    s0 = s1 = s2 = s3 = s4 = s5 = 0.0
    for c in range(n_lanes):
        a, b, z, rho = views[0, c], views[1, c], views[2, c], points[2, c]
        ahead, depth = r20 * a + r21 * b + r22 * z, 1.0 + rho * tz
        is_used = (ahead > _LEAST_FORWARD) & (depth >= _LEAST_DEPTH_RATIO)
        # One division for two: where a point is not used, NaN would pass from one to the other.
        ahead = ahead if is_used else 1.0
        inverses = 1.0 / (depth * ahead)
        h, forward = inverses * ahead, inverses * depth
        x, y = (points[0, c] + rho * tx) * h, (points[1, c] + rho * ty) * h
        rx = (r00 * a + r01 * b + r02 * z) * forward - x if is_used else 0.0
        ry = (r10 * a + r11 * b + r12 * z) * forward - y if is_used else 0.0
        inverse = points[3, c]
        w = points[4, c] * inverse / (1.0 + (rx * rx + ry * ry) * inverse * soft) if is_used else 0.0
        g = rho * h
        xx, yy, both, xyw, wg = 1.0 + x * x, 1.0 + y * y, x * x + y * y, w * x * y, w * g
        wgg = wg * g
        n00 += w * yy * yy + xyw * x * y
        n10 += xyw * (1.0 + xx + y * y)
        n11 += w * xx * xx + xyw * x * y
        n20 += w * x
        n21 += w * y
        n22 += w * both
        n30 += xyw * g
        n31 += wg * xx
        n32 += wg * y
        n40 += wg * yy
        n42 += wg * x
        n50 += wg * y * (1.0 + both)
        n51 += wg * x * (1.0 + both)
        n33 += wgg
        n53 += wgg * x
        n54 += wgg * y
        n55 += wgg * both
        s0 += xyw * rx + w * yy * ry
        s1 += w * xx * rx + xyw * ry
        s2 += w * (x * ry - y * rx)
        s3 += wg * rx
        s4 += wg * ry
        s5 += wg * (x * rx + y * ry)
    normal[0, 0], normal[1, 0], normal[1, 1] = n00, -n10, n11
    normal[2, 0], normal[2, 1], normal[2, 2] = -n20, -n21, n22
    normal[3, 0], normal[3, 1], normal[3, 2], normal[3, 3] = -n30, n31, -n32, n33
    normal[4, 0], normal[4, 1], normal[4, 2], normal[4, 3], normal[4, 4] = -n40, n30, n42, 0.0, n33
    normal[5, 0], normal[5, 1], normal[5, 2] = n50, -n51, 0.0
    normal[5, 3], normal[5, 4], normal[5, 5] = -n53, -n54, n55
    score[0], score[1], score[2], score[3], score[4], score[5] = -s0, s1, s2, s3, s4, -s5


@compiled
def _correct(since_s: Floats, priors: _Priors, normal: Floats, score: Floats, rotation: Floats, path: Floats) -> None:
    """Turn the past views and shift the path of one thing by robust least squares with Gaussian priors.

    The priors draw rotations towards ``expected (L, 3, 3)`` and the path towards a steady straight one; the path keeps
    the length of its farthest view.
    """
    expected, turn_sigma, shift_sigma = priors
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
    return float(np.sqrt(np.max(np.sum(path * path, axis=1))))


@compiled
def _length(v: Floats) -> float:
    return float(np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]))


@compiled
def _solve(a: Floats, b: Floats) -> None:
    """Solve ``a x = b`` in place by Cholesky's decomposition of the lower half of ``a (6, 6)``: half an elimination."""
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
    """``rotation`` turned further by minus the vector ``turn``, by way of the quaternion, and orthonormal again."""
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
