"""The inner loops of `shared_path`: Gauss-Newton on K paths and on the places and rates of their points, compiled.

All arrays that a function fills are arguments of it. Points stand in order of their paths: those of path k are
``first[k] ... first[k + 1] - 1``. What the points of a path share is counted in the axes ``basis (3, 3)`` of the
path, whose last column is its believed direction: u along the first two (a speed is no unknown), v along all three,
and a rotation rate about x, y, z of the camera: `N_LOCAL` unknowns.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled
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
# Kept of a point while what it shares is solved for: information on its place, couplings of x and y with rho,
# information on rho, score of x, y, rho, squared residuals.
_N_OWN = 8
# Rows of the scratch after those of the information: how a view's x and y move with what is shared, and the score.
_BY_X, _BY_Y, _SCORE = N_LOCAL, N_LOCAL + 1, N_LOCAL + 2


@compiled
def descend_together(
    xy: Floats,
    t_s: Floats,
    sigma: Floats,
    seen: Ints,
    n_views: Ints,
    first: Ints,
    base: Floats,
    basis: Floats,
    prior: Floats,
    turns_itself: bool,
    own_motion: Floats,
    believed: Floats,
    state: Floats,
    offset: Floats,
    left: Floats,
) -> None:
    """Paths and points together, over all views: fills ``state (N, 3)`` (x, y, rho) and ``offset (K, 8)``.

    Fills ``own_motion (K, 8, 8)`` too: what takes offsets to that of which the belief speaks (`_set_own_motion`), with
    ``believed (K, 8, 8)``, the information on offsets; and ``left (K, 2)``, before the last step: sum of squared
    residuals in sigmas, none counted for more than the robust limit, and the points' median by the degree of freedom.

    No view is cut off: a believed path may be wrong by hundreds of sigmas at its far end, where a window would end at
    once and nothing be learned of it. A view loses weight beyond three times the usual residual of its path's points.

    Parameters
    ----------
    xy : (L, N, 2) views of times ``t_s (L,)``; point i is seen at the times ``seen[i, : n_views[i]]``, nearest first.
    base : (K, L, 3) believed paths, ``prior (K, 8, 8)`` the information on what moves along them.
    turns_itself : whether it is the thing on a path that turns, about its own middle, or the camera.
    """
    n_times, n = xy.shape[:2]
    rotation, path, views = np.empty((n_times, 3, 3)), np.empty((n_times, 3)), np.empty((n_times, 2))
    information, score, step = np.empty((N_LOCAL, N_LOCAL)), np.empty(N_LOCAL), np.empty(N_LOCAL)
    own, coupling, relative = np.empty((n, _N_OWN)), np.empty((n, 3, N_LOCAL)), np.empty(n)
    scratch = np.empty((N_LOCAL + 3, N_LOCAL))
    for k in range(len(first) - 1):
        low, high, axes = first[k], first[k + 1], basis[k]
        offset[k], left[k] = 0.0, 0.0
        _set_path(t_s, base[k], axes, offset[k], path, rotation)
        for i in range(low, high):
            _turn(xy, rotation, i, seen, n_views[i], views)
            slowest, fastest = _rate_limits(path, i, seen, n_views[i])
            relative[i] = _start(views, path, i, seen, n_views[i], sigma[i], slowest, fastest, state)
        _set_own_motion(turns_itself, axes, state[low:high], own_motion[k])
        _set_belief(prior[k], own_motion[k], believed[k])
        if low == high:
            continue
        usual = np.median(relative[low:high])
        for _ in range(_MAX_STEPS):
            misfit = max(1.0, np.sqrt(usual))
            limit = (_ROBUST_SIGMAS * misfit) ** 2
            _set_prior(believed[k], offset[k], information, score)
            for i in range(low, high):
                _turn(xy, rotation, i, seen, n_views[i], views)
                slowest, fastest = _rate_limits(path, i, seen, n_views[i])
                if not slowest < state[i, 2] < fastest:
                    _start(views, path, i, seen, n_views[i], sigma[i], slowest, fastest, state)
                relative[i] = _add_point(
                    views, t_s, path, axes, i, seen, n_views[i], state, sigma, limit, own, coupling, scratch
                )
                _eliminate(i, own, coupling, scratch, information, score)
            usual = np.median(relative[low:high])
            left[k, 0], left[k, 1] = np.sum(own[low:high, 7]), usual
            fall = _solve(information, score, step)
            offset[k] += step
            _set_path(t_s, base[k], axes, offset[k], path, rotation)
            for i in range(low, high):
                _follow(i, own, coupling, step, state)
            if fall < _CONVERGED_CHI2 * misfit * misfit:
                break


@compiled
def add_up_windows(
    xy: Floats,
    t_s: Floats,
    sigma: Floats,
    seen: Ints,
    n_views: Ints,
    first: Ints,
    path: Floats,
    basis: Floats,
    n_frames: Ints,
    state: Floats,
    information: Floats,
    score: Floats,
) -> None:
    """Adds what the windows ``n_frames (N,)`` of all points say: ``information (K, 8, 8)``, ``score (K, 8)``.

    Points that leave their path much sooner than others do move otherwise, and are left out. ``xy (L, N, 2)`` are views
    turned back, ``path (K, L, 3)`` the paths at which the points were fitted.
    """
    own, coupling = np.empty((len(sigma), _N_OWN)), np.empty((len(sigma), 3, N_LOCAL))
    scratch, limit = np.empty((N_LOCAL + 3, N_LOCAL)), _ROBUST_SIGMAS * _ROBUST_SIGMAS
    share, views = n_frames / n_views, np.empty((len(xy), 2))
    for k in range(len(first) - 1):
        low, high, axes, along = first[k], first[k + 1], basis[k], path[k]
        if low == high:
            continue
        least = _LOYAL_SHARE * np.median(share[low:high])
        for i in range(low, high):
            if share[i] >= least and n_frames[i] >= LEAST_VIEWS and np.isfinite(state[i, 2]):
                for place in range(len(views)):
                    views[place, 0], views[place, 1] = xy[place, i, 0], xy[place, i, 1]
                _add_point(views, t_s, along, axes, i, seen, n_frames[i], state, sigma, limit, own, coupling, scratch)
                _eliminate(i, own, coupling, scratch, information[k], score[k])


@compiled
def _add_point(
    views: Floats,
    t_s: Floats,
    path: Floats,
    basis: Floats,
    i: int,
    seen: Ints,
    n: int,
    state: Floats,
    sigma: Floats,
    limit: float,
    own: Floats,
    coupling: Floats,
    scratch: Floats,
) -> float:
    """Sums over the first n views of point i, for `_eliminate`: what it has of its own and what it shares.

    Fills ``own[i]``, the couplings ``coupling[i] (3, 8)`` of x, y, rho with what is shared, and ``scratch``: the lower
    half of the information on what is shared, then two rows for use here, then its score. The sums of x, y, rho are
    those of `whole_track_on_path._add_up`. Returns the mean square residual.
    With h = 1 / (1 + rho T_z), d x / d(x, rho, T) = h (1, T_x - x T_z, rho (1, 0, -x)); T follows u as t and v as
    t^2 / 2; a turn left in the views by t moves them as the ray (x, y, 1) does.
    """
    for j in range(N_LOCAL):
        own[i, j] = coupling[i, 0, j] = coupling[i, 1, j] = coupling[i, 2, j] = scratch[_SCORE, j] = 0.0
        for k in range(N_LOCAL):
            scratch[j, k] = 0.0
    inverse, total = 1.0 / sigma[i], 0.0
    for nearest in range(n):
        place = seen[i, nearest]
        tx, ty, tz = path[place, 0], path[place, 1], path[place, 2]
        h = 1.0 / (1.0 + state[i, 2] * tz)
        x, y = (state[i, 0] + state[i, 2] * tx) * h, (state[i, 1] + state[i, 2] * ty) * h
        rx, ry = (views[place, 0] - x) * inverse, (views[place, 1] - y) * inverse
        square = rx * rx + ry * ry
        weight = limit / square if square > limit else 1.0
        total += weight * square
        own[i, 7] += min(square, _ROBUST_SIGMAS * _ROBUST_SIGMAS)
        a = h * inverse
        jx, jy = a * (tx - x * tz), a * (ty - y * tz)
        moved, half = state[i, 2] * a * t_s[place], 0.5 * t_s[place]
        for j in range(3):
            gx, gy = moved * (basis[0, j] - x * basis[2, j]), moved * (basis[1, j] - y * basis[2, j])
            if j < 2:
                scratch[_BY_X, j], scratch[_BY_Y, j] = gx, gy
            scratch[_BY_X, 2 + j], scratch[_BY_Y, 2 + j] = half * gx, half * gy
        turned = inverse * t_s[place]
        scratch[_BY_X, 5], scratch[_BY_Y, 5] = -x * y * turned, -(1.0 + y * y) * turned
        scratch[_BY_X, 6], scratch[_BY_Y, 6] = (1.0 + x * x) * turned, x * y * turned
        scratch[_BY_X, 7], scratch[_BY_Y, 7] = -y * turned, x * turned
        own[i, 0] += weight * a * a
        own[i, 1] += weight * a * jx
        own[i, 2] += weight * a * jy
        own[i, 3] += weight * (jx * jx + jy * jy)
        own[i, 4] += weight * a * rx
        own[i, 5] += weight * a * ry
        own[i, 6] += weight * (jx * rx + jy * ry)
        for j in range(N_LOCAL):
            wx, wy = weight * scratch[_BY_X, j], weight * scratch[_BY_Y, j]
            coupling[i, 0, j] += a * wx
            coupling[i, 1, j] += a * wy
            coupling[i, 2, j] += jx * wx + jy * wy
            scratch[_SCORE, j] += rx * wx + ry * wy
            for k in range(j + 1):
                scratch[j, k] += wx * scratch[_BY_X, k] + wy * scratch[_BY_Y, k]
    return total / (2 * n - 3)


@compiled
def _eliminate(i: int, own: Floats, coupling: Floats, scratch: Floats, information: Floats, score: Floats) -> None:
    """Adds to ``information (8, 8)`` and ``score (8,)`` what point i says once x, y, rho follow (Schur complement).

    ``own[i]`` and ``coupling[i]`` become those of rho with x and y eliminated. No information on rho adds nothing.
    """
    rest = 1.0 / own[i, 0]
    left = own[i, 3] - (own[i, 1] * own[i, 1] + own[i, 2] * own[i, 2]) * rest
    is_known = left > 0.0
    own[i, 3], rate_variance = (left, 1.0 / left) if is_known else (0.0, 0.0)
    own[i, 6] -= (own[i, 1] * own[i, 4] + own[i, 2] * own[i, 5]) * rest
    for j in range(N_LOCAL):
        coupling[i, 2, j] -= (own[i, 1] * coupling[i, 0, j] + own[i, 2] * coupling[i, 1, j]) * rest
    for j in range(N_LOCAL if is_known else 0):
        along_x, along_y, along = coupling[i, 0, j] * rest, coupling[i, 1, j] * rest, coupling[i, 2, j] * rate_variance
        score[j] += scratch[_SCORE, j] - along_x * own[i, 4] - along_y * own[i, 5] - along * own[i, 6]
        for k in range(j + 1):
            added = (
                scratch[j, k] - along_x * coupling[i, 0, k] - along_y * coupling[i, 1, k] - along * coupling[i, 2, k]
            )
            information[j, k] += added
            if k < j:
                information[k, j] += added


@compiled
def _follow(i: int, own: Floats, coupling: Floats, step: Floats, state: Floats) -> None:
    """Moves point i by its own part of a joint step: what was eliminated, put back."""
    x, y, rate = own[i, 4], own[i, 5], own[i, 6]
    for j in range(N_LOCAL):
        x -= coupling[i, 0, j] * step[j]
        y -= coupling[i, 1, j] * step[j]
        rate -= coupling[i, 2, j] * step[j]
    is_known = own[i, 3] > 0.0
    rate, rest = (rate / own[i, 3], 1.0 / own[i, 0]) if is_known else (0.0, 0.0)
    state[i, 0] += (x - own[i, 1] * rate) * rest
    state[i, 1] += (y - own[i, 2] * rate) * rest
    state[i, 2] += rate


@compiled
def _start(
    views: Floats, path: Floats, i: int, seen: Ints, n: int, sigma: float, slowest: float, fastest: float, state: Floats
) -> float:
    """Fills ``state[i]`` by the linear solve of x + rho (T_x - x_i T_z) = x_i; returns its mean square residual."""
    x0, y0, rest = views[seen[i, 0], 0], views[seen[i, 0], 1], 1.0 / n
    sum_x, sum_y, sum_jj, right_x, right_y, right, total = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for nearest in range(n):
        place = seen[i, nearest]
        x, y = views[place, 0], views[place, 1]
        jx, jy = path[place, 0] - x * path[place, 2], path[place, 1] - y * path[place, 2]
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
def _rate_limits(path: Floats, i: int, seen: Ints, n: int) -> tuple[float, float]:
    """Rates between which the first n views of point i are in front of the camera."""
    nearest, farthest = 0.0, 0.0
    for view in range(n):
        depth = path[seen[i, view], 2]
        nearest, farthest = min(nearest, depth), max(farthest, depth)
    return -(1.0 - _LEAST_DEPTH_RATIO) / max(farthest, 1e-12), (1.0 - _LEAST_DEPTH_RATIO) / max(-nearest, 1e-12)


@compiled
def _set_path(t_s: Floats, base: Floats, basis: Floats, offset: Floats, path: Floats, rotation: Floats) -> None:
    """Fills the path ``(L, 3)`` at an offset, and the rotations ``(L, 3, 3)`` that turn its views back.

    Those are `rotation.rotation_from_vector` of minus t times the rate.
    """
    wx, wy, wz = offset[5], offset[6], offset[7]
    rate = np.sqrt(wx * wx + wy * wy + wz * wz)
    for k in range(len(t_s)):
        t = t_s[k]
        for j in range(3):
            path[k, j] = base[k, j]
            for m in range(3):
                u = offset[m] if m < 2 else 0.0
                path[k, j] += basis[j, m] * (t * u + 0.5 * t * t * offset[2 + m])
        sine = np.sin(rate * t) / rate if rate > 0.0 else t
        half = np.sin(0.5 * rate * t) / rate if rate > 0.0 else 0.5 * t
        versed = 2.0 * half * half
        rotation[k, 0, 0], rotation[k, 1, 1] = 1.0 - versed * (wy * wy + wz * wz), 1.0 - versed * (wx * wx + wz * wz)
        rotation[k, 2, 2] = 1.0 - versed * (wx * wx + wy * wy)
        rotation[k, 0, 1], rotation[k, 1, 0] = versed * wx * wy + sine * wz, versed * wx * wy - sine * wz
        rotation[k, 0, 2], rotation[k, 2, 0] = versed * wx * wz - sine * wy, versed * wx * wz + sine * wy
        rotation[k, 1, 2], rotation[k, 2, 1] = versed * wy * wz + sine * wx, versed * wy * wz - sine * wx


@compiled
def _turn(xy: Floats, rotation: Floats, i: int, seen: Ints, n: int, views: Floats) -> None:
    """Fills ``views (L, 2)`` with the first n of point i turned by ``rotation (L, 3, 3)``."""
    for nearest in range(n):
        k = seen[i, nearest]
        x, y = xy[k, i, 0], xy[k, i, 1]
        depth = 1.0 / (rotation[k, 2, 0] * x + rotation[k, 2, 1] * y + rotation[k, 2, 2])
        views[k, 0] = (rotation[k, 0, 0] * x + rotation[k, 0, 1] * y + rotation[k, 0, 2]) * depth
        views[k, 1] = (rotation[k, 1, 0] * x + rotation[k, 1, 1] * y + rotation[k, 1, 2]) * depth


@compiled
def _set_own_motion(turns_itself: bool, basis: Floats, state: Floats, own_motion: Floats) -> None:
    """Fills the matrix ``(8, 8)`` that takes shared offsets to the motion of the middle of what turns itself.

    Views of a point at C + V t + A t^2 / 2, turned back at the rate omega, show it moving by
    (V - omega x C) t + (A - 2 omega x V) t^2 / 2, to first order in omega. The offsets are the latter. C is (x, y, 1) /
    rho of the middle of the points, in units in which the speed is 1, and V the unit vector of the direction.
    """
    for j in range(N_LOCAL):
        for k in range(N_LOCAL):
            own_motion[j, k] = 1.0 if j == k else 0.0
    if not turns_itself or len(state) == 0:
        return
    rate = np.median(state[:, 2])
    if rate > 0.0:
        x, y, z = np.median(state[:, 0]) / rate, np.median(state[:, 1]) / rate, 1.0 / rate
        for j in range(2):
            # omega x C along the axis b is omega . (C x b).
            own_motion[j, 5] = y * basis[2, j] - z * basis[1, j]
            own_motion[j, 6] = z * basis[0, j] - x * basis[2, j]
            own_motion[j, 7] = x * basis[1, j] - y * basis[0, j]
    e = basis[:, 2]
    for j in range(3):
        own_motion[2 + j, 5] = 2.0 * (e[1] * basis[2, j] - e[2] * basis[1, j])
        own_motion[2 + j, 6] = 2.0 * (e[2] * basis[0, j] - e[0] * basis[2, j])
        own_motion[2 + j, 7] = 2.0 * (e[0] * basis[1, j] - e[1] * basis[0, j])


@compiled
def _set_belief(prior: Floats, own_motion: Floats, believed: Floats) -> None:
    """Fills ``believed (8, 8)`` with the information on offsets that ``prior`` means: M' prior M."""
    for j in range(N_LOCAL):
        for k in range(N_LOCAL):
            believed[j, k] = 0.0
            for m in range(N_LOCAL):
                for n in range(N_LOCAL):
                    believed[j, k] += own_motion[m, j] * prior[m, n] * own_motion[n, k]


@compiled
def _set_prior(prior: Floats, offset: Floats, information: Floats, score: Floats) -> None:
    """Fills information and score with what the belief says at an offset from it."""
    for j in range(N_LOCAL):
        score[j] = 0.0
        for k in range(N_LOCAL):
            information[j, k] = prior[j, k]
            score[j] -= prior[j, k] * offset[k]


@compiled
def _solve(matrix: Floats, right: Floats, solution: Floats) -> float:
    """Fills the solution of a positive definite system, by elimination; returns ``right . solution``.

    As in `two_view_descent`, whose file a compiled function may not call.
    """
    rest = matrix.copy()
    solution[:] = right
    for j in range(N_LOCAL):
        for i in range(j + 1, N_LOCAL):
            factor = rest[i, j] / rest[j, j]
            solution[i] -= factor * solution[j]
            for k in range(j, N_LOCAL):
                rest[i, k] -= factor * rest[j, k]
    fall = 0.0
    for j in range(N_LOCAL - 1, -1, -1):
        for k in range(j + 1, N_LOCAL):
            solution[j] -= rest[j, k] * solution[k]
        solution[j] /= rest[j, j]
        fall += right[j] * solution[j]
    return fall
