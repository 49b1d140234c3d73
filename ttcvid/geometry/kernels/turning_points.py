"""The motion of one body that turns, and its points, together.

A point at (x, y, 1) now, kappa times as near as the body's middle C, is seen at time t along

    X(t) = R(t) (x, y, 1) + kappa S(t),    S(t) = (1 - R(t)) C + V t + G(t) A,    G(t) = int_0^t (t - s) R(s) ds,

R(t) the rotation by omega t: the middle starts with V and has the acceleration A in axes that turn with the body, as on
a circle. Lengths are in units of the middle's depth. `N_SHARED` unknowns in this order: V, A, omega.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.geometry.kernels.arrays import copy, copy_rows
from ttcvid.geometry.kernels.medians import median
from ttcvid.geometry.kernels.normal_equations import add_equations, mirror
from ttcvid.geometry.kernels.path_point import ROBUST_SIGMAS
from ttcvid.geometry.kernels.rotations import fill_rotation
from ttcvid.geometry.kernels.solve import eliminate, follow, solve
from ttcvid.model import Floats

N_SHARED = 9
"""Unknowns that the points of a body share."""

_MAX_STEPS = 25
# Damping (Levenberg and Marquardt): a part of the diagonal, less after a good step, more after a bad one.
_FIRST_DAMPING, _LEAST_DAMPING, _LESS, _MORE, _MOST_DAMPING = 1e-3, 1e-7, 0.2, 8.0, 1e4
# Nothing comes nearer to the camera than this part of its present depth: a path folds over behind it.
_LEAST_DEPTH = 0.05
# Below this angle the series is more exact than the closed form, rad.
_SMALL_RAD = 1e-2
# Step of numerical derivatives by what is shared.
_STEP = 1e-5
# A velocity is known to this in any case, in depths a second: no system is without a solution.
_FASTEST_HZ = 100.0
# Unknowns of a point, and of it and the body together.
_N_OWN, _N_ALL = 3, 3 + N_SHARED

_Views = tuple[Floats, Floats, Floats, Floats]
"""Views ``xy (L, N, 2)``, NaN where not seen, times ``t_s (L,)``, noise ``(N,)`` and the middle now, (x, y, 1)."""
_Way = tuple[Floats, Floats]
"""R (L, 3, 3) and S (L, 3) of each view."""
_Belief = tuple[Floats, Floats, float]
"""Mean (9,) and information (9,) of what is shared, and information on kappa, about 1."""


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], f8[::1], f8[::1])), f8[::1], f8[::1], f8, f8[:, ::1], f8[::1], f8[:, ::1], "
    "f8[::1])"
)
def fit_turning_points(
    views: _Views,
    mean_turn: Floats,
    beliefs: Floats,
    converged_chi2: float,
    own: Floats,
    shared: Floats,
    information: Floats,
    left: Floats,
) -> None:
    """Change ``own (N, 3)`` (x, y, kappa) and ``shared (9,)`` from where they start to where they fit best.

    Fills ``information (9, 9)`` on what is shared, once the points follow, and ``left (2,)``: the squared residuals in
    sigmas, none counted for more than the robust limit, and the points' median of them by the degree of freedom.

    Parameters
    ----------
    mean_turn : (3,) belief in the turn, rad/s.
    beliefs : standard deviations of the turn, of the acceleration over the speed, of which the third is the least, and
        of kappa about 1.
    converged_chi2 : the search ends when a step promises a smaller fall of the chi-square.

    A start that brings a point too near is none: nothing changes, and its squares are infinite.
    """
    _, t_s, _, centre = views
    n_views, n = len(t_s), len(own)
    way = np.empty((n_views, 3, 3)), np.empty((n_views, 3))
    trial_way = np.empty((n_views, 3, 3)), np.empty((n_views, 3))
    squares, trial_squares, per_point = np.empty((n, n_views)), np.empty((n, n_views)), np.empty(n)
    of_points, kept = np.empty((n, _N_ALL + 1, _N_ALL)), np.empty((n, _N_ALL + 1, _N_OWN))
    score, step = np.empty(N_SHARED), np.empty(_N_ALL)
    prior, mean, trial, trial_own = np.empty(N_SHARED), np.zeros(N_SHARED), np.empty(N_SHARED), np.empty_like(own)
    copy(mean_turn, mean[6:])
    damping, n_steps, is_over = _FIRST_DAMPING, 0, False
    left[0], left[1] = np.inf, 1.0
    for j in range(N_SHARED):
        for k in range(N_SHARED):
            information[j, k] = 1.0 if j == k else 0.0
    set_trajectory(t_s, centre, shared, way[0], way[1])
    if not _set_squares(views, way, own, squares, per_point):
        return
    usual = median(per_point)
    while True:
        # Beliefs weigh as much beside views that err by more than they should, but not in what is told at the end.
        scale2 = max(1.0, usual)
        weight, far = (1.0 if is_over else scale2), ROBUST_SIGMAS * ROBUST_SIGMAS * scale2
        speed = max(np.sqrt(shared[0] ** 2 + shared[1] ** 2 + shared[2] ** 2), beliefs[2])
        for j in range(3):
            prior[j], prior[3 + j] = weight * _FASTEST_HZ**-2, weight * (beliefs[1] * speed) ** -2
            prior[6 + j] = weight * beliefs[0] ** -2
        belief = mean, prior, weight / beliefs[3] ** 2
        _set_equations(views, way, shared, own, far, belief, trial_way, of_points)
        if is_over:
            break
        before = _cost(squares, far, shared, own, belief)
        is_better, fall = False, 0.0
        while damping < _MOST_DAMPING and not is_better:
            fall = _add_up(of_points, shared, belief, damping, kept, information, score)
            fall += solve(information, score)
            for j in range(N_SHARED):
                trial[j] = shared[j] + score[j]
            copy(score, step[_N_OWN:])
            for i in range(n):
                follow(kept[i], step)
                for c in range(_N_OWN):
                    trial_own[i, c] = own[i, c] + step[c]
            set_trajectory(t_s, centre, trial, trial_way[0], trial_way[1])
            if _set_squares(views, trial_way, trial_own, trial_squares, per_point):
                is_better = _cost(trial_squares, far, trial, trial_own, belief) < before
            if not is_better:
                damping *= _MORE
        n_steps += 1
        is_over = not is_better or n_steps == _MAX_STEPS or fall < converged_chi2 * scale2
        if is_better:
            damping, usual = max(_LESS * damping, _LEAST_DAMPING), median(per_point)
            copy(trial, shared)
            copy_rows(trial_own, own)
            copy_rows(trial_squares, squares)
            way, trial_way = trial_way, way
    left[0], left[1] = 0.0, usual
    for i in range(n):
        for k in range(n_views):
            left[0] += min(squares[i, k], ROBUST_SIGMAS**2)
    _add_up(of_points, shared, belief, 0.0, kept, information, score)
    mirror(information)


@compiled_for("(f8[::1], f8[::1], f8[::1], f8[:, :, ::1], f8[:, ::1])")
def set_trajectory(t_s: Floats, centre: Floats, shared: Floats, rotations: Floats, shift: Floats) -> None:
    """Fill R (L, 3, 3) and S (L, 3) for what is shared, with the middle now at ``centre (3,)``."""
    ax, ay, az, x, y, z = shared[3], shared[4], shared[5], shared[6], shared[7], shared[8]
    rate2, along = x * x + y * y + z * z, x * ax + y * ay + z * az
    rate = np.sqrt(rate2)
    for k in range(len(t_s)):
        t = t_s[k]
        fill_rotation(t * x, t * y, t * z, rotations[k])
        # G is t^2 / 2, and these times omega x and (omega x)^2.
        angle2, both = rate2 * t * t, t * t
        if angle2 < _SMALL_RAD * _SMALL_RAD:
            once, twice = both * t * (1.0 / 6.0 - angle2 / 120.0), both * both * (1.0 / 24.0 - angle2 / 720.0)
        else:
            sine = np.sin(0.5 * rate * t) / rate
            once, twice = (t - np.sin(rate * t) / rate) / rate2, (0.5 * both - 2.0 * sine * sine) / rate2
        half = 0.5 * both - twice * rate2
        shift[k, 0] = half * ax + once * (y * az - z * ay) + twice * x * along
        shift[k, 1] = half * ay + once * (z * ax - x * az) + twice * y * along
        shift[k, 2] = half * az + once * (x * ay - y * ax) + twice * z * along
        for j in range(3):
            shift[k, j] += centre[j] + t * shared[j]
            for m in range(3):
                shift[k, j] -= rotations[k, j, m] * centre[m]


@compiled
def _set_squares(views: _Views, way: _Way, own: Floats, squares: Floats, per_point: Floats) -> bool:
    """Fill the squared residuals ``squares (N, L)``, 0 where not seen, and their sums by the degree of freedom, (N,).

    Returns False with a point too near.
    """
    xy, _, sigma, _ = views
    r, shift = way
    for i in range(len(own)):
        n, inverse, per_point[i], x, y, kappa = 0, 1.0 / sigma[i], 0.0, own[i, 0], own[i, 1], own[i, 2]
        for k in range(len(xy)):
            squares[i, k] = 0.0
            if not np.isfinite(xy[k, i, 0]):
                continue
            z = r[k, 2, 0] * x + r[k, 2, 1] * y + r[k, 2, 2] + kappa * shift[k, 2]
            if z < _LEAST_DEPTH:
                return False
            rx = (r[k, 0, 0] * x + r[k, 0, 1] * y + r[k, 0, 2] + kappa * shift[k, 0]) / z - xy[k, i, 0]
            ry = (r[k, 1, 0] * x + r[k, 1, 1] * y + r[k, 1, 2] + kappa * shift[k, 1]) / z - xy[k, i, 1]
            squares[i, k] = (rx * rx + ry * ry) * inverse * inverse
            per_point[i] += squares[i, k]
            n += 1
        per_point[i] /= max(2 * n - 3, 1)
    return True


@compiled
def _cost(squares: Floats, far: float, shared: Floats, own: Floats, belief: _Belief) -> float:
    """Sum of squared residuals, which grow as their logarithm beyond ``far``, and what the beliefs add to it."""
    mean, prior, loose = belief
    total = 0.0
    for j in range(N_SHARED):
        total += prior[j] * (shared[j] - mean[j]) ** 2
    for i in range(len(own)):
        total += loose * (own[i, 2] - 1.0) ** 2
        for k in range(squares.shape[1]):
            total += squares[i, k] if squares[i, k] < far else far * (1.0 + np.log(squares[i, k] / far))
    return total


@compiled
def _set_equations(
    views: _Views, way: _Way, shared: Floats, own: Floats, far: float, belief: _Belief, other: _Way, of_points: Floats
) -> None:
    """Fill ``of_points (N, 13, 12)``: information, its lower half, of a point and its body, in the last row the score.

    How R and S follow what is shared is taken by differences, with a way that is no further use, ``other``.
    """
    xy, t_s, sigma, centre = views
    r, shift = way
    n_views = len(t_s)
    rows, moves, moved = np.empty((_N_ALL + 1, 2 * n_views)), np.empty((_N_ALL, 3)), np.empty(N_SHARED)
    turned, dragged = np.empty((3, n_views, 3, 3)), np.empty((N_SHARED, n_views, 3))
    for j in range(N_SHARED):
        copy(shared, moved)
        moved[j] += _STEP
        set_trajectory(t_s, centre, moved, other[0], other[1])
        for k in range(n_views):
            for a in range(3):
                dragged[j, k, a] = (other[1][k, a] - shift[k, a]) / _STEP
                for b in range(3):
                    turned[j % 3, k, a, b] = (other[0][k, a, b] - r[k, a, b]) / _STEP
    of_points[:] = 0.0
    for i in range(len(own)):
        n, inverse, x, y, kappa = 0, 1.0 / sigma[i], own[i, 0], own[i, 1], own[i, 2]
        for k in range(n_views):
            if not np.isfinite(xy[k, i, 0]):
                continue
            # How X follows the unknowns.
            for a in range(3):
                moves[0, a], moves[1, a], moves[2, a] = r[k, a, 0], r[k, a, 1], shift[k, a]
                for j in range(N_SHARED):
                    moves[_N_OWN + j, a] = kappa * dragged[j, k, a]
                for j in range(3):
                    moves[9 + j, a] += turned[j, k, a, 0] * x + turned[j, k, a, 1] * y + turned[j, k, a, 2]
            h = 1.0 / (r[k, 2, 0] * x + r[k, 2, 1] * y + r[k, 2, 2] + kappa * shift[k, 2])
            u = (r[k, 0, 0] * x + r[k, 0, 1] * y + r[k, 0, 2] + kappa * shift[k, 0]) * h
            v = (r[k, 1, 0] * x + r[k, 1, 1] * y + r[k, 1, 2] + kappa * shift[k, 1]) * h
            rx, ry = (xy[k, i, 0] - u) * inverse, (xy[k, i, 1] - v) * inverse
            root = np.sqrt(far / max(rx * rx + ry * ry, far))
            for j in range(_N_ALL):
                rows[j, n] = root * h * inverse * (moves[j, 0] - u * moves[j, 2])
                rows[j, n + 1] = root * h * inverse * (moves[j, 1] - v * moves[j, 2])
            rows[_N_ALL, n], rows[_N_ALL, n + 1] = root * rx, root * ry
            n += 2
        add_equations(rows, n, of_points[i], of_points[i, _N_ALL])
        of_points[i, 2, 2] += belief[2]
        of_points[i, _N_ALL, 2] -= belief[2] * (kappa - 1.0)


@compiled
def _add_up(
    of_points: Floats, shared: Floats, belief: _Belief, damping: float, kept: Floats, information: Floats, score: Floats
) -> float:
    """Fill ``information (9, 9)``, its lower half, and ``score (9,)``, with the points following; damped.

    Fills ``kept (N, 13, 3)`` as `solve.eliminate` does, and returns by how much the points alone lower chi-square.
    """
    mean, prior, _ = belief
    equations, fall = np.empty((_N_ALL + 1, _N_ALL)), 0.0
    for c in range(N_SHARED):
        information[c, :], information[c, c] = 0.0, (1.0 + damping) * prior[c]
        score[c] = -prior[c] * (shared[c] - mean[c])
    for i in range(len(of_points)):
        copy_rows(of_points[i], equations)
        for c in range(_N_ALL):
            equations[c, c] *= 1.0 + damping
        eliminate(equations, kept[i], information, score)
        for c in range(_N_OWN):
            fall += kept[i, _N_ALL, c] ** 2 / kept[i, c, c]
    return fall
