"""How far a rigid thing has gone in the last step, where its way before that is known."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.geometry.medians import median
from ttcvid.geometry.rigid_path import PathFit, Points, RigidPaths
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


def with_newest_step(points: Points, paths: RigidPaths, fit: PathFit, weight: Floats) -> RigidPaths:
    """The path of one thing, its last step corrected by all points, without what each of them is free to follow.

    A step that is wrong moves all past views alike. Where points and views are corrected in turn
    (`rigid_path.refined_paths`), the points go along: each lies where most of its views have it, and one that began a
    moment ago fits any step. A scene before a camera that brakes would keep its speed.

    Parameters
    ----------
    points : M points of the thing.
    paths : of the thing, its last step roughly known.
    fit : of the points on the path.
    weight : (M,) of each point, 0 leaves it out.

    Source: weighted least squares for the shift s of all past views, expected to be within the mean step of the path;
    the unknowns x, y, rho of each point are eliminated (Schur complement).
    """
    since_s, path = points.since_s, paths.path[0]
    is_used = np.isfinite(fit.rate_hz) & (weight > 0.0)
    if len(since_s) < _LEAST_VIEWS or not is_used.any():
        return paths
    typical = max(median(fit.misfit[is_used]), _LEAST_TYPICAL_MISFIT)
    by_misfit = np.where(is_used, weight / (1.0 + fit.misfit / (_HALF_WEIGHT * typical)), 0.0)
    mean_step = np.sqrt((path * path).sum(axis=1).max()) * since_s[-2] / since_s[0]
    normal, score = np.eye(3) / max(mean_step, _NO_LENGTH) ** 2, np.zeros(3)
    _add_up(
        points.rays,
        points.track,
        points.sigma_norm,
        paths.cam_R_past[0],
        path,
        fit.place,
        fit.rate_hz,
        by_misfit,
        normal,
        score,
    )
    shifted = path.copy()
    shifted[:-1] += np.linalg.solve(normal, score)
    return RigidPaths(paths.cam_R_past, shifted[None])


@compiled
def _add_up(
    rays: Floats,
    track: Ints,
    sigma: Floats,
    rotations: Floats,
    path: Floats,
    place: Floats,
    rate: Floats,
    weight: Floats,
    normal: Floats,
    score: Floats,
) -> None:
    """Add to ``normal (3, 3)`` and ``score (3,)`` of the shift s what each of M points says of it.

    With h = 1 / (1 + rho T_z), the picture p of a past view moves by h with x and y, by h (T_xy - p T_z) with
    rho, and by rho h (s_xy - p s_z) with the shift; that of the present view by x and y alone.
    """
    before, n_views = rays.shape[2] - len(path), len(path)
    # Of one view, by x or y, rho, and s; of all views, by x, y, rho, s.
    row, sums, total = np.empty((2, 6)), np.empty(6), np.empty((6, 6))
    for m in range(len(track)):
        if not (weight[m] > 0.0 and rate[m] > 0.0):
            continue
        i, rho, inverse = track[m], rate[m], 1.0 / (sigma[track[m]] * sigma[track[m]])
        sums[:], total[:] = 0.0, 0.0
        for k in range(n_views):
            a, b, c = rays[i, 0, before + k], rays[i, 1, before + k], rays[i, 2, before + k]
            ahead = rotations[k, 2, 0] * a + rotations[k, 2, 1] * b + rotations[k, 2, 2] * c
            depth = 1.0 + rho * path[k, 2]
            # Where it was not seen, it is NaN, and no comparison holds.
            if not (ahead > _LEAST_FORWARD and depth >= _LEAST_DEPTH_RATIO):
                continue
            h = 1.0 / depth
            px, py = (place[m, 0] + rho * path[k, 0]) * h, (place[m, 1] + rho * path[k, 1]) * h
            rx = (rotations[k, 0, 0] * a + rotations[k, 0, 1] * b + rotations[k, 0, 2] * c) / ahead - px
            ry = (rotations[k, 1, 0] * a + rotations[k, 1, 1] * b + rotations[k, 1, 2] * c) / ahead - py
            g = rho * h if k < n_views - 1 else 0.0
            row[0] = h, 0.0, h * (path[k, 0] - px * path[k, 2]), g, 0.0, -g * px
            row[1] = 0.0, h, h * (path[k, 1] - py * path[k, 2]), 0.0, g, -g * py
            for p in range(6):
                sums[p] += inverse * (row[0, p] * rx + row[1, p] * ry)
                for q in range(p + 1):
                    total[p, q] += inverse * (row[0, p] * row[0, q] + row[1, p] * row[1, q])
        _eliminate(total, sums)
        for p in range(3):
            score[p] += weight[m] * sums[3 + p]
            for q in range(p + 1):
                normal[p, q] += weight[m] * total[3 + p, 3 + q]
    for p in range(3):
        for q in range(p):
            normal[q, p] = normal[p, q]


@compiled
def _eliminate(total: Floats, sums: Floats) -> None:
    """Take the first three unknowns out of normal equations ``total (6, 6)``, its lower half, and ``sums (6,)``."""
    for p in range(3):
        pivot = total[p, p]
        # A point that does not move says nothing of the way; nor does one that the others tell nothing of.
        if not pivot > 0.0:
            continue
        for q in range(p + 1, 6):
            part = total[q, p] / pivot
            sums[q] -= part * sums[p]
            for r in range(p + 1, q + 1):
                total[q, r] -= part * total[r, p]
