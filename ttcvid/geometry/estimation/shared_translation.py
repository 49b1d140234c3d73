"""The velocity that the points of a thing have in common, over its depth, and how surely they tell it.

A point at (x, y, 1) now, of relative depth 1 / rho in the thing, was at (x + rho a t, y + rho b t, 1 + rho c t), up to
its depth, when the thing moves by (a, b, c) = V / Z: the state of DESIGN section 3, of a whole thing.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import Points, RigidPaths, ways_of
from ttcvid.geometry.kernels.common_velocities import add_velocities
from ttcvid.model import Floats


def common_velocities(points: Points, cam_R_past: Floats, start_hz: Floats, n_steps: int) -> tuple[Floats, Floats]:
    """V / Z of each of K things, 1/s, and its information matrix: ``(K, 3)`` and ``(K, 3, 3)``.

    Gauss-Newton with robust weights on where the points were seen; place and depth of each point are unknown, too.

    Parameters
    ----------
    cam_R_past : (L, 3, 3) turns a ray of each view into the present camera.
    start_hz : (K, 3) V / Z to start from.
    """
    velocity, info, n_lanes = start_hz.copy(), np.zeros((len(start_hz), 3, 3)), points.rays.shape[2]
    ways = ways_of(RigidPaths(cam_R_past[None], np.zeros((1, len(cam_R_past), 3))), n_lanes)
    time = np.zeros(n_lanes)
    time[n_lanes - len(points.since_s) :] = points.since_s
    for _ in range(n_steps):
        info, score = np.zeros_like(info), np.zeros_like(velocity)
        add_velocities(points.rays, points.track, points.thing, points.sigma_norm, time, ways, velocity, info, score)
        is_told = np.linalg.det(info) > 0.0
        velocity[is_told] += np.linalg.solve(info[is_told], score[is_told, :, None])[..., 0]
    return velocity, info
