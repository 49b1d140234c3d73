"""How far rigid things have gone and turned in the last step, where their ways before that are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled
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
    count, is_used = len(paths), np.isfinite(fit.rate_hz) & (weight > 0.0)
    if len(points.since_s) < _LEAST_VIEWS or not is_used.any():
        return paths
    typical = np.maximum(medians(np.where(is_used, fit.misfit, np.nan), points.thing, count), _LEAST_TYPICAL_MISFIT)
    by_misfit = np.where(is_used, weight / (1.0 + fit.misfit / (_HALF_WEIGHT * typical[points.thing])), 0.0)
    normal, score = np.zeros((count, 6, 6)), np.zeros((count, 6))
    middle = np.zeros((count, 3)) if priors.middle is None else priors.middle
    _add_up(
        points.rays,
        points.track,
        points.thing,
        points.sigma_norm,
        paths.cam_R_past,
        paths.path,
        middle,
        fit.place,
        fit.rate_hz,
        by_misfit,
        normal,
        score,
    )
    normal[:, [3, 4, 5], [3, 4, 5]] += 1.0 / np.maximum(priors.shift_sigma, _NO_LENGTH)[:, None] ** 2
    path, cam_R_past = paths.path.copy(), paths.cam_R_past
    if priors.turned_rad is None:
        path[:, :-1] -= np.linalg.solve(normal[:, 3:, 3:], score[:, 3:, None])[:, None, :, 0]
        return RigidPaths(cam_R_past, path)
    turn_precision = priors.turn_sigma_rad**-2.0
    normal[:, [0, 1, 2], [0, 1, 2]] += turn_precision
    score[:, :3] += turn_precision * priors.turned_rad
    scale = 1.0 / np.sqrt(np.diagonal(normal, axis1=1, axis2=2))
    change = scale * np.linalg.solve(normal * scale[:, None] * scale[:, :, None], (scale * score)[..., None])[..., 0]
    turn = rotation_from_vector(change[:, :3])
    path[:, :-1] = (path[:, :-1] + middle[:, None]) @ turn.transpose(0, 2, 1) - (middle + change[:, 3:])[:, None]
    cam_R_past = cam_R_past.copy()
    cam_R_past[:, :-1] = turn[:, None] @ cam_R_past[:, :-1]
    return RigidPaths(cam_R_past, path)


@compiled
def _add_up(
    rays: Floats,
    track: Ints,
    thing: Ints,
    sigma: Floats,
    rotations: Floats,
    paths: Floats,
    middle: Floats,
    place: Floats,
    rate: Floats,
    weight: Floats,
    normal: Floats,
    score: Floats,
) -> None:
    """Add to ``normal (K, 6, 6)`` and ``score (K, 6)`` of turns w and shifts s what each of M points says of them.

    With h = 1 / (1 + rho T_z), the picture p of a view moves by h with x and y and by h (T_xy - p T_z) with rho; that
    of the present view, at (x, y, 1), by B (w x ((x, y, 1) - rho C) + rho s) too, with B = [[1, 0, -x], [0, 1, -y]] and
    ``middle (K, 3)``, C, about which a thing turns. A point of which nothing but this is known could be anywhere: with
    the information N of all views on x, y, rho, and that of a coordinate of the present view, i, what the residual
    there says of B (...) weighs i - i^2 N^-1.
    """
    n_views = paths.shape[1]
    before, row, along = rays.shape[2] - n_views, np.empty((2, 6)), np.empty((2, 6))
    for m in range(len(track)):
        if not weight[m] > 0.0:
            continue
        i, b, x0, y0, rho = track[m], thing[m], place[m, 0], place[m, 1], rate[m]
        one = by_x = by_y = both = score_x = score_y = by_rho = rx = ry = 0.0
        for k in range(n_views):
            p, q, z = rays[i, 0, before + k], rays[i, 1, before + k], rays[i, 2, before + k]
            ahead = rotations[b, k, 2, 0] * p + rotations[b, k, 2, 1] * q + rotations[b, k, 2, 2] * z
            depth = 1.0 + rho * paths[b, k, 2]
            # Where it was not seen, it is NaN, and no comparison holds.
            if not (ahead > _LEAST_FORWARD and depth >= _LEAST_DEPTH_RATIO):
                continue
            h = 1.0 / depth
            x, y = (x0 + rho * paths[b, k, 0]) * h, (y0 + rho * paths[b, k, 1]) * h
            rx = (rotations[b, k, 0, 0] * p + rotations[b, k, 0, 1] * q + rotations[b, k, 0, 2] * z) / ahead - x
            ry = (rotations[b, k, 1, 0] * p + rotations[b, k, 1, 1] * q + rotations[b, k, 1, 2] * z) / ahead - y
            jx, jy = h * (paths[b, k, 0] - x * paths[b, k, 2]), h * (paths[b, k, 1] - y * paths[b, k, 2])
            one, by_x, by_y, both = one + h * h, by_x + h * jx, by_y + h * jy, both + jx * jx + jy * jy
            score_x, score_y, by_rho = score_x + h * rx, score_y + h * ry, by_rho + jx * rx + jy * ry
        # Of the point by all views, and the residual of the present one, the last.
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
        row[0] = -x0 * y, z + x0 * x, -y, rho, 0.0, -rho * x0
        row[1] = -z - y0 * y, y0 * x, x, 0.0, rho, -rho * y0
        information = weight[m] / (sigma[i] * sigma[i])
        for j in range(6):
            along[0, j] = information * (xx * row[0, j] + xy * row[1, j])
            along[1, j] = information * (xy * row[0, j] + yy * row[1, j])
            score[b, j] += information * (row[0, j] * rx + row[1, j] * ry)
        for j in range(6):
            for k in range(6):
                normal[b, j, k] += row[0, j] * along[0, k] + row[1, j] * along[1, k]
