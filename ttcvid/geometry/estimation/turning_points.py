"""The motion of one body that turns, and its points, together, by damped Gauss-Newton.

A point at (x, y, 1) now, kappa times as near as the body's middle C, is seen at time t along

    X(t) = R(t) (x, y, 1) + kappa S(t),    S(t) = (1 - R(t)) C + V t + G(t) A,    G(t) = int_0^t (t - s) R(s) ds,

R(t) the rotation by omega t: the middle starts with V and has the acceleration A in axes that turn with the body, as on
a circle. Lengths are in units of the middle's depth. What is shared, nine unknowns, in this order: V, A, omega.
"""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import ZERO, compiled_for
from ttcvid.geometry.kernels.medians import median
from ttcvid.geometry.kernels.normal_equations import add_equations
from ttcvid.geometry.kernels.path_point import ROBUST_SIGMAS
from ttcvid.geometry.kernels.rotations import fill_rotation
from ttcvid.geometry.kernels.solve import eliminate, follow, solve
from ttcvid.model import Floats

# Unknowns of a point, x, y, kappa, of the body, and of both.
_N_OWN, _N_SHARED, _N_ALL = 3, 9, 12
_MAX_STEPS = 25
# Damping (Levenberg and Marquardt): a part of the diagonal, less after a good step, more after a bad one.
_FIRST_DAMPING, _LEAST_DAMPING, _LESS, _MORE, _MOST_DAMPING = 1e-3, 1e-7, 0.2, 8.0, 1e4
# A velocity is known to this in any case, in depths a second: no system is without a solution.
_FASTEST_HZ = 100.0
# Nothing comes nearer to the camera than this part of its present depth: a path folds over behind it.
_LEAST_DEPTH = 0.05
# Below this angle the series is more exact than the closed form, rad.
_SMALL_RAD = 1e-2
# Step of numerical derivatives by what is shared.
_STEP = 1e-5

Views = tuple[Floats, Floats, Floats, Floats]
"""Of N points of a body: ``xy (L, N, 2)``, NaN where not seen, at ``t_s (L,)``; their noise ``sigma (N,)``; the body's
middle now, ``centre (3,)`` = (x, y, 1).
"""
Beliefs = tuple[Floats, float, float, float, float]
"""Of a body before it is seen: turn ``(3,)`` in rad/s and its standard deviation, that of the acceleration over the
speed in 1/s, which is taken as so much at least, in 1/s, and that of kappa about 1.
"""


def trajectory(t_s: Floats, centre: Floats, shared: Floats) -> tuple[Floats, Floats]:
    """R ``(L, 3, 3)`` and S ``(L, 3)`` at times ``(L,)`` for what is shared, ``(9,)``.

    The body's middle is now at ``centre (3,)``.
    """
    rotations, bends, shift = np.empty((len(t_s), 3, 3)), np.empty((len(t_s), 3, 3)), np.empty((len(t_s), 3))
    _set_trajectory(t_s, centre, shared, rotations, bends, shift)
    return rotations, shift


@compiled_for("(f8[::1], f8[::1], f8[::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1])")
def _set_trajectory(
    t_s: Floats, centre: Floats, shared: Floats, rotations: Floats, bends: Floats, shift: Floats
) -> None:
    """Fill R and G (L, 3, 3) and S (L, 3) for what is shared, with the middle now at ``centre (3,)``."""
    x, y, z = shared[6], shared[7], shared[8]
    rate2 = x * x + y * y + z * z
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
        half, g = 0.5 * both - twice * rate2, bends[k]
        g[0, 0], g[0, 1], g[0, 2] = half + twice * x * x, twice * x * y - once * z, twice * x * z + once * y
        g[1, 0], g[1, 1], g[1, 2] = twice * x * y + once * z, half + twice * y * y, twice * y * z - once * x
        g[2, 0], g[2, 1], g[2, 2] = twice * x * z - once * y, twice * y * z + once * x, half + twice * z * z
        for j in range(3):
            shift[k, j] = centre[j] + t * shared[j]
            for m in range(3):
                shift[k, j] += g[j, m] * shared[3 + m] - rotations[k, j, m] * centre[m]


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], f8[::1], f8[::1])), Tuple((f8[::1], f8, f8, f8, f8)), f8, f8[:, ::1], f8[::1], "
    "f8[:, ::1])"
)
def fit_turning_points(
    views: Views, beliefs: Beliefs, converged_chi2: float, own: Floats, shared: Floats, information: Floats
) -> tuple[float, float]:
    """Move points and body, ``own (N, 3)`` (x, y, kappa) and ``shared (9,)``, to where they fit best.

    Fills ``information (9, 9)`` on what is shared, once the points follow. Returns the squares of the residuals in
    sigmas, none counted for more than the robust limit, and the points' median of them by the degree of freedom. The
    search ends when a step promises a smaller fall of chi-square than ``converged_chi2``. A start that brings a point
    too near is none: nothing changes, and its squares are infinite.

    The cost of a place is its squared residuals, which grow as their logarithm beyond the robust limit, and beliefs.
    How R and S follow the turn is taken by differences.
    """
    xy, t_s, sigma, centre = views
    mean_turn_rad_s, turn_sigma_rad_s, bend_hz, least_speed_hz, relief = beliefs
    n_points, n_views, loose = len(own), len(t_s), relief**-2
    r, bends, shift = np.empty((n_views, 3, 3)), np.empty((n_views, 3, 3)), np.empty((n_views, 3))
    other_r, other_bends, other_shift = np.empty_like(r), np.empty_like(r), np.empty_like(shift)
    turned, dragged = np.empty((3, n_views, 3, 3)), np.empty((_N_SHARED, n_views, 3))
    rows, moves, moved = np.empty((_N_ALL + 1, 2 * n_views)), np.empty((_N_ALL, 3)), shared.copy()
    of_points, kept = np.empty((n_points, _N_ALL + 1, _N_ALL)), np.empty((n_points, _N_OWN, _N_ALL + 1))
    equations, per_point, trial = np.empty((_N_ALL + 1, _N_ALL)), np.empty(n_points), own.copy()
    precision, mean, step = np.zeros(_N_SHARED), np.zeros(_N_SHARED), np.empty(_N_ALL)
    score = step[_N_OWN:]
    for c in range(3):
        mean[6 + c] = mean_turn_rad_s[c]
    n_steps, damping, cost, fall, scale2, squares, median_chi2 = ZERO, _FIRST_DAMPING, np.inf, np.inf, 1.0, np.inf, 1.0
    while True:
        # The trial, its cost by the scale of the place that it starts from.
        _set_trajectory(t_s, centre, moved, r, bends, shift)
        far, trial_cost, trial_squares = ROBUST_SIGMAS**2 * scale2, 0.0, 0.0
        for i in range(n_points):
            n, inverse, per_point[i], x, y, kappa = 0, 1.0 / sigma[i], 0.0, trial[i, 0], trial[i, 1], trial[i, 2]
            trial_cost += scale2 * loose * (kappa - 1.0) ** 2
            for k in range(n_views):
                if not np.isfinite(xy[k, i, 0]):
                    continue
                z = r[k, 2, 0] * x + r[k, 2, 1] * y + r[k, 2, 2] + kappa * shift[k, 2]
                rx = (r[k, 0, 0] * x + r[k, 0, 1] * y + r[k, 0, 2] + kappa * shift[k, 0]) / z - xy[k, i, 0]
                ry = (r[k, 1, 0] * x + r[k, 1, 1] * y + r[k, 1, 2] + kappa * shift[k, 1]) / z - xy[k, i, 1]
                square = (rx * rx + ry * ry) * inverse * inverse
                trial_cost += square if square < far else far + far * np.log(square / far)
                trial_cost += np.inf if z < _LEAST_DEPTH else 0.0
                trial_squares += min(square, ROBUST_SIGMAS**2)
                per_point[i] += square
                n += 1
            per_point[i] /= max(2 * n - 3, 1)
        for c in range(_N_SHARED):
            trial_cost += scale2 * precision[c] * (moved[c] - mean[c]) ** 2
        if trial_cost < cost:
            is_done = fall < converged_chi2 * scale2 or n_steps == _MAX_STEPS
            damping = damping if n_steps == 0 else max(_LESS * damping, _LEAST_DAMPING)
            n_steps += 1
            # Beliefs weigh as much beside views that err by more than they should.
            squares, median_chi2, cost = trial_squares, median(per_point), 0.0
            scale2 = max(1.0, median_chi2)
            far = ROBUST_SIGMAS**2 * scale2
            speed2 = max(moved[0] ** 2 + moved[1] ** 2 + moved[2] ** 2, least_speed_hz**2)
            for c in range(3):
                precision[c], precision[3 + c] = _FASTEST_HZ**-2, 1.0 / (bend_hz * bend_hz * speed2)
                precision[6 + c] = turn_sigma_rad_s**-2
            for c in range(_N_SHARED):
                shared[c] = moved[c]
                cost += scale2 * precision[c] * (shared[c] - mean[c]) ** 2
            for j in range(3):
                moved[6 + j] = shared[6 + j] + _STEP
                _set_trajectory(t_s, centre, moved, other_r, other_bends, other_shift)
                moved[6 + j] = shared[6 + j]
                for k in range(n_views):
                    for a in range(3):
                        dragged[j, k, a], dragged[3 + j, k, a] = t_s[k] if a == j else 0.0, bends[k, a, j]
                        dragged[6 + j, k, a] = (other_shift[k, a] - shift[k, a]) / _STEP
                        for b in range(3):
                            turned[j, k, a, b] = (other_r[k, a, b] - r[k, a, b]) / _STEP
            of_points[:] = 0.0
            for i in range(n_points):
                n, inverse, x, y, kappa = 0, 1.0 / sigma[i], trial[i, 0], trial[i, 1], trial[i, 2]
                own[i, 0], own[i, 1], own[i, 2] = x, y, kappa
                cost += scale2 * loose * (kappa - 1.0) ** 2
                for k in range(n_views):
                    if not np.isfinite(xy[k, i, 0]):
                        continue
                    # How X follows the unknowns.
                    for a in range(3):
                        moves[0, a], moves[1, a], moves[2, a] = r[k, a, 0], r[k, a, 1], shift[k, a]
                        for j in range(_N_SHARED):
                            moves[_N_OWN + j, a] = kappa * dragged[j, k, a]
                        for j in range(3):
                            moves[9 + j, a] += turned[j, k, a, 0] * x + turned[j, k, a, 1] * y + turned[j, k, a, 2]
                    h = 1.0 / (r[k, 2, 0] * x + r[k, 2, 1] * y + r[k, 2, 2] + kappa * shift[k, 2])
                    u = (r[k, 0, 0] * x + r[k, 0, 1] * y + r[k, 0, 2] + kappa * shift[k, 0]) * h
                    v = (r[k, 1, 0] * x + r[k, 1, 1] * y + r[k, 1, 2] + kappa * shift[k, 1]) * h
                    rx, ry = (xy[k, i, 0] - u) * inverse, (xy[k, i, 1] - v) * inverse
                    square = rx * rx + ry * ry
                    cost += square if square < far else far + far * np.log(square / far)
                    root = np.sqrt(far / max(square, far))
                    for j in range(_N_ALL):
                        rows[j, n] = root * h * inverse * (moves[j, 0] - u * moves[j, 2])
                        rows[j, n + 1] = root * h * inverse * (moves[j, 1] - v * moves[j, 2])
                    rows[_N_ALL, n], rows[_N_ALL, n + 1] = root * rx, root * ry
                    n += 2
                add_equations(rows, n, of_points[i], of_points[i, _N_ALL])
        elif n_steps == 0:
            return squares, median_chi2
        else:
            damping *= _MORE
            is_done = damping >= _MOST_DAMPING
        # What is told at the end counts beliefs as they are, and nothing is damped.
        weight, damped, fall = (1.0, 1.0, 0.0) if is_done else (scale2, 1.0 + damping, 0.0)
        for c in range(_N_SHARED):
            for d in range(c):
                information[c, d] = 0.0
            information[c, c] = damped * weight * precision[c]
            score[c] = weight * precision[c] * (mean[c] - shared[c])
        for i in range(n_points):
            for c in range(_N_ALL + 1):
                for d in range(_N_ALL):
                    equations[c, d] = of_points[i, c, d]
            equations[2, 2] += weight * loose
            equations[_N_ALL, 2] -= weight * loose * (own[i, 2] - 1.0)
            for c in range(_N_ALL):
                equations[c, c] *= damped
            eliminate(equations, kept[i], information, score)
            for c in range(_N_OWN):
                fall += kept[i, c, _N_ALL] ** 2 / kept[i, c, c]
        if is_done:
            for c in range(_N_SHARED):
                for d in range(c):
                    information[d, c] = information[c, d]
            return squares, median_chi2
        fall += solve(information, score)
        for c in range(_N_SHARED):
            moved[c] = shared[c] + score[c]
        for i in range(n_points):
            follow(kept[i], step)
            for c in range(_N_OWN):
                trial[i, c] = own[i, c] + step[c]
