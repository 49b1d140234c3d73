"""The inner loops of `turning_body`, compiled: one body's motion and its points together, step by step.

A point at (x, y, 1) now, kappa times as near as the body's middle C, is seen at time t along

    X(t) = R(t) (x, y, 1) + kappa S(t),    S(t) = (1 - R(t)) C + V t + G(t) A,    G(t) = int_0^t (t - s) R(s) ds,

R(t) the rotation by omega t: the middle starts with V and has the acceleration A in axes that turn with the body, as on
a circle. Lengths are in units of the middle's depth. `N_SHARED` unknowns in this order: V, A, omega.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.model import Floats

N_SHARED = 9
"""Unknowns that the points of a body share."""

# A view weighs less beyond so many of its standard deviations, times the usual residual.
_ROBUST_SIGMAS = 3.0
_MAX_STEPS = 25
# Damping (Levenberg and Marquardt): a part of the diagonal, less after a good step, more after a bad one.
_FIRST_DAMPING, _LEAST_DAMPING, _LESS, _MORE, _MOST_DAMPING = 1e-3, 1e-7, 0.2, 8.0, 1e4
# Nothing comes nearer to the camera than this part of its present depth: a path folds over behind it.
_LEAST_DEPTH = 0.05
# Below this angle the series is more exact than the closed form, rad.
_SMALL_RAD = 1e-2
_DIFFERENCE_RAD_S = 1e-5
# A velocity is known to this in any case, in depths a second: no system is without a solution.
_FASTEST_HZ = 100.0
# Numbers of a view: R (9), S (3), G (9), how R p and S follow a change of omega (9 and 9), time.
_S, _G, _TURNED, _DRAGGED, _TIME, _N_WAY = 9, 12, 21, 30, 39, 40
# Kept of a point: its block of the information (3 x 3), its couplings (3 x 9) and its score (3).
_N_KEPT = 13


@compiled
def descend(
    xy: Floats,
    t_s: Floats,
    sigma: Floats,
    centre: Floats,
    mean_turn: Floats,
    turn_sigma: float,
    bend_hz: float,
    least_speed_hz: float,
    relief: float,
    converged_chi2: float,
    own: Floats,
    shared: Floats,
    information: Floats,
    left: Floats,
) -> None:
    """Changes ``own (N, 3)`` (x, y, kappa) and ``shared (9,)`` from where they start to where they fit best.

    Fills ``information (9, 9)`` on what is shared, once the points follow, and ``left (2,)``: the squared residuals in
    sigmas, none counted for more than the robust limit, and the points' median of them by the degree of freedom.

    Parameters
    ----------
    xy, t_s, sigma : views (L, N, 2), NaN where not seen, times (L,), noise (N,).
    centre : (3,) the middle now, (x, y, 1).
    mean_turn, turn_sigma : (3,) belief in the turn, rad/s; ``bend_hz`` that in the acceleration over the speed, of
        which ``least_speed_hz`` is the least; ``relief`` that in kappa about 1.
    converged_chi2 : the search ends when a step promises a smaller fall of the chi-square.
    """
    n = len(own)
    way, trial_way = np.empty((len(t_s), _N_WAY)), np.empty((len(t_s), _N_WAY))
    kept, squares = np.empty((n, 3, _N_KEPT)), np.empty(n)
    score, step, damped = np.empty(N_SHARED), np.empty(N_SHARED), np.empty((N_SHARED, N_SHARED))
    prior, trial, trial_own = np.zeros(N_SHARED), np.empty(N_SHARED), np.empty_like(own)
    damping = _FIRST_DAMPING
    _set_way(t_s, centre, shared, way)
    _cost(xy, sigma, way, own, 1e12, squares)
    for _ in range(_MAX_STEPS):
        scale = np.sqrt(max(1.0, np.median(squares)))
        far = (_ROBUST_SIGMAS * scale) ** 2
        speed = max(np.sqrt(shared[0] ** 2 + shared[1] ** 2 + shared[2] ** 2), least_speed_hz)
        for j in range(3):
            prior[j] = (scale / _FASTEST_HZ) ** 2
            prior[3 + j], prior[6 + j] = (scale / (bend_hz * speed)) ** 2, (scale / turn_sigma) ** 2
        loose = (scale / relief) ** 2
        information[:], score[:] = 0.0, 0.0
        for j in range(N_SHARED):
            information[j, j] = prior[j]
            score[j] = -prior[j] * (shared[j] - (mean_turn[j - 6] if j >= 6 else 0.0))
        for i in range(n):
            _add_up(xy, way, i, own, sigma[i], far, loose, kept, information, score)
        _mirror(information)
        before = _cost(xy, sigma, way, own, far, squares) + _believed(shared, own, mean_turn, prior, loose)
        is_better, fall = False, 0.0
        while damping < _MOST_DAMPING:
            fall = _step(kept, information, score, damping, damped, step, own, trial_own)
            for j in range(N_SHARED):
                trial[j] = shared[j] + step[j]
            _set_way(t_s, centre, trial, trial_way)
            after = _cost(xy, sigma, trial_way, trial_own, far, squares)
            after += _believed(trial, trial_own, mean_turn, prior, loose)
            is_better = after < before
            if is_better:
                break
            damping *= _MORE
        if not is_better:
            break
        damping = max(_LESS * damping, _LEAST_DAMPING)
        shared[:], own[:], way[:] = trial, trial_own, trial_way
        if fall < converged_chi2 * scale * scale:
            break
    # The information at the end, without damping.
    information[:], score[:] = 0.0, 0.0
    left[0] = _cost(xy, sigma, way, own, -(_ROBUST_SIGMAS**2), squares)
    left[1] = np.median(squares)
    scale = np.sqrt(max(1.0, left[1]))
    speed = max(np.sqrt(shared[0] ** 2 + shared[1] ** 2 + shared[2] ** 2), least_speed_hz)
    for i in range(n):
        _add_up(xy, way, i, own, sigma[i], (_ROBUST_SIGMAS * scale) ** 2, 1.0 / relief**2, kept, information, score)
    _mirror(information)
    _eliminate(kept, information, score, 0.0)
    for j in range(3):
        information[j, j] += 1.0 / _FASTEST_HZ**2
        information[3 + j, 3 + j] += 1.0 / (bend_hz * speed) ** 2
        information[6 + j, 6 + j] += 1.0 / turn_sigma**2


@compiled
def _believed(shared: Floats, own: Floats, mean_turn: Floats, prior: Floats, loose: float) -> float:
    """What the beliefs add to the cost."""
    total = 0.0
    for j in range(N_SHARED):
        total += prior[j] * (shared[j] - (mean_turn[j - 6] if j >= 6 else 0.0)) ** 2
    for i in range(len(own)):
        total += loose * (own[i, 2] - 1.0) ** 2
    return total


@compiled
def _cost(xy: Floats, sigma: Floats, way: Floats, own: Floats, far: float, squares: Floats) -> float:
    """Sum of squared residuals, which grow as their logarithm beyond ``far``; infinite with a point too near.

    ``far < 0``: none of them counts for more than ``-far``. Fills ``squares (N,)``: means by the degree of freedom.
    """
    total = 0.0
    for i in range(len(own)):
        n, sum_i = 0, 0.0
        for k in range(len(way)):
            if not np.isfinite(xy[k, i, 0]):
                continue
            x, y, z = _place(way, k, own, i)
            if z < _LEAST_DEPTH:
                return np.inf
            rx, ry = (xy[k, i, 0] - x / z) / sigma[i], (xy[k, i, 1] - y / z) / sigma[i]
            square = rx * rx + ry * ry
            n, sum_i = n + 1, sum_i + square
            if far < 0.0:
                total += min(square, -far)
            else:
                total += square if square < far else far * (1.0 + np.log(square / far))
        squares[i] = sum_i / max(2 * n - 3, 1)
    return total


@compiled
def _place(way: Floats, k: int, own: Floats, i: int) -> tuple[float, float, float]:
    """X of point i in view k."""
    x, y, kappa = own[i, 0], own[i, 1], own[i, 2]
    return (
        way[k, 0] * x + way[k, 1] * y + way[k, 2] + kappa * way[k, _S],
        way[k, 3] * x + way[k, 4] * y + way[k, 5] + kappa * way[k, _S + 1],
        way[k, 6] * x + way[k, 7] * y + way[k, 8] + kappa * way[k, _S + 2],
    )


@compiled
def _add_up(
    xy: Floats,
    way: Floats,
    i: int,
    own: Floats,
    sigma: float,
    far: float,
    loose: float,
    kept: Floats,
    information: Floats,
    score: Floats,
) -> None:
    """Adds what the views of point i say of what is shared, the lower half of ``information``; fills ``kept[i]``.

    No point is eliminated yet.
    """
    jacobian, residual, by = np.empty((2, 12)), np.empty(2), np.empty(3)
    kept[i] = 0.0
    kappa = own[i, 2]
    kept[i, 2, 2], kept[i, 2, 12] = loose, -loose * (kappa - 1.0)
    for k in range(len(way)):
        if not np.isfinite(xy[k, i, 0]):
            continue
        px, py, pz = _place(way, k, own, i)
        h = 1.0 / max(pz, _LEAST_DEPTH)
        u, v = px * h, py * h
        residual[0], residual[1] = (xy[k, i, 0] - u) / sigma, (xy[k, i, 1] - v) / sigma
        square = residual[0] ** 2 + residual[1] ** 2
        weight = far / max(square, far)
        # R times the ray of the point: what a turn moves across itself.
        qx, qy, qz = px - kappa * way[k, _S], py - kappa * way[k, _S + 1], pz - kappa * way[k, _S + 2]
        for c in range(12):
            for j in range(3):
                if c < 2:
                    by[j] = way[k, 3 * j + c]
                elif c == 2:
                    by[j] = way[k, _S + j]
                elif c < 6:
                    by[j] = kappa * way[k, _TIME] if j == c - 3 else 0.0
                elif c < 9:
                    by[j] = kappa * way[k, _G + 3 * j + c - 6]
                else:
                    by[j] = kappa * way[k, _DRAGGED + 3 * j + c - 9]
            if c >= 9:
                wx, wy, wz = way[k, _TURNED + c - 9], way[k, _TURNED + 3 + c - 9], way[k, _TURNED + 6 + c - 9]
                by[0] += wy * qz - wz * qy
                by[1] += wz * qx - wx * qz
                by[2] += wx * qy - wy * qx
            jacobian[0, c] = (by[0] - u * by[2]) * h / sigma
            jacobian[1, c] = (by[1] - v * by[2]) * h / sigma
        for r in range(2):
            for c in range(3):
                pull = weight * jacobian[r, c]
                for d in range(12):
                    kept[i, c, d] += pull * jacobian[r, d]
                kept[i, c, 12] += pull * residual[r]
            for c in range(N_SHARED):
                pull = weight * jacobian[r, 3 + c]
                for d in range(c + 1):
                    information[c, d] += pull * jacobian[r, 3 + d]
                score[c] += pull * residual[r]


@compiled
def _mirror(information: Floats) -> None:
    """Fills the upper half of a symmetric matrix with its lower half."""
    for c in range(len(information)):
        for d in range(c):
            information[d, c] = information[c, d]


@compiled
def _eliminate(kept: Floats, information: Floats, score: Floats, damping: float) -> None:
    """Takes from ``information (9, 9)`` and ``score (9,)`` what the points take of it when they follow (Schur)."""
    for i in range(len(kept)):
        block, right = _inverse(kept, i, damping), kept[i]
        for c in range(N_SHARED):
            for p in range(3):
                pull = 0.0
                for q in range(3):
                    pull += right[q, 3 + c] * block[q, p]
                for d in range(N_SHARED):
                    information[c, d] -= pull * right[p, 3 + d]
                score[c] -= pull * right[p, 12]


@compiled
def _inverse(kept: Floats, i: int, damping: float) -> Floats:
    """Inverse (3, 3) of the block of point i."""
    a, b, c = kept[i, 0, 0] * (1.0 + damping), kept[i, 0, 1], kept[i, 0, 2]
    d, e, f = kept[i, 1, 1] * (1.0 + damping), kept[i, 1, 2], kept[i, 2, 2] * (1.0 + damping)
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    out[1, 1], out[1, 2], out[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * out[0, 0] + b * out[0, 1] + c * out[0, 2]
    for p in range(3):
        for q in range(p, 3):
            out[p, q] /= determinant
            out[q, p] = out[p, q]
    return out


@compiled
def _step(
    kept: Floats,
    information: Floats,
    score: Floats,
    damping: float,
    damped: Floats,
    step: Floats,
    own: Floats,
    trial_own: Floats,
) -> float:
    """Fills the step of what is shared, ``step (9,)``, and the points after it; returns the fall that it promises."""
    damped[:], right = information, score.copy()
    for j in range(N_SHARED):
        damped[j, j] *= 1.0 + damping
    _eliminate(kept, damped, right, damping)
    step[:] = np.linalg.solve(damped, right)
    fall = np.sum(right * step)
    for i in range(len(own)):
        block = _inverse(kept, i, damping)
        for p in range(3):
            trial_own[i, p] = own[i, p]
            for q in range(3):
                rest = kept[i, q, 12]
                for c in range(N_SHARED):
                    rest -= kept[i, q, 3 + c] * step[c]
                trial_own[i, p] += block[p, q] * rest
                if p == q:
                    fall += block[q, q] * kept[i, q, 12] ** 2
    return fall


@compiled
def _set_way(t_s: Floats, centre: Floats, shared: Floats, way: Floats) -> None:
    """Fills ``way (L, 40)`` for what is shared."""
    omega, moved = shared[6:9].copy(), np.empty(3)
    rotation, integral, other, jacobian = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(t_s)):
        t = t_s[k]
        _turn(omega, t, rotation, jacobian, integral)
        for j in range(3):
            way[k, _S + j] = centre[j] + t * shared[j]
            for m in range(3):
                way[k, 3 * j + m] = rotation[j, m]
                way[k, _G + 3 * j + m] = integral[j, m]
                way[k, _TURNED + 3 * j + m] = jacobian[j, m]
                way[k, _S + j] += integral[j, m] * shared[3 + m] - rotation[j, m] * centre[m]
        for m in range(3):
            moved[:] = omega
            moved[m] += _DIFFERENCE_RAD_S
            _turn(moved, t, rotation, jacobian, other)
            # What a change of omega does to -R C, by the cross product with R C, and to G A.
            rx, ry, rz = way[k, 0:3] @ centre, way[k, 3:6] @ centre, way[k, 6:9] @ centre
            wx, wy, wz = way[k, _TURNED + m], way[k, _TURNED + 3 + m], way[k, _TURNED + 6 + m]
            way[k, _DRAGGED + m], way[k, _DRAGGED + 3 + m] = -(wy * rz - wz * ry), -(wz * rx - wx * rz)
            way[k, _DRAGGED + 6 + m] = -(wx * ry - wy * rx)
            for j in range(3):
                for q in range(3):
                    slope = (other[j, q] - integral[j, q]) / _DIFFERENCE_RAD_S
                    way[k, _DRAGGED + 3 * j + m] += slope * shared[3 + q]
        way[k, _TIME] = t


@compiled
def _turn(omega: Floats, t: float, rotation: Floats, jacobian: Floats, integral: Floats) -> None:
    """Fills R(t), t times its left Jacobian (how R follows omega) and G(t), ``(3, 3)`` each."""
    rate = np.sqrt(omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2)
    angle = rate * t
    if abs(angle) < _SMALL_RAD:
        square = angle * angle
        first, second = t * (1.0 - square / 6.0), t * t * (0.5 - square / 24.0)
        third = t**3 * (1.0 / 6.0 - square / 120.0)
        fourth = t**4 * (1.0 / 24.0 - square / 720.0)
    else:
        first, second = np.sin(angle) / rate, 2.0 * (np.sin(0.5 * angle) / rate) ** 2
        third, fourth = (t - first) / rate**2, (0.5 * t * t - second) / rate**2
    wx, wy, wz = omega
    for j in range(3):
        for m in range(3):
            one = 1.0 if j == m else 0.0
            twice = omega[j] * omega[m] - one * rate * rate
            rotation[j, m], jacobian[j, m] = one + second * twice, t * one + third * twice
            integral[j, m] = 0.5 * t * t * one + fourth * twice
    for j, m, w in ((0, 1, -wz), (0, 2, wy), (1, 2, -wx)):
        rotation[j, m] += first * w
        rotation[m, j] -= first * w
        jacobian[j, m] += second * w
        jacobian[m, j] -= second * w
        integral[j, m] += third * w
        integral[m, j] -= third * w
