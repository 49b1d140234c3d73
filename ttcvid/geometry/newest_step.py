"""How far rigid things have gone and turned in the last step, where their ways before that are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for, compiled_in_place
from ttcvid.geometry.medians import medians
from ttcvid.geometry.rigid_path import PathFit, Points, RigidPaths
from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.model import Floats, Ints

# Points of twice the typical misfit weigh half, as in `rigid_path_descent`; it counts as this at the least. Not single
# residuals: where the step is wrong, all of the present view are large.
_HALF_WEIGHT, _LEAST_TYPICAL_MISFIT = 2.0, 0.25
# Smallest depth of a point over its present one, and least z of a turned ray that has a place in the plane z = 1.
_LEAST_DEPTH_RATIO, _LEAST_FORWARD = 0.05, 0.05
# The last step is its own length where there were two before it.
_LEAST_VIEWS = 3
# Steps shorter than this have no scale.
_NO_LENGTH = 1e-9
# Numbers of a view: its rotation (9) and shift (3).
_N_WAY = 12


@dataclass(frozen=True)
class StepPriors:
    """How the last steps of K things may leave what is expected: Gaussian.

    ``shift_sigma (K,)`` of where a thing was before it, per axis. ``turn_sigma_rad`` of how it has turned in it, about
    ``middle (K, 3)``, where that is now, from ``turned_rad (K, 3)`` beyond what its path says; None: as that says.
    """

    shift_sigma: Floats
    turned_rad: Floats | None = None
    turn_sigma_rad: float = 0.0
    middle: Floats | None = None


def with_newest_steps(
    points: Points, paths: RigidPaths, fit: PathFit, weight: Floats, priors: StepPriors
) -> RigidPaths:
    """The paths of K things, the last step of each corrected by all of its points, that are free to follow.

    A step that is wrong moves all past views alike. Where points and views are corrected in turn
    (`rigid_path.refined_paths`), the points go along: each lies where most of its views have it, and one that began a
    moment ago fits any step. A scene before a camera that brakes would keep its speed, and what brakes or turns before
    it would lag behind.

    Parameters
    ----------
    points : M points of the things.
    paths : of the things, their last steps roughly known.
    fit : of the points on the paths.
    weight : (M,) of each point, 0 leaves it out.

    Source: weighted least squares for where a thing is now and how it is turned, as against all views before; the
    unknowns x, y, rho of each point are eliminated (Schur complement).
    """
    count, is_used = len(paths), (weight > 0.0) & ~np.isnan(fit.rate_hz)
    if len(points.since_s) < _LEAST_VIEWS or not is_used.any():
        return paths
    typical = np.maximum(medians(np.where(is_used, fit.misfit, np.nan), points.thing, count), _LEAST_TYPICAL_MISFIT)
    normal, score, change = np.zeros((count, 6, 6)), np.zeros((count, 6)), np.zeros((count, 6))
    middle = np.zeros((count, 3)) if priors.middle is None else priors.middle
    _add_up(
        points.rays,
        points.track,
        points.thing,
        points.sigma_norm,
        paths.cam_R_past,
        paths.path,
        middle,
        (fit.place, fit.rate_hz, fit.misfit),
        weight,
        typical,
        normal,
        score,
    )
    path, cam_R_past = paths.path.copy(), paths.cam_R_past
    if priors.turned_rad is None:
        _solve_shifts(normal, score, priors.shift_sigma, change)
        path[:, :-1] -= change[:, None, 3:]
        return RigidPaths(cam_R_past, path)
    _solve_all(normal, score, priors.shift_sigma, priors.turned_rad, priors.turn_sigma_rad, change)
    turn = rotation_from_vector(change[:, :3])
    path[:, :-1] = (path[:, :-1] + middle[:, None]) @ turn.transpose(0, 2, 1) - (middle + change[:, 3:])[:, None]
    cam_R_past = cam_R_past.copy()
    cam_R_past[:, :-1] = turn[:, None] @ cam_R_past[:, :-1]
    return RigidPaths(cam_R_past, path)


@compiled_for(
    "(f8[:, :, ::1], i8[::1], i8[::1], f8[::1], f8[:, :, :, ::1], f8[:, :, ::1], f8[:, ::1], "
    "Tuple((f8[:, ::1], f8[::1], f8[::1])), f8[::1], f8[::1], f8[:, :, ::1], f8[:, ::1])"
)
def _add_up(
    rays: Floats,
    track: Ints,
    thing: Ints,
    sigma: Floats,
    rotations: Floats,
    paths: Floats,
    middle: Floats,
    fit: tuple[Floats, Floats, Floats],
    weight: Floats,
    typical: Floats,
    normal: Floats,
    score: Floats,
) -> None:
    """Add to ``normal (K, 6, 6)`` and ``score (K, 6)`` of turns w and shifts s what each of M points says of them.

    ``fit`` are place, rate and misfit of each point, beside the ``typical (K,)`` misfit.
    With h = 1 / (1 + rho T_z), the picture p of a view moves by h with x and y and by h (T_xy - p T_z) with rho; that
    of the present view, at (x, y, 1), by B (w x ((x, y, 1) - rho C) + rho s) too, with B = [[1, 0, -x], [0, 1, -y]] and
    ``middle (K, 3)``, C, about which a thing turns. A point of which nothing but this is known could be anywhere: with
    the information N of all views on x, y, rho, and that of a coordinate of the present view, i, what the residual
    there says of B (...) weighs i - i^2 N^-1.
    """
    place, rate, misfit = fit
    ways, row, along = np.zeros((len(paths), _N_WAY, rays.shape[2])), np.empty((2, 6)), np.empty((2, 6))
    for b in range(len(paths)):
        _list_way(rotations, paths, b, ways)
    for m in range(len(track)):
        if not (weight[m] > 0.0 and np.isfinite(rate[m])):
            continue
        i, b, x0, y0, rho = track[m], thing[m], place[m, 0], place[m, 1], rate[m]
        one, by_x, by_y, both, score_x, score_y, by_rho = _sums(rays, i, ways, b, x0, y0, rho)
        # Of the point by all views, and the residual of the present one, the last.
        rx, ry = _residual(rays, i, ways, b, x0, y0)
        along_x, along_y = by_x / one, by_y / one
        known = both - along_x * by_x - along_y * by_y
        if not known > 0.0:
            continue
        change = (by_rho - along_x * score_x - along_y * score_y) / known
        xx, xy = 1.0 - 1.0 / one - along_x * along_x / known, -along_x * along_y / known
        yy = 1.0 - 1.0 / one - along_y * along_y / known
        rx -= score_x / one - along_x * change
        ry -= score_y / one - along_y * change
        x, y, z = x0 - rho * middle[b, 0], y0 - rho * middle[b, 1], 1.0 - rho * middle[b, 2]
        row[0, 0], row[0, 1], row[0, 2], row[0, 3], row[0, 4], row[0, 5] = -x0 * y, z + x0 * x, -y, rho, 0.0, -rho * x0
        row[1, 0], row[1, 1], row[1, 2], row[1, 3], row[1, 4], row[1, 5] = -z - y0 * y, y0 * x, x, 0.0, rho, -rho * y0
        information = weight[m] / (1.0 + misfit[m] / (_HALF_WEIGHT * typical[b])) / (sigma[i] * sigma[i])
        for j in range(6):
            along[0, j] = information * (xx * row[0, j] + xy * row[1, j])
            along[1, j] = information * (xy * row[0, j] + yy * row[1, j])
            score[b, j] += information * (row[0, j] * rx + row[1, j] * ry)
        for j in range(6):
            for k in range(6):
                normal[b, j, k] += row[0, j] * along[0, k] + row[1, j] * along[1, k]


@compiled
def _list_way(rotations: Floats, paths: Floats, b: int, ways: Floats) -> None:
    """Fill ``ways[b] (12, M)``, view by view: the rotation, row by row, and the path, as in `rigid_path_descent`."""
    before = ways.shape[2] - paths.shape[1]
    for k in range(paths.shape[1]):
        for i in range(3):
            for j in range(3):
                ways[b, 3 * i + j, before + k] = rotations[b, k, i, j]
            ways[b, 9 + i, before + k] = paths[b, k, i]


@compiled_in_place
def _sums(
    rays: Floats, i: int, ways: Floats, q: int, x0: float, y0: float, rho: float
) -> tuple[float, float, float, float, float, float, float]:
    """Information of all views of track i on path q: on x (and y), couplings of x and y with rho, on rho; their scores.

    Without a branch: several views are worked at side by side.
    """
    one = by_x = by_y = both = score_x = score_y = by_rho = 0.0
    # An index without a sign: one that may count from the end takes the lanes apart.
    for k in range(np.uint64(rays.shape[2])):
        a, b, c, tx, ty, tz = rays[i, 0, k], rays[i, 1, k], rays[i, 2, k], ways[q, 9, k], ways[q, 10, k], ways[q, 11, k]
        ahead, depth = ways[q, 6, k] * a + ways[q, 7, k] * b + ways[q, 8, k] * c, 1.0 + rho * tz
        # Where it was not seen, it is NaN, and no comparison holds.
        is_seen = (ahead > _LEAST_FORWARD) & (depth >= _LEAST_DEPTH_RATIO)
        h = 1.0 / depth if is_seen else 0.0
        ahead = ahead if is_seen else 1.0
        x, y = (x0 + rho * tx) * h, (y0 + rho * ty) * h
        rx = (ways[q, 0, k] * a + ways[q, 1, k] * b + ways[q, 2, k] * c) / ahead - x if is_seen else 0.0
        ry = (ways[q, 3, k] * a + ways[q, 4, k] * b + ways[q, 5, k] * c) / ahead - y if is_seen else 0.0
        jx, jy = h * (tx - x * tz), h * (ty - y * tz)
        one += h * h
        by_x += h * jx
        by_y += h * jy
        both += jx * jx + jy * jy
        score_x += h * rx
        score_y += h * ry
        by_rho += jx * rx + jy * ry
    return one, by_x, by_y, both, score_x, score_y, by_rho


@compiled_in_place
def _residual(rays: Floats, i: int, ways: Floats, q: int, x0: float, y0: float) -> tuple[float, float]:
    """What track i is off from (x0, y0) in the last view."""
    k = rays.shape[2] - 1
    a, b, c = rays[i, 0, k], rays[i, 1, k], rays[i, 2, k]
    ahead = ways[q, 6, k] * a + ways[q, 7, k] * b + ways[q, 8, k] * c
    rx = (ways[q, 0, k] * a + ways[q, 1, k] * b + ways[q, 2, k] * c) / ahead - x0
    return rx, (ways[q, 3, k] * a + ways[q, 4, k] * b + ways[q, 5, k] * c) / ahead - y0


@compiled_for("(f8[:, :, ::1], f8[:, ::1], f8[::1], f8[:, ::1])")
def _solve_shifts(normal: Floats, score: Floats, shift_sigma: Floats, change: Floats) -> None:
    """Fill the last three of each ``change (K, 6)``: the shifts of things that turn as their paths say."""
    for b in range(len(change)):
        for j in range(3, 6):
            normal[b, j, j] += 1.0 / max(shift_sigma[b], _NO_LENGTH) ** 2
        change[b, 3:] = _solved(normal[b, 3:, 3:].copy(), score[b, 3:].copy())


@compiled_for("(f8[:, :, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8, f8[:, ::1])")
def _solve_all(
    normal: Floats, score: Floats, shift_sigma: Floats, turned_rad: Floats, turn_sigma_rad: float, change: Floats
) -> None:
    """Fill ``change (K, 6)``, turns and shifts, with what is expected of both; unknowns are brought to one scale."""
    scale = np.empty(6)
    for b in range(len(change)):
        for j in range(6):
            normal[b, j, j] += 1.0 / (turn_sigma_rad if j < 3 else max(shift_sigma[b], _NO_LENGTH)) ** 2
            score[b, j] += turned_rad[b, j] / turn_sigma_rad**2 if j < 3 else 0.0
            scale[j] = 1.0 / np.sqrt(normal[b, j, j])
        for j in range(6):
            score[b, j] *= scale[j]
            for k in range(6):
                normal[b, j, k] *= scale[j] * scale[k]
        change[b] = scale * _solved(normal[b], score[b])


@compiled_in_place
def _solved(normal: Floats, score: Floats) -> Floats:
    """The solution of N normal equations (N,); NaN where one of them is, of which numba would make an error."""
    if not np.isfinite(normal.sum() + score.sum()):
        return np.full(len(score), np.nan)
    return np.asarray(np.linalg.solve(normal, score), dtype=np.float64)
