"""Points of a body that turns, on the trajectory of `estimation.turning_points`: squares and normal equations."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled_for
from ttcvid.geometry.kernels.normal_equations import add_equations
from ttcvid.geometry.kernels.rotations import fill_rotation
from ttcvid.geometry.kernels.solve import eliminate
from ttcvid.model import Floats

N_SHARED = 9
"""Unknowns that the points of a body share."""
N_OWN, N_ALL = 3, 3 + N_SHARED
"""Unknowns of a point, and of it and the body together."""

# Nothing comes nearer to the camera than this part of its present depth: a path folds over behind it.
_LEAST_DEPTH = 0.05
# Below this angle the series is more exact than the closed form, rad.
_SMALL_RAD = 1e-2
# Step of numerical derivatives by what is shared.
_STEP = 1e-5

_Views = tuple[Floats, Floats, Floats, Floats]
"""Views ``xy (L, N, 2)``, NaN where not seen, times ``t_s (L,)``, noise ``(N,)`` and the middle now, (x, y, 1)."""
_Way = tuple[Floats, Floats]
"""R (L, 3, 3) and S (L, 3) of each view."""


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


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], f8[::1], f8[::1])), Tuple((f8[:, :, ::1], f8[:, ::1])), f8[:, ::1], "
    "f8[:, ::1], f8[::1])"
)
def set_squares(views: _Views, way: _Way, own: Floats, squares: Floats, per_point: Floats) -> bool:
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


@compiled_for(
    "(Tuple((f8[:, :, ::1], f8[::1], f8[::1], f8[::1])), Tuple((f8[:, :, ::1], f8[:, ::1])), "
    "f8[::1], f8[:, ::1], f8, f8, Tuple((f8[:, :, ::1], f8[:, ::1])), f8[:, :, ::1])"
)
def set_equations(
    views: _Views, way: _Way, shared: Floats, own: Floats, far: float, loose: float, other: _Way, of_points: Floats
) -> None:
    """Fill ``of_points (N, 13, 12)``: information, its lower half, of a point and its body, in the last row the score.

    Squares beyond ``far`` lose weight; ``loose`` is the information on kappa, about 1. How R and S follow what is
    shared is taken by differences, with a way that is no further use, ``other``.
    """
    xy, t_s, sigma, centre = views
    r, shift = way
    n_views = len(t_s)
    rows, moves, moved = np.empty((N_ALL + 1, 2 * n_views)), np.empty((N_ALL, 3)), np.empty(N_SHARED)
    turned, dragged = np.empty((3, n_views, 3, 3)), np.empty((N_SHARED, n_views, 3))
    for j in range(N_SHARED):
        for c in range(N_SHARED):
            moved[c] = shared[c] + (_STEP if c == j else 0.0)
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
                    moves[N_OWN + j, a] = kappa * dragged[j, k, a]
                for j in range(3):
                    moves[9 + j, a] += turned[j, k, a, 0] * x + turned[j, k, a, 1] * y + turned[j, k, a, 2]
            h = 1.0 / (r[k, 2, 0] * x + r[k, 2, 1] * y + r[k, 2, 2] + kappa * shift[k, 2])
            u = (r[k, 0, 0] * x + r[k, 0, 1] * y + r[k, 0, 2] + kappa * shift[k, 0]) * h
            v = (r[k, 1, 0] * x + r[k, 1, 1] * y + r[k, 1, 2] + kappa * shift[k, 1]) * h
            rx, ry = (xy[k, i, 0] - u) * inverse, (xy[k, i, 1] - v) * inverse
            root = np.sqrt(far / max(rx * rx + ry * ry, far))
            for j in range(N_ALL):
                rows[j, n] = root * h * inverse * (moves[j, 0] - u * moves[j, 2])
                rows[j, n + 1] = root * h * inverse * (moves[j, 1] - v * moves[j, 2])
            rows[N_ALL, n], rows[N_ALL, n + 1] = root * rx, root * ry
            n += 2
        add_equations(rows, n, of_points[i], of_points[i, N_ALL])
        of_points[i, 2, 2] += loose
        of_points[i, N_ALL, 2] -= loose * (kappa - 1.0)


@compiled_for("(f8[:, :, ::1], f8, f8[:, :, ::1], f8[:, ::1], f8[::1])")
def eliminate_points(of_points: Floats, damping: float, kept: Floats, information: Floats, score: Floats) -> float:
    """Add to ``information (9, 9)``, its lower half, and ``score (9,)``, with the points following; damped.

    Fills ``kept (N, 13, 3)`` as `solve.eliminate` does, and returns by how much the points alone lower chi-square.
    """
    equations, fall = np.empty((N_ALL + 1, N_ALL)), 0.0
    for i in range(len(of_points)):
        for c in range(N_ALL + 1):
            for d in range(N_ALL):
                equations[c, d] = of_points[i, c, d]
        for c in range(N_ALL):
            equations[c, c] *= 1.0 + damping
        eliminate(equations, kept[i], information, score)
        for c in range(N_OWN):
            fall += kept[i, N_ALL, c] ** 2 / kept[i, c, c]
    return fall
