"""The inner loops of `turning_body`, compiled: one body's motion and its points together, step by step.

A point at (x, y, 1) now, kappa times as near as the body's middle C, is seen at time t along

    X(t) = R(t) (x, y, 1) + kappa S(t),    S(t) = (1 - R(t)) C + V t + G(t) A,    G(t) = int_0^t (t - s) R(s) ds,

R(t) the rotation by omega t: the middle starts with V and has the acceleration A in axes that turn with the body, as on
a circle. Lengths are in units of the middle's depth. `N_SHARED` unknowns in this order: V, A, omega.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for, compiled_in_place
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

_Sums = tuple[Floats, Floats, Floats]
"""``kept (N, 3, 13)``, and of what is shared the ``information (9, 9)``, of which the lower half counts, and score."""


@compiled_for(
    "(f8[:, :, ::1], f8[::1], f8[::1], f8[::1], f8[::1], f8, f8, f8, f8, f8, f8[:, ::1], f8[::1], f8[:, ::1], f8[::1])"
)
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

    A start that brings a point too near is none: nothing changes, and its squares are infinite.
    """
    n = len(own)
    way, trial_way = np.empty((len(t_s), _N_WAY)), np.empty((len(t_s), _N_WAY))
    rows = np.empty((_N_KEPT, 2 * n * len(t_s)))
    kept, inverse, squares = np.empty((n, 3, _N_KEPT)), np.empty((n, 3, 3)), np.empty(n)
    score, step, damped = np.empty(N_SHARED), np.empty(N_SHARED), np.empty((N_SHARED, N_SHARED))
    prior, trial, trial_own = np.zeros(N_SHARED), np.empty(N_SHARED), np.empty_like(own)
    sums = (kept, information, score)
    damping = _FIRST_DAMPING
    _set_way(t_s, centre, shared, way)
    information[:], left[:] = np.eye(N_SHARED), (np.inf, 1.0)
    if not np.isfinite(_cost(xy, sigma, way, own, 1e12, squares)):
        return
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
        _set_slopes(t_s, centre, shared, way)
        _add_up(xy, sigma, way, own, far, loose, rows, sums)
        before = _cost(xy, sigma, way, own, far, squares)
        before += _believed(shared, own, mean_turn, prior, loose)
        is_better, fall = False, 0.0
        while damping < _MOST_DAMPING:
            fall = _step(sums, damping, inverse, damped, step, own, trial_own)
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
    far, loose = (_ROBUST_SIGMAS * scale) ** 2, 1.0 / relief**2
    _set_slopes(t_s, centre, shared, way)
    _add_up(xy, sigma, way, own, far, loose, rows, sums)
    _eliminate(kept, 0.0, inverse, information, score)
    for j in range(N_SHARED):
        information[:j, j] = information[j, :j]
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
    xy: Floats, sigma: Floats, way: Floats, own: Floats, far: float, loose: float, rows: Floats, sums: _Sums
) -> None:
    """Adds what all views say of what is shared, and fills ``kept``: no point is eliminated yet.

    Fills ``rows (13, ...)`` on the way.
    """
    (kept, information, score), n = sums, 0
    for i in range(len(own)):
        first, n = n, _set_rows(xy, sigma, way, i, own, far, n, rows)
        for c in range(3):
            for d in range(c, _N_KEPT):
                kept[i, c, d] = _product(rows, c, d, first, n)
        kept[i, 2, 2] += loose
        kept[i, 2, 12] -= loose * (own[i, 2] - 1.0)
    for c in range(N_SHARED):
        for d in range(c + 1):
            information[c, d] += _product(rows, 3 + c, 3 + d, 0, n)
        score[c] += _product(rows, 3 + c, 12, 0, n)


@compiled
def _set_rows(xy: Floats, sigma: Floats, way: Floats, i: int, own: Floats, far: float, n: int, rows: Floats) -> int:
    """Fills ``rows (13, ...)`` from n on with what the views of point i say, x and y in turn; returns where they end.

    That is how they follow its own unknowns and those that are shared, and what is left of them: in sigmas, and with
    the root of their weights.
    """
    kappa, inverse = own[i, 2], 1.0 / sigma[i]
    for k in range(len(way)):
        if not np.isfinite(xy[k, i, 0]):
            continue
        px, py, pz = _place(way, k, own, i)
        h = 1.0 / max(pz, _LEAST_DEPTH)
        u, v = px * h, py * h
        rx, ry = (xy[k, i, 0] - u) * inverse, (xy[k, i, 1] - v) * inverse
        root = np.sqrt(far / max(rx * rx + ry * ry, far))
        a, x, y = root * h * inverse, n, n + 1
        b, moved = a * kappa, a * kappa * way[k, _TIME]
        # R times the ray of the point: what a turn moves across itself.
        qx, qy, qz = px - kappa * way[k, _S], py - kappa * way[k, _S + 1], pz - kappa * way[k, _S + 2]
        for c in range(2):
            rows[c, x] = a * (way[k, c] - u * way[k, 6 + c])
            rows[c, y] = a * (way[k, 3 + c] - v * way[k, 6 + c])
        rows[2, x] = a * (way[k, _S] - u * way[k, _S + 2])
        rows[2, y] = a * (way[k, _S + 1] - v * way[k, _S + 2])
        rows[3, x], rows[4, x], rows[5, x] = moved, 0.0, -u * moved
        rows[3, y], rows[4, y], rows[5, y] = 0.0, moved, -v * moved
        for c in range(3):
            rows[6 + c, x] = b * (way[k, _G + c] - u * way[k, _G + 6 + c])
            rows[6 + c, y] = b * (way[k, _G + 3 + c] - v * way[k, _G + 6 + c])
            wx, wy, wz = way[k, _TURNED + c], way[k, _TURNED + 3 + c], way[k, _TURNED + 6 + c]
            along = kappa * way[k, _DRAGGED + 6 + c] + wx * qy - wy * qx
            rows[9 + c, x] = a * (kappa * way[k, _DRAGGED + c] + wy * qz - wz * qy - u * along)
            rows[9 + c, y] = a * (kappa * way[k, _DRAGGED + 3 + c] + wz * qx - wx * qz - v * along)
        rows[12, x], rows[12, y] = root * rx, root * ry
        n += 2
    return n


@compiled_in_place
def _product(rows: Floats, c: int, d: int, first: int, stop: int) -> float:
    """Of two rows, from a place on."""
    total = 0.0
    for k in range(np.uint64(first), np.uint64(stop)):
        total += rows[c, k] * rows[d, k]
    return total


@compiled
def _eliminate(kept: Floats, damping: float, inverse: Floats, information: Floats, score: Floats) -> None:
    """Takes from ``information (9, 9)`` and ``score (9,)`` what the points take of it when they follow (Schur).

    The lower half of the former counts. Fills ``inverse (N, 3, 3)`` of their own blocks, damped.
    """
    for i in range(len(kept)):
        more = 1.0 + damping
        a, d, f = kept[i, 0, 0] * more, kept[i, 1, 1] * more, kept[i, 2, 2] * more
        b, c, e = kept[i, 0, 1], kept[i, 0, 2], kept[i, 1, 2]
        inverse[i, 0, 0], inverse[i, 0, 1], inverse[i, 0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
        inverse[i, 1, 1], inverse[i, 1, 2], inverse[i, 2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
        determinant = a * inverse[i, 0, 0] + b * inverse[i, 0, 1] + c * inverse[i, 0, 2]
        for p in range(3):
            for q in range(p, 3):
                inverse[i, p, q] /= determinant
                inverse[i, q, p] = inverse[i, p, q]
        for c in range(N_SHARED):
            x, y, z = kept[i, 0, 3 + c], kept[i, 1, 3 + c], kept[i, 2, 3 + c]
            by_x = x * inverse[i, 0, 0] + y * inverse[i, 0, 1] + z * inverse[i, 0, 2]
            by_y = x * inverse[i, 0, 1] + y * inverse[i, 1, 1] + z * inverse[i, 1, 2]
            by_z = x * inverse[i, 0, 2] + y * inverse[i, 1, 2] + z * inverse[i, 2, 2]
            # All of them: a loop of a known length takes less than one over half of it.
            for d in range(N_SHARED):
                j = 3 + d
                information[c, d] -= by_x * kept[i, 0, j] + by_y * kept[i, 1, j] + by_z * kept[i, 2, j]
            score[c] -= by_x * kept[i, 0, 12] + by_y * kept[i, 1, 12] + by_z * kept[i, 2, 12]


@compiled
def _step(
    sums: _Sums, damping: float, inverse: Floats, damped: Floats, step: Floats, own: Floats, trial_own: Floats
) -> float:
    """Fills the step of what is shared, ``step (9,)``, and the points after it; returns the fall that it promises."""
    kept, information, score = sums
    damped[:], step[:] = information, score
    for j in range(N_SHARED):
        damped[j, j] *= 1.0 + damping
    _eliminate(kept, damping, inverse, damped, step)
    fall = _solve(damped, step)
    for i in range(len(own)):
        for p in range(3):
            trial_own[i, p] = own[i, p]
        for q in range(3):
            rest = kept[i, q, 12]
            for p in range(3):
                fall += kept[i, p, 12] * inverse[i, p, q] * rest
            for c in range(N_SHARED):
                rest -= kept[i, q, 3 + c] * step[c]
            for p in range(3):
                trial_own[i, p] += inverse[i, p, q] * rest
    return fall


@compiled
def _solve(matrix: Floats, right: Floats) -> float:
    """Turns ``right (9,)`` into the solution, by Cholesky factors of the lower half; returns right . solution."""
    fall = 0.0
    for j in range(N_SHARED):
        for k in range(j):
            matrix[j, j] -= matrix[j, k] * matrix[j, k]
            right[j] -= matrix[j, k] * right[k]
        matrix[j, j] = np.sqrt(matrix[j, j])
        right[j] /= matrix[j, j]
        fall += right[j] * right[j]
        for i in range(j + 1, N_SHARED):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            matrix[i, j] /= matrix[j, j]
    for j in range(N_SHARED - 1, -1, -1):
        for i in range(j + 1, N_SHARED):
            right[j] -= matrix[i, j] * right[i]
        right[j] /= matrix[j, j]
    return fall


@compiled
def _set_way(t_s: Floats, centre: Floats, shared: Floats, way: Floats) -> None:
    """Fills R, S, G and the times of ``way (L, 40)`` for what is shared."""
    wx, wy, wz = shared[6], shared[7], shared[8]
    rate = np.sqrt(wx * wx + wy * wy + wz * wz)
    cross = (0.0, -wz, wy, wz, 0.0, -wx, -wy, wx, 0.0)
    for k in range(len(t_s)):
        t = t_s[k]
        first, second, third, fourth = _factors(rate, t)
        way[k, _TIME] = t
        for j in range(3):
            way[k, _S + j] = centre[j] + t * shared[j]
            for m in range(3):
                one, w = 1.0 if j == m else 0.0, cross[3 * j + m]
                twice = shared[6 + j] * shared[6 + m] - one * rate * rate
                way[k, 3 * j + m] = one + second * twice + first * w
                way[k, _G + 3 * j + m] = 0.5 * t * t * one + fourth * twice + third * w
                way[k, _TURNED + 3 * j + m] = t * one + third * twice + second * w
                way[k, _S + j] += way[k, _G + 3 * j + m] * shared[3 + m] - way[k, 3 * j + m] * centre[m]


@compiled
def _set_slopes(t_s: Floats, centre: Floats, shared: Floats, way: Floats) -> None:
    """Fills what is left of ``way (L, 40)``: how S follows a change of omega."""
    omega, moved = shared[6:9], shared[6:9].copy()
    ax, ay, az = shared[3], shared[4], shared[5]
    for m in range(3):
        moved[:] = omega
        moved[m] += _DIFFERENCE_RAD_S
        wx, wy, wz = moved
        rate = np.sqrt(wx * wx + wy * wy + wz * wz)
        along, square = wx * ax + wy * ay + wz * az, rate * rate
        for k in range(len(t_s)):
            t = t_s[k]
            _, _, third, fourth = _factors(rate, t)
            # What a change of omega does to G A.
            half = 0.5 * t * t - fourth * square
            pulled = (
                half * ax + third * (wy * az - wz * ay) + fourth * wx * along,
                half * ay + third * (wz * ax - wx * az) + fourth * wy * along,
                half * az + third * (wx * ay - wy * ax) + fourth * wz * along,
            )
            # And to -R C, by the cross product with R C.
            rx = way[k, 0] * centre[0] + way[k, 1] * centre[1] + way[k, 2] * centre[2]
            ry = way[k, 3] * centre[0] + way[k, 4] * centre[1] + way[k, 5] * centre[2]
            rz = way[k, 6] * centre[0] + way[k, 7] * centre[1] + way[k, 8] * centre[2]
            jx, jy, jz = way[k, _TURNED + m], way[k, _TURNED + 3 + m], way[k, _TURNED + 6 + m]
            dragged = (-(jy * rz - jz * ry), -(jz * rx - jx * rz), -(jx * ry - jy * rx))
            for j in range(3):
                before = way[k, _G + 3 * j] * ax + way[k, _G + 3 * j + 1] * ay + way[k, _G + 3 * j + 2] * az
                way[k, _DRAGGED + 3 * j + m] = dragged[j] + (pulled[j] - before) / _DIFFERENCE_RAD_S


@compiled
def _factors(rate: float, t: float) -> tuple[float, float, float, float]:
    """Of omega x and (omega x)^2 in R, the latter of which is the former's in its integral, and so on."""
    angle = rate * t
    if abs(angle) < _SMALL_RAD:
        square, both = angle * angle, t * t
        first, second = t * (1.0 - square / 6.0), both * (0.5 - square / 24.0)
        third, fourth = both * t * (1.0 / 6.0 - square / 120.0), both * both * (1.0 / 24.0 - square / 720.0)
    else:
        sine = np.sin(0.5 * angle) / rate
        first, second = np.sin(angle) / rate, 2.0 * sine * sine
        third, fourth = (t - first) / (rate * rate), (0.5 * t * t - second) / (rate * rate)
    return first, second, third, fourth
