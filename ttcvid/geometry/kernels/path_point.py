"""A point on a relative trajectory that is known up to its scale: what its views say of its place and inverse depth.

Now at (x, y, 1), up to its depth, it was at (x + rho T_x, y + rho T_y, 1 + rho T_z) when its body was at T, less where
that is now. The unknowns are x, y and rho, the inverse depth.
"""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled, compiled_in_place
from ttcvid.model import Floats

LANES = 8
"""The number of views is filled up to a multiple of this, as fits the processor's registers."""
ROBUST_SIGMAS = 3.0
"""A residual farther off than this, in sigmas, loses weight: 1 % of Gaussian noise in two components."""
LEAST_FORWARD = 0.05
"""Least z of a turned unit ray that still has a place in the plane z = 1, as in `rotation.turned_into_plane`."""
# The depth of a point over that at time 0, 1 + rho T_z, is taken as at least this: on wrong paths too, the prediction
# is kept from its pole.
LEAST_DEPTH_RATIO = 0.05

# Rows of ``views (7, M)``: where the point is seen, one over its noise (0: not seen), its path and the time.
X, Y, INVERSE, PATH_X, PATH_Y, PATH_Z, TIME = range(7)
N_ROWS = 7
# Sums: information on x (and y), couplings of x, y with rho, information on rho, score of x, y, rho, chi-square.
OWN, WITH_X, WITH_Y, INFO, SCORE_X, SCORE_Y, SCORE, CHI2 = range(8)
N_SUMS = 8


@compiled
def add_views(views: Floats, first: int, stop: int, state: Floats, limit: float, sign: float, sums: Floats) -> None:
    """Add the normal equations of the views ``first ... stop - 1``, those far off with the weight 1 / r^2.

    Chi-square of a residual grows no further beyond the ``limit``.
    """
    _add(views, first, stop, state, limit, False, sign, sums)


@compiled
def add_views_by_length(views: Floats, first: int, stop: int, state: Floats, limit: float, sums: Floats) -> None:
    """The same, but residuals far off count by their length (Huber): chi-square grows with the misfit."""
    _add(views, first, stop, state, limit, True, 1.0, sums)


@compiled_in_place
def _add(
    views: Floats, first: int, stop: int, state: Floats, limit: float, is_by_length: bool, sign: float, sums: Floats
) -> None:
    """Add to ``sums (8,)``. With h = 1 / (1 + rho T_z), d(u, v) / d(x, y, rho) has the rows (h, 0, j_x), (0, h, j_y).

    j = h (T_xy - (u, v) T_z). Without a branch, and by an index without a sign: several views are worked at at a time.
    """
    x, y, rho = state[0], state[1], state[2]
    own = with_x = with_y = info = score_x = score_y = score = chi2 = 0.0
    for k in range(np.uint64(first), np.uint64(stop)):
        inverse, tx, ty, tz = views[INVERSE, k], views[PATH_X, k], views[PATH_Y, k], views[PATH_Z, k]
        h = 1.0 / max(1.0 + rho * tz, LEAST_DEPTH_RATIO)
        u, v = (x + rho * tx) * h, (y + rho * ty) * h
        rx, ry = (views[X, k] - u) * inverse, (views[Y, k] - v) * inverse
        square = rx * rx + ry * ry
        ratio = limit / max(square, limit)
        weight = np.sqrt(ratio) if is_by_length else ratio
        chi2 += (2.0 * weight - ratio) * square if is_by_length else weight * square
        own_h = h * inverse
        jx, jy, wh = (tx - u * tz) * own_h, (ty - v * tz) * own_h, weight * own_h
        own += wh * own_h
        with_x += wh * jx
        with_y += wh * jy
        info += weight * (jx * jx + jy * jy)
        score_x += wh * rx
        score_y += wh * ry
        score += weight * (jx * rx + jy * ry)
    sums[OWN] += sign * own
    sums[WITH_X] += sign * with_x
    sums[WITH_Y] += sign * with_y
    sums[INFO] += sign * info
    sums[SCORE_X] += sign * score_x
    sums[SCORE_Y] += sign * score_y
    sums[SCORE] += sign * score
    sums[CHI2] += sign * chi2


@compiled
def rate_equation(sums: Floats) -> tuple[float, float]:
    """Information on rho, and its score, once x and y follow (Schur complement)."""
    rest = 1.0 / sums[OWN]
    info = sums[INFO] - (sums[WITH_X] * sums[WITH_X] + sums[WITH_Y] * sums[WITH_Y]) * rest
    return info, sums[SCORE] - (sums[WITH_X] * sums[SCORE_X] + sums[WITH_Y] * sums[SCORE_Y]) * rest


@compiled
def solve_between(sums: Floats, state: Floats, limits: Floats, step: Floats) -> float:
    """Fill the step of x, y, rho, which goes half of the way to the ``limits (2,)`` of rho at most.

    Returns by how much chi-square falls.
    """
    info, score = rate_equation(sums)
    change = score / info if info > 0.0 else 0.0
    change = min(max(change, 0.5 * (limits[0] - state[2])), 0.5 * (limits[1] - state[2]))
    rest = 1.0 / sums[OWN]
    step[0], step[1] = (sums[SCORE_X] - sums[WITH_X] * change) * rest, (sums[SCORE_Y] - sums[WITH_Y] * change) * rest
    step[2] = change
    square = sums[SCORE_X] * sums[SCORE_X] + sums[SCORE_Y] * sums[SCORE_Y]
    fall: float = square * rest + change * (2.0 * score - info * change)
    return fall


@compiled
def start(views: Floats, n: int, limits: Floats, state: Floats) -> float:
    """Fill the state by the linear solve of x + rho (T_x - x_i T_z) = x_i over the first n views, with equal weights.

    About the first of them; rho goes half of the way to its limits at most. Returns the sum of the squares that the
    solution leaves without these limits.
    """
    x0, y0, rest = views[X, 0], views[Y, 0], 1.0 / n
    sum_x = sum_y = both = right_x = right_y = right = square = 0.0
    for k in range(n):
        x, y = views[X, k], views[Y, k]
        jx, jy = views[PATH_X, k] - x * views[PATH_Z, k], views[PATH_Y, k] - y * views[PATH_Z, k]
        x, y = x - x0, y - y0
        sum_x += jx
        sum_y += jy
        both += jx * jx + jy * jy
        right_x += x
        right_y += y
        right += jx * x + jy * y
        square += x * x + y * y
    info = both - (sum_x * sum_x + sum_y * sum_y) * rest
    along = right - (sum_x * right_x + sum_y * right_y) * rest
    rho = along / info if info > 0.0 else 0.0
    left = square - (right_x * right_x + right_y * right_y) * rest - rho * along
    rho = min(max(rho, 0.5 * limits[0]), 0.5 * limits[1])
    state[0], state[1], state[2] = x0 + (right_x - sum_x * rho) * rest, y0 + (right_y - sum_y * rho) * rest, rho
    return float(max(left, 0.0))


@compiled
def first_lane(rays: Floats, i: int) -> int:
    """Start of the block of `LANES` views in which track i of ``rays (N, 3, M)`` is first seen, or of the last."""
    k, last = 0, rays.shape[2] - 1
    while k < last and np.isnan(rays[i, 0, k]):
        k += 1
    return k // LANES * LANES


@compiled
def list_turned(rays: Floats, i: int, first: int, ways: Floats, b: int, inverse: float, views: Floats) -> int:
    """Fill ``views`` from the ``first`` on: the rays of track i turned, and the path, both as ``ways[b]`` has them.

    A way ``(12, M)`` holds the rotation (9) and the path (3) of each view. Returns in how many views the point is seen.
    """
    n = 0
    for k in range(np.uint64(first), np.uint64(rays.shape[2])):
        p, q, r = rays[i, 0, k], rays[i, 1, k], rays[i, 2, k]
        depth = ways[b, 6, k] * p + ways[b, 7, k] * q + ways[b, 8, k] * r
        # Where it was not seen it is NaN, and no comparison holds.
        is_seen = depth > LEAST_FORWARD
        forward = 1.0 / (depth if is_seen else 1.0)
        views[X, k] = (ways[b, 0, k] * p + ways[b, 1, k] * q + ways[b, 2, k] * r) * forward if is_seen else 0.0
        views[Y, k] = (ways[b, 3, k] * p + ways[b, 4, k] * q + ways[b, 5, k] * r) * forward if is_seen else 0.0
        views[INVERSE, k] = inverse if is_seen else 0.0
        views[PATH_X, k], views[PATH_Y, k], views[PATH_Z, k] = ways[b, 9, k], ways[b, 10, k], ways[b, 11, k]
        n += 1 if is_seen else 0
    return n
