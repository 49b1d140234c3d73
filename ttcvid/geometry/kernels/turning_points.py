"""The motion of one body that turns, and its points, together.

A point at (x, y, 1) now, kappa times as near as the body's middle C, is seen at time t along

    X(t) = R(t) (x, y, 1) + kappa S(t),    S(t) = (1 - R(t)) C + V t + G(t) A,    G(t) = int_0^t (t - s) R(s) ds,

R(t) the rotation by omega t: the middle starts with V and has the acceleration A in axes that turn with the body, as on
a circle. Lengths are in units of the middle's depth. `N_SHARED` unknowns in this order: V, A, omega.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.geometry.kernels.arrays import ZERO, copy, copy_rows
from ttcvid.geometry.kernels.medians import median
from ttcvid.geometry.kernels.normal_equations import add_equations, mirror, product
from ttcvid.geometry.kernels.solve import eliminate, solve
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
# Unknowns of a point, and of it and the body together.
_N_OWN, _N_ALL = 3, 3 + N_SHARED

_Views = tuple[Floats, Floats, Floats, Floats]
"""Views ``xy (L, N, 2)``, NaN where not seen, times ``t_s (L,)``, noise ``(N,)`` and the middle now, (x, y, 1)."""
_Way = tuple[Floats, Floats, Floats, Floats, Floats]
"""Of each view R, S and G, the integral of R, and how S follows a change of omega; all (L, 3, 3) but S, (L, 3)."""


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
    n_views, n = views[0].shape[:2]
    way, trial_way = _new_way(n_views), _new_way(n_views)
    squares, trial_squares, per_point = np.empty((n, n_views)), np.empty((n, n_views)), np.empty(n)
    rows, kept, matrix = np.empty((_N_ALL + 1, 2 * n * n_views)), np.empty((n, _N_OWN, _N_ALL + 1)), np.empty((12, 12))
    score, step, damped = np.empty(N_SHARED), np.empty(N_SHARED), np.empty((N_SHARED, N_SHARED))
    prior, mean, trial, trial_own = np.empty(N_SHARED), np.zeros(N_SHARED), np.empty(N_SHARED), np.empty_like(own)
    copy(mean_turn, mean[6:])
    damping, n_steps, is_over = _FIRST_DAMPING, 0, False
    left[0], left[1] = np.inf, 1.0
    for j in range(N_SHARED):
        for k in range(N_SHARED):
            information[j, k] = 1.0 if j == k else 0.0
    _set_way(views, shared, way)
    if not _set_squares(views, way, own, squares):
        return
    while True:
        usual = _usual(squares, per_point)
        scale = np.sqrt(max(1.0, usual))
        far, loose = (_ROBUST_SIGMAS * scale) ** 2, 1.0 / beliefs[3] ** 2
        speed = max(np.sqrt(shared[0] ** 2 + shared[1] ** 2 + shared[2] ** 2), beliefs[2])
        for j in range(3):
            prior[j], prior[3 + j], prior[6 + j] = _FASTEST_HZ**-2, (beliefs[1] * speed) ** -2, beliefs[0] ** -2
        if not is_over:
            # Beliefs weigh as much beside views that err by more than they should.
            for j in range(N_SHARED):
                prior[j] *= scale * scale
            loose *= scale * scale
        for j in range(N_SHARED):
            information[j, :], information[j, j] = 0.0, prior[j]
            score[j] = -prior[j] * (shared[j] - mean[j])
        _set_slopes(views, shared, way)
        _add_up(views, way, own, far, loose, rows, kept, information, score)
        if is_over:
            break
        before = _cost(squares, far) + _believed(shared, own, mean, prior, loose)
        is_better, fall = False, 0.0
        while damping < _MOST_DAMPING and not is_better:
            copy_rows(information, damped)
            copy(score, step)
            for j in range(N_SHARED):
                damped[j, j] *= 1.0 + damping
            fall = _take_points(kept, damping, damped, step, matrix)
            fall += solve(damped, step)
            for j in range(N_SHARED):
                trial[j] = shared[j] + step[j]
            _follow(kept, damping, step, own, trial_own, matrix)
            _set_way(views, trial, trial_way)
            if _set_squares(views, trial_way, trial_own, trial_squares):
                after = _cost(trial_squares, far) + _believed(trial, trial_own, mean, prior, loose)
                is_better = after < before
            if not is_better:
                damping *= _MORE
        n_steps += 1
        is_over = not is_better or n_steps == _MAX_STEPS or fall < converged_chi2 * scale * scale
        if is_better:
            damping = max(_LESS * damping, _LEAST_DAMPING)
            copy(trial, shared)
            copy_rows(trial_own, own)
            copy_rows(trial_squares, squares)
            way, trial_way = trial_way, way
    # The information at the end, without damping.
    left[0], left[1] = 0.0, usual
    for i in range(n):
        for k in range(n_views):
            left[0] += min(max(squares[i, k], 0.0), _ROBUST_SIGMAS**2)
    _take_points(kept, 0.0, information, score, matrix)
    mirror(information)


@compiled
def _new_way(n_views: int) -> _Way:
    square = (n_views, 3, 3)
    return np.empty(square), np.empty((n_views, 3)), np.empty(square), np.empty(square), np.empty(square)


@compiled
def _believed(shared: Floats, own: Floats, mean: Floats, prior: Floats, loose: float) -> float:
    """What the beliefs add to the cost."""
    total = 0.0
    for j in range(N_SHARED):
        total += prior[j] * (shared[j] - mean[j]) ** 2
    for i in range(len(own)):
        total += loose * (own[i, 2] - 1.0) ** 2
    return total


@compiled
def _set_squares(views: _Views, way: _Way, own: Floats, squares: Floats) -> bool:
    """Fill the squared residuals ``squares (N, L)``, -1 where not seen; False with a point too near."""
    xy, _, sigma, _ = views
    for i in range(len(own)):
        for k in range(len(xy)):
            squares[i, k] = -1.0
            if not np.isfinite(xy[k, i, 0]):
                continue
            x, y, z = _turned(way, k, own, i)
            shift, kappa = way[1], own[i, 2]
            x, y, z = x + kappa * shift[k, 0], y + kappa * shift[k, 1], z + kappa * shift[k, 2]
            if z < _LEAST_DEPTH:
                return False
            squares[i, k] = ((xy[k, i, 0] - x / z) / sigma[i]) ** 2 + ((xy[k, i, 1] - y / z) / sigma[i]) ** 2
    return True


@compiled
def _usual(squares: Floats, per_point: Floats) -> float:
    """The points' median square by the degree of freedom."""
    for i in range(len(squares)):
        n, total = 0, 0.0
        for k in range(squares.shape[1]):
            if squares[i, k] >= 0.0:
                n, total = n + 1, total + squares[i, k]
        per_point[i] = total / max(2 * n - 3, 1)
    return median(per_point)


@compiled
def _cost(squares: Floats, far: float) -> float:
    """Sum of squared residuals, which grow as their logarithm beyond ``far``."""
    total = 0.0
    for i in range(len(squares)):
        for k in range(squares.shape[1]):
            if squares[i, k] >= 0.0:
                total += squares[i, k] if squares[i, k] < far else far * (1.0 + np.log(squares[i, k] / far))
    return total


@compiled
def _turned(way: _Way, k: int, own: Floats, i: int) -> tuple[float, float, float]:
    """R (x, y, 1) of point i in view k."""
    r, x, y = way[0], own[i, 0], own[i, 1]
    return (
        r[k, 0, 0] * x + r[k, 0, 1] * y + r[k, 0, 2],
        r[k, 1, 0] * x + r[k, 1, 1] * y + r[k, 1, 2],
        r[k, 2, 0] * x + r[k, 2, 1] * y + r[k, 2, 2],
    )


@compiled
def _add_up(
    views: _Views,
    way: _Way,
    own: Floats,
    far: float,
    loose: float,
    rows: Floats,
    kept: Floats,
    information: Floats,
    score: Floats,
) -> None:
    """Add what all views say of what is shared, and fill ``kept (N, 3, 13)``: no point is eliminated yet.

    Kept of a point: its block of the information (3 x 3), its couplings (3 x 9) and its score (3). Fills ``rows`` on
    the way, as `normal_equations` has them.
    """
    n, moves = ZERO, np.empty((_N_ALL, 3))
    for i in range(len(own)):
        first, n = n, _set_rows(views, way, i, own, far, n, moves, rows)
        for c in range(_N_OWN):
            for d in range(_N_ALL + 1):
                kept[i, c, d] = product(rows, c, d, first, n)
        kept[i, 2, 2] += loose
        kept[i, 2, _N_ALL] -= loose * (own[i, 2] - 1.0)
    add_equations(rows[_N_OWN:], n, information, score)


@compiled
def _set_rows(views: _Views, way: _Way, i: int, own: Floats, far: float, n: int, moves: Floats, rows: Floats) -> int:
    """Fill ``rows (13, ...)`` from n on with what the views of point i say, x and y in turn; return where they end."""
    xy, t_s, sigma, _ = views
    rotation, shift, twice, once, dragged = way
    kappa, inverse = own[i, 2], 1.0 / sigma[i]
    for k in range(len(xy)):
        if not np.isfinite(xy[k, i, 0]):
            continue
        q = _turned(way, k, own, i)
        h = 1.0 / max(q[2] + kappa * shift[k, 2], _LEAST_DEPTH)
        u, v = (q[0] + kappa * shift[k, 0]) * h, (q[1] + kappa * shift[k, 1]) * h
        rx, ry = (xy[k, i, 0] - u) * inverse, (xy[k, i, 1] - v) * inverse
        root = np.sqrt(far / max(rx * rx + ry * ry, far))
        # How X follows the unknowns; a turn moves it across R times the ray of the point.
        for a in range(3):
            moves[0, a], moves[1, a], moves[2, a] = rotation[k, a, 0], rotation[k, a, 1], shift[k, a]
            b, c = (a + 1) % 3, (a + 2) % 3
            for j in range(3):
                moves[3 + j, a] = kappa * t_s[k] if a == j else 0.0
                moves[6 + j, a] = kappa * twice[k, a, j]
                moves[9 + j, a] = kappa * dragged[k, a, j] + once[k, b, j] * q[c] - once[k, c, j] * q[b]
        for j in range(_N_ALL):
            rows[j, n] = root * h * inverse * (moves[j, 0] - u * moves[j, 2])
            rows[j, n + 1] = root * h * inverse * (moves[j, 1] - v * moves[j, 2])
        rows[_N_ALL, n], rows[_N_ALL, n + 1] = root * rx, root * ry
        n += 2
    return n


@compiled
def _set_block(kept: Floats, i: int, damping: float, matrix: Floats, right: Floats) -> None:
    """Fill the lower half of ``matrix (12, 12)`` and ``right (3,)``: damped equations of point i, and its couplings."""
    matrix[:] = 0.0
    for c in range(_N_OWN):
        for d in range(_N_ALL):
            matrix[d, c] = kept[i, c, d]
        matrix[c, c] *= 1.0 + damping
        right[c] = kept[i, c, _N_ALL]


@compiled
def _take_points(kept: Floats, damping: float, information: Floats, score: Floats, matrix: Floats) -> float:
    """Take from ``information (9, 9)``, its lower half, and ``score (9,)`` what the points explain when they follow.

    Returns by how much the points alone lower chi-square.
    """
    right, fall = np.zeros(_N_ALL), 0.0
    for i in range(len(kept)):
        right[:] = 0.0
        _set_block(kept, i, damping, matrix, right)
        eliminate(matrix, right, _N_OWN)
        for c in range(_N_OWN):
            fall += right[c] * right[c] / matrix[c, c]
        for c in range(N_SHARED):
            score[c] += right[_N_OWN + c]
            for d in range(c + 1):
                information[c, d] += matrix[_N_OWN + c, _N_OWN + d]
    return fall


@compiled
def _follow(kept: Floats, damping: float, step: Floats, own: Floats, trial_own: Floats, matrix: Floats) -> None:
    """Fill the points after a step of what is shared, ``step (9,)``."""
    right = np.empty(_N_OWN)
    for i in range(len(own)):
        _set_block(kept, i, damping, matrix, right)
        for c in range(_N_OWN):
            for d in range(N_SHARED):
                right[c] -= kept[i, c, _N_OWN + d] * step[d]
        solve(matrix[:_N_OWN], right)
        for c in range(_N_OWN):
            trial_own[i, c] = own[i, c] + right[c]


@compiled
def _set_way(views: _Views, shared: Floats, way: _Way) -> None:
    """Fill R, S, G and the integral of R for what is shared."""
    _, t_s, _, centre = views
    rotation, shift, twice, once, _ = way
    w = shared[6:9]
    rate2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    for k in range(len(t_s)):
        t = t_s[k]
        first, second, third, fourth = _factors(np.sqrt(rate2), t)
        for j in range(3):
            for m in range(3):
                one, across = (1.0 if j == m else 0.0), (w[3 - j - m] if j != m else 0.0)
                across *= 1.0 if (j - m) % 3 == 1 else -1.0
                square = w[j] * w[m] - one * rate2
                rotation[k, j, m] = one + second * square + first * across
                once[k, j, m] = t * one + third * square + second * across
                twice[k, j, m] = 0.5 * t * t * one + fourth * square + third * across
        for j in range(3):
            shift[k, j] = centre[j] + t * shared[j]
            for m in range(3):
                shift[k, j] += twice[k, j, m] * shared[3 + m] - rotation[k, j, m] * centre[m]


@compiled
def _set_slopes(views: _Views, shared: Floats, way: _Way) -> None:
    """Fill how S follows a change of omega: -R C by the cross product with R C, G A by differences."""
    _, t_s, _, centre = views
    rotation, _, _, once, dragged = way
    pulled, moved = np.empty(3), np.empty(3)
    for k in range(len(t_s)):
        _twice_integrated(shared[6], shared[7], shared[8], t_s[k], shared, pulled)
        for m in range(3):
            x, y, z = (1.0 if m == 0 else 0.0), (1.0 if m == 1 else 0.0), (1.0 if m == 2 else 0.0)
            x, y, z = x * _DIFFERENCE_RAD_S, y * _DIFFERENCE_RAD_S, z * _DIFFERENCE_RAD_S
            _twice_integrated(shared[6] + x, shared[7] + y, shared[8] + z, t_s[k], shared, moved)
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                turned_b = turned_c = 0.0
                for j in range(3):
                    turned_b += rotation[k, b, j] * centre[j]
                    turned_c += rotation[k, c, j] * centre[j]
                dragged[k, a, m] = (moved[a] - pulled[a]) / _DIFFERENCE_RAD_S
                dragged[k, a, m] -= once[k, b, m] * turned_c - once[k, c, m] * turned_b


@compiled
def _twice_integrated(x: float, y: float, z: float, t: float, shared: Floats, moved: Floats) -> None:
    """Fill G A for the turn (x, y, z)."""
    a, b, c = shared[3], shared[4], shared[5]
    rate2, along = x * x + y * y + z * z, x * a + y * b + z * c
    _, _, third, fourth = _factors(np.sqrt(rate2), t)
    half = 0.5 * t * t - fourth * rate2
    moved[0] = half * a + third * (y * c - z * b) + fourth * x * along
    moved[1] = half * b + third * (z * a - x * c) + fourth * y * along
    moved[2] = half * c + third * (x * b - y * a) + fourth * z * along


@compiled
def _factors(rate: float, t: float) -> tuple[float, float, float, float]:
    """Of omega x and (omega x)^2 in R, the latter of which is the former's in its integral, and so on."""
    angle, both = rate * t, t * t
    if abs(angle) < _SMALL_RAD:
        square = angle * angle
        first, second = t * (1.0 - square / 6.0), both * (0.5 - square / 24.0)
        third, fourth = both * t * (1.0 / 6.0 - square / 120.0), both * both * (1.0 / 24.0 - square / 720.0)
    else:
        sine = np.sin(0.5 * angle) / rate
        first, second = np.sin(angle) / rate, 2.0 * sine * sine
        third, fourth = (t - first) / (rate * rate), (0.5 * both - second) / (rate * rate)
    return first, second, third, fourth
