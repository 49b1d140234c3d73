"""The inner loops of `whole_track_on_path`: robust Gauss-Newton on place and rate of each point, compiled.

All arrays that a function fills are arguments of it. Points are worked at `_LANES` at a time, as lanes of the
processor's registers. What is known of such a block stands in flat arrays, for the compiler to see how far apart things
are: number j of view k of lane c at ``k * _ROW + j + c`` of ``views``, number j of the point at ``j + c`` of ``state``.
Row k has the k-th nearest view of each point, from 1 on, and the sums over it and all nearer ones; row 0 has sums of
nothing. A point of fewer views than others of its block has views without weight.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for, compiled_in_place
from ttcvid.model import Floats, Ints

LEAST_FRAMES = 2
"""Views that the rate needs; a window is never cut below them."""

TAIL = 3
"""So many of a window's farthest views are tested also by themselves."""

# As for the free state (`whole_track_descent`, which a compiled function of this file may not call). The same sums
# stand in `shared_path_descent`, and with other weights in `rigid_path_descent`, which says why.
_ROBUST_SIGMAS = 3.0
_MAX_STEPS, _CONVERGED_CHI2, _WINDOW_STEPS = 8, 1e-2, 3
_LEAST_DEPTH_RATIO = 0.1

# A loop over fewer lanes would not be worth taking them together, says the compiler. Without a sign, as all places: an
# index that may count from the end takes the lanes apart.
_LANES = np.uint64(16)
# So few that are left in a block are worked at one by one.
_FEW = 4
# Numbers of a view: where the point is seen, one over its noise (0: no view), its path and the time.
_X, _Y, _INVERSE, _PATH_X, _PATH_Y, _PATH_Z, _TIME = (np.uint64(16 * j) for j in range(7))
# Sums: information on x (and y), couplings of x, y with rho, information on rho, score of x, y, rho, squared residuals.
_OWN, _WITH_X, _WITH_Y, _INFO, _SCORE_X, _SCORE_Y, _SCORE, _SQUARES, _CHANGE, _LEFT = (
    np.uint64(16 * j) for j in range(7, 17)
)
_ROW = np.uint64(16 * 17)
# Numbers of a point: x, y (at 0), rho, how x and y follow it, its variance; what shared errors do to it (`PathRates`).
_AT_Y, _RATE, _LOW, _HIGH = (np.uint64(16 * j) for j in range(1, 5))
_ALONG_X, _ALONG_Y, _VARIANCE, _BY_SHARED = (np.uint64(16 * j) for j in (5, 6, 7, 8))
_N_STATE = np.uint64(16 * 17)


@compiled_for(
    "(f8[:, :, ::1], f8[::1], f8[::1], i8[::1], i8, f8[:, :, ::1], i8[::1], f8[::1], f8[::1], f8[:, ::1], b1, "
    "f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[::1], i8[::1])"
)
def fit_each(
    xy: Floats,
    t_s: Floats,
    sigma: Floats,
    order: Ints,
    longest: int,
    paths: Floats,
    path_of: Ints,
    gates: Floats,
    tail_gates: Floats,
    start: Floats,
    has_sensitivities: bool,
    found: Floats,
    cov: Floats,
    by_shared: Floats,
    chi2: Floats,
    n_frames: Ints,
) -> None:
    """Fill the results of `whole_track_on_path.fit_rates_on_paths`, a block of points at a time.

    ``order`` lists the views, nearest first, of which at most ``longest`` are used; ``gates`` and ``tail_gates`` are
    those of `whole_track.window_gates`; ``start (N, 3)`` may be empty; ``found (N, 3)`` is x, y, rho.
    """
    views, state, n_lanes = np.zeros((longest + 1) * _ROW), np.empty(_N_STATE), int(_LANES)
    n_seen, is_open = np.empty(n_lanes, dtype=np.int64), np.empty(n_lanes, dtype=np.bool_)
    point, n_points = np.empty(len(path_of), dtype=np.int64), 0
    found[:], cov[:], by_shared[:] = np.nan, np.nan, np.nan
    for i in range(len(path_of)):
        if path_of[i] >= 0 and sigma[i] > 0.0:
            point[n_points] = i
            n_points += 1
    for first in range(0, n_points, n_lanes):
        count, n_open, is_new = min(n_points - first, n_lanes), 0, False
        state[:], n_seen[:] = 0.0, 0
        for c in range(count):
            i = point[first + c]
            n_seen[c] = _list_views(xy, t_s, order, longest, paths, path_of[i], 1.0 / sigma[i], i, c, views, state)
            n_frames[i] = n_seen[c]
            is_open[c] = n_seen[c] >= LEAST_FRAMES
            if is_open[c]:
                n_open += 1
                is_new |= not _take_start(start, i, c, views, state)
        n_rows = int(np.max(n_seen))
        for c in range(n_lanes):
            for k in range(n_seen[c] + 1, n_rows + 1):
                views[k * _ROW + _INVERSE + c] = views[k * _ROW + _PATH_Z + c] = 0.0
        if is_new:
            _add_up(views, n_rows, state, True)
            for c in range(count):
                if is_open[c] and not _take_start(start, point[first + c], c, views, state):
                    _step(views, n_seen[c], c, state)
        for n_steps in range(1, _MAX_STEPS + 1):
            if n_open == 0:
                break
            are_few = n_open <= _FEW
            if not are_few:
                _add_up(views, n_rows, state, False)
            for c in range(count):
                if not is_open[c]:
                    continue
                i = point[first + c]
                n = n_seen[c] if n_steps <= _WINDOW_STEPS else n_frames[i]
                if are_few:
                    _add_up_one(views, n, c, state)
                while n > LEAST_FRAMES:
                    k, left = max(n - TAIL, LEAST_FRAMES), views[n * _ROW + _LEFT + c]
                    if left <= gates[n] and left - views[k * _ROW + _LEFT + c] <= tail_gates[n - k]:
                        break
                    n -= 1
                fall = _step(views, n, c, state)
                n_frames[i], chi2[i] = n, max(views[n * _ROW + _LEFT + c], 0.0)
                if fall < _CONVERGED_CHI2 or n_steps == _MAX_STEPS:
                    is_open[c] = False
                    n_open -= 1
                    _store(views, n, c, i, state, found, cov)
        if has_sensitivities:
            for c in range(count):
                for k in range(n_frames[point[first + c]] + 1, n_rows + 1):
                    views[k * _ROW + _INVERSE + c] = 0.0
            _add_up_shared(views, n_rows, state)
            for c in range(count):
                i = point[first + c]
                if np.isfinite(found[i, 2]):
                    for j in range(by_shared.shape[1]):
                        by_shared[i, j] = state[_BY_SHARED + j * _LANES + c]


@compiled
def _list_views(
    xy: Floats,
    t_s: Floats,
    order: Ints,
    longest: int,
    paths: Floats,
    path: int,
    inverse: float,
    i: int,
    c: int,
    views: Floats,
    state: Floats,
) -> int:
    """Fills the views of point i, which is lane c, and the limits of its rate; returns how many views it has."""
    nearest, farthest, row, end = 0.0, 0.0, np.uint64(c), longest * _ROW
    p, q = np.uint64(i), np.uint64(path)
    for place in order:
        k = np.uint64(place)
        x, y, tx, tz = xy[k, p, 0], xy[k, p, 1], paths[q, k, 0], paths[q, k, 2]
        # A sum is finite where all of its terms are.
        if np.isfinite(x + y + tx + tz) and row < end:
            row += _ROW
            views[row + _X], views[row + _Y], views[row + _INVERSE], views[row + _TIME] = x, y, inverse, t_s[k]
            views[row + _PATH_X], views[row + _PATH_Y], views[row + _PATH_Z] = tx, paths[q, k, 1], tz
            nearest, farthest = min(nearest, tz), max(farthest, tz)
    state[_LOW + c] = -(1.0 - _LEAST_DEPTH_RATIO) / max(farthest, 1e-12)
    state[_HIGH + c] = (1.0 - _LEAST_DEPTH_RATIO) / max(-nearest, 1e-12)
    return int(row // _ROW)


@compiled
def _take_start(start: Floats, i: int, c: int, views: Floats, state: Floats) -> bool:
    """Puts lane c where point i is to start, or else to where it is seen now; whether it has a start."""
    if len(start) and np.isfinite(start[i, 0] + start[i, 1]) and state[_LOW + c] < start[i, 2] < state[_HIGH + c]:
        state[c], state[_AT_Y + c], state[_RATE + c] = start[i, 0], start[i, 1], start[i, 2]
        return True
    state[c], state[_AT_Y + c], state[_RATE + c] = views[_ROW + _X + c], views[_ROW + _Y + c], 0.0
    return False


@compiled
def _add_up(views: Floats, n_rows: int, state: Floats, is_linear: bool) -> None:
    """Running sums of the normal equations over the views of a block. ``is_linear``: of a first solution.

    With h = 1 / (1 + rho T_z), d x / d(x, rho) = h (1, T_x - x T_z); for the first solution, which starts with rho = 0,
    at the observed positions.
    """
    for k in range(np.uint64(n_rows)):
        for c in range(_LANES):
            _add_view(views, k, c, state, is_linear)


@compiled
def _add_up_one(views: Floats, n_rows: int, c: int, state: Floats) -> None:
    """The same sums of lane c alone."""
    for k in range(np.uint64(n_rows)):
        _add_view(views, k, c, state, False)


@compiled_in_place
def _add_view(views: Floats, k: int, c: int, state: Floats, is_linear: bool) -> None:
    """Fills the sums in row k + 1 of lane c; without a branch, so that lanes are worked at together."""
    limit, past = _ROBUST_SIGMAS * _ROBUST_SIGMAS, k * _ROW + c
    row = past + _ROW
    rho, inverse = state[_RATE + c], views[row + _INVERSE]
    px, py, pz = views[row + _PATH_X], views[row + _PATH_Y], views[row + _PATH_Z]
    h = 1.0 / (1.0 + rho * pz)
    x, y = (state[c] + rho * px) * h, (state[_AT_Y + c] + rho * py) * h
    rx, ry = (views[row + _X] - x) * inverse, (views[row + _Y] - y) * inverse
    square = rx * rx + ry * ry
    # Without a branch: which views are far off cannot be guessed.
    weight = 1.0 if is_linear else limit / max(square, limit)
    x = views[row + _X] if is_linear else x
    y = views[row + _Y] if is_linear else y
    jx, jy = px - x * pz, py - y * pz
    hi = h * inverse
    w, gx, gy = weight * hi * hi, weight * hi * rx, weight * hi * ry
    own, with_x, with_y = views[past + _OWN] + w, views[past + _WITH_X] + w * jx, views[past + _WITH_Y] + w * jy
    info = views[past + _INFO] + w * (jx * jx + jy * jy)
    score_x, score_y = views[past + _SCORE_X] + gx, views[past + _SCORE_Y] + gy
    score, squares = views[past + _SCORE] + gx * jx + gy * jy, views[past + _SQUARES] + weight * square
    views[row + _OWN], views[row + _WITH_X], views[row + _WITH_Y], views[row + _INFO] = (
        own,
        with_x,
        with_y,
        info,
    )
    views[row + _SCORE_X], views[row + _SCORE_Y], views[row + _SCORE] = score_x, score_y, score
    views[row + _SQUARES] = squares
    rest = 1.0 / own
    info -= (with_x * with_x + with_y * with_y) * rest
    score -= (with_x * score_x + with_y * score_y) * rest
    change = score / info if info > 0.0 else 0.0
    # Half of the way to a limit at most.
    change = min(max(change, 0.5 * (state[_LOW + c] - rho)), 0.5 * (state[_HIGH + c] - rho))
    views[row + _CHANGE] = change
    fall = (score_x * score_x + score_y * score_y) * rest + change * (2.0 * score - info * change)
    views[row + _LEFT] = squares - fall


@compiled
def _step(views: Floats, n: int, c: int, state: Floats) -> float:
    """Moves x, y and rho of lane c by what its first n views say; returns by how much chi-square falls."""
    row, rest = n * _ROW + c, 1.0 / views[n * _ROW + _OWN + c]
    change = views[row + _CHANGE]
    state[c] += (views[row + _SCORE_X] - views[row + _WITH_X] * change) * rest
    state[_AT_Y + c] += (views[row + _SCORE_Y] - views[row + _WITH_Y] * change) * rest
    state[_RATE + c] += change
    fall: float = views[row + _SQUARES] - views[row + _LEFT]
    return fall


@compiled
def _store(views: Floats, n: int, c: int, i: int, state: Floats, found: Floats, cov: Floats) -> None:
    """State and covariance of point i, lane c, by its first n views; without information on the rate they stay NaN."""
    row = n * _ROW + c
    own = 1.0 / views[row + _OWN]
    along_x, along_y = -views[row + _WITH_X] * own, -views[row + _WITH_Y] * own
    information = views[row + _INFO] + along_x * views[row + _WITH_X] + along_y * views[row + _WITH_Y]
    if not information > 0.0:
        return
    variance = 1.0 / information
    for j in range(3):
        found[i, j] = state[j * _LANES + c]
    state[_ALONG_X + c], state[_ALONG_Y + c], state[_VARIANCE + c] = along_x, along_y, variance
    cov[i, 0, 0] = own + along_x * along_x * variance
    cov[i, 1, 1] = own + along_y * along_y * variance
    cov[i, 0, 1] = cov[i, 1, 0] = along_x * along_y * variance
    cov[i, 0, 2] = cov[i, 2, 0] = along_x * variance
    cov[i, 1, 2] = cov[i, 2, 1] = along_y * variance
    cov[i, 2, 2] = variance


@compiled
def _add_up_shared(views: Floats, n_rows: int, state: Floats) -> None:
    """What a wrong path and a wrong rotation of the views of a block do to its rates: ``by_shared`` of `PathRates`."""
    limit = _ROBUST_SIGMAS * _ROBUST_SIGMAS
    for k in range(np.uint64(1), np.uint64(n_rows + 1)):
        for c in range(_LANES):
            row = k * _ROW + c
            rho, inverse, t = state[_RATE + c], views[row + _INVERSE], views[row + _TIME]
            tx, ty, tz = views[row + _PATH_X], views[row + _PATH_Y], views[row + _PATH_Z]
            h = 1.0 / (1.0 + rho * tz)
            x, y = (state[c] + rho * tx) * h, (state[_AT_Y + c] + rho * ty) * h
            rx, ry = (views[row + _X] - x) * inverse, (views[row + _Y] - y) * inverse
            # What a shift of this view by (dx, dy) does to rho, with x and y free.
            gain = limit / max(rx * rx + ry * ry, limit) * state[_VARIANCE + c] * h * inverse * inverse
            px, py = gain * (tx - x * tz + state[_ALONG_X + c]), gain * (ty - y * tz + state[_ALONG_Y + c])
            u = rho * h * t
            v, pz = 0.5 * u * t, -(x * px + y * py)
            state[_BY_SHARED + c] -= u * px
            state[_BY_SHARED + np.uint64(16) + c] -= u * py
            state[_BY_SHARED + np.uint64(32) + c] -= u * pz
            state[_BY_SHARED + np.uint64(48) + c] -= v * px
            state[_BY_SHARED + np.uint64(64) + c] -= v * py
            state[_BY_SHARED + np.uint64(80) + c] -= v * pz
            state[_BY_SHARED + np.uint64(96) + c] += t * (py - y * pz)
            state[_BY_SHARED + np.uint64(112) + c] -= t * (px - x * pz)
            state[_BY_SHARED + np.uint64(128) + c] -= t * (x * py - y * px)
