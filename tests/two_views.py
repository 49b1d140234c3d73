"""Two exact views of a static scene with movers, and noise of the stated size."""

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.stages.egomotion.relative_pose import picture_region

FOCAL_PX, WIDTH_PX, HEIGHT_PX = 720.0, 1242, 375


@dataclass(frozen=True)
class TwoViews:
    """Unit rays (N, 3) of the same points, each in its own camera, the truth behind them, and which ones move."""

    rays_prev: np.ndarray
    rays_cam: np.ndarray
    sigma_rad: np.ndarray
    region: np.ndarray
    is_mover: np.ndarray
    cam_R_prev: np.ndarray
    direction: np.ndarray

    @property
    def observed(self):
        return self.rays_prev, self.rays_cam, self.sigma_rad, self.region


def points_of_a_street(n, rng, depth_m=(6.0, 80.0)):
    """Points (n, 3) all over the present picture, at depths that are even in 1/Z."""
    x = rng.uniform(-0.5, 0.5, n) * WIDTH_PX / FOCAL_PX
    y = rng.uniform(-0.5, 0.5, n) * HEIGHT_PX / FOCAL_PX
    z = 1.0 / rng.uniform(1.0 / depth_m[1], 1.0 / depth_m[0], n)
    return np.column_stack([x * z, y * z, z])


def two_views(
    rng,
    n=400,
    turn_deg=(0.0, 0.0, 0.0),
    travel_m=(0.0, 0.0, 1.0),
    sigma_px=0.2,
    movers=(),
    told_sigma_px=None,
    depth_m=(6.0, 80.0),
):
    """Views before and after a camera has turned by a rotation vector and travelled (in the present camera's axes).

    ``movers``: (part of the picture's width it spans from the left, velocity in m a step) of each moving body.
    """
    points = points_of_a_street(n, rng, depth_m)
    travel = np.asarray(travel_m, dtype=float)
    velocity = np.tile(-travel, (n, 1))
    part = (points[:, 0] / points[:, 2] * FOCAL_PX) / WIDTH_PX + 0.5
    is_mover = np.zeros(n, dtype=bool)
    for (low, high), own_velocity in movers:
        inside = (part >= low) & (part < high)
        velocity[inside] += own_velocity
        is_mover |= inside
    turn = rotation_from_vector(np.radians(np.asarray(turn_deg, dtype=float)))
    before = (points - velocity) @ turn
    noise_rad = sigma_px / FOCAL_PX
    rays_prev = normalize(normalize(before) + noise_rad * rng.normal(size=(n, 3)))
    rays_cam = normalize(normalize(points) + noise_rad * rng.normal(size=(n, 3)))
    told_rad = (sigma_px if told_sigma_px is None else told_sigma_px) / FOCAL_PX
    length = np.linalg.norm(travel)
    direction = -travel / length if length else np.full(3, np.nan)
    return TwoViews(rays_prev, rays_cam, np.full(n, told_rad), picture_region(rays_cam), is_mover, turn, direction)


def angle_deg(one, other):
    """Angle between two directions."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))
