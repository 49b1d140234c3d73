"""The velocity that the points of a thing have in common, over its depth, and how surely they tell it.

A point at (x, y, 1) now, of relative depth 1 / rho in the thing, was at (x + rho a t, y + rho b t, 1 + rho c t), up to
its depth, when the thing moves by (a, b, c) = V / Z: the state of DESIGN section 3, of a whole thing.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import Points
from ttcvid.geometry.kernels.path_point import LEAST_DEPTH_RATIO, LEAST_FORWARD, ROBUST_SIGMAS
from ttcvid.model import Floats, Ints

# Things are about so many times as deep as they are wide in the picture, root mean square of both: depths of their
# points, as a part of the depth.
_DEPTH_OF_WIDTH, _LEAST_DEPTH = 2.0, 0.01


def common_velocities(points: Points, cam_R_past: Floats, start_hz: Floats, n_steps: int) -> tuple[Floats, Floats]:
    """V / Z of each of K things, 1/s, and its information matrix: ``(K, 3)`` and ``(K, 3, 3)``.

    Gauss-Newton with Huber's weights on where the points were seen; place and depth of each point are unknown, too.

    Parameters
    ----------
    cam_R_past : (L, 3, 3) turns a ray of each view into the present camera.
    start_hz : (K, 3) V / Z to start from.
    """
    n_views, velocity, info = len(points.since_s), start_hz.copy(), np.zeros((len(start_hz), 3, 3))
    rays = points.rays[points.track][..., points.rays.shape[2] - n_views :]
    is_used = rays[:, 2, -1] > LEAST_FORWARD
    rays, thing, sigma = rays[is_used], points.thing[is_used], points.sigma_norm[points.track[is_used]]
    turned = np.einsum("lij,mjl->mli", cam_R_past, rays)
    # Where a point was not seen it is NaN, and no comparison holds.
    is_seen = turned[..., 2] > LEAST_FORWARD
    seen = np.where(is_seen, turned[..., 2], np.nan)[..., None] ** -1.0 * turned[..., :2]
    place = rays[:, :2, -1] / rays[:, 2:, -1]
    precision = _depth_precisions(place, thing, len(start_hz))[thing]
    for _ in range(n_steps):
        rows = _rows(place, seen, points.since_s, velocity[thing], sigma)
        whole = rows.transpose(0, 2, 1) @ rows
        whole[:, 2, 2] += precision
        # What place and depth explain is taken away (Schur complement).
        whole = whole[:, 3:, 3:] - whole[:, 3:, :3] @ np.linalg.solve(whole[:, :3, :3], whole[:, :3, 3:])
        of_thing = np.zeros((len(velocity), 4, 4))
        np.add.at(of_thing, thing, whole)
        info, score = of_thing[:, :3, :3], of_thing[:, :3, 3:]
        is_told = np.linalg.det(info) > 0.0
        velocity[is_told] += np.linalg.solve(info[is_told], score[is_told])[..., 0]
    return velocity, info


def _rows(place: Floats, seen: Floats, t_s: Floats, velocity_hz: Floats, sigma: Floats) -> Floats:
    """How M points in L views follow their place, relative depth and velocity, and what is left: ``(M, 2 L, 7)``.

    In sigmas, times the root of the weight; 0 where not ``seen (M, L, 2)``.
    """
    t, along, ahead = t_s[:, None], velocity_hz[:, None, :2], velocity_hz[:, None, 2:]
    h = 1.0 / np.maximum(1.0 + ahead * t, LEAST_DEPTH_RATIO)
    was = (place[:, None] + along * t) * h
    off = (seen - was) / sigma[:, None, None]
    length = np.linalg.norm(off, axis=2)
    root = np.sqrt(ROBUST_SIGMAS / np.maximum(length, ROBUST_SIGMAS)) / sigma[:, None]
    rows = np.zeros((*seen.shape, 7))
    rows[:, :, 0, 0] = rows[:, :, 1, 1] = h[..., 0]
    rows[:, :, 0, 3] = rows[:, :, 1, 4] = (t * h)[..., 0]
    rows[..., 2], rows[..., 5] = (along - was * ahead) * t * h, -was * t * h
    rows[..., 6] = seen - was
    rows = np.where(np.isnan(root)[..., None, None], 0.0, rows * root[..., None, None])
    return rows.reshape(len(seen), 2 * len(t_s), 7)


def _depth_precisions(place: Floats, thing: Ints, n_things: int) -> Floats:
    """How surely the relative depths of a thing's points ``place (M, 2)`` are 1, by its width in the picture: (K,)."""
    n = np.maximum(np.bincount(thing, minlength=n_things), 1)
    mean, square = (
        np.stack([np.bincount(thing, column, n_things) for column in each.T], axis=1) / n[:, None]
        for each in (place, place**2)
    )
    width2 = np.maximum(np.sum(square - mean**2, axis=1), 0.0)
    return np.asarray(1.0 / (_DEPTH_OF_WIDTH**2 * width2 + _LEAST_DEPTH**2))
