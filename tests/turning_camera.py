"""Points of a static scene as a turning and moving camera with an exactly known focal length sees them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.model import Floats, ImageSize, PointSet
from ttcvid.stages.egomotion.focal_length import SeenPoints

SIZE = ImageSize(800, 450)
CENTRE_PX = np.array([399.5, 224.5])


@dataclass(frozen=True)
class Drive:
    """Yaw and pitch (rad) and place (m, to the right, down, ahead) of the camera over time in s."""

    yaw_rad: Callable[[float], float]
    pitch_rad: Callable[[float], float]
    place_m: Callable[[float], tuple[float, float, float]]


def _none(_: float) -> float:
    return 0.0


def _arc(t: float, speed: float = 8.0, rate: float = 0.2) -> tuple[float, float, float]:
    return speed / rate * (1.0 - np.cos(rate * t)), 0.0, speed / rate * np.sin(rate * t)


PAN = Drive(lambda t: 0.25 * t, lambda t: 0.02 * np.sin(2 * t), lambda t: (0.0, 0.0, 0.0))
PAN_AND_STEP = Drive(lambda t: 0.25 * t, lambda t: 0.02 * np.sin(2 * t), lambda t: (0.8 * t, 0.0, 0.3 * t))
CURVE = Drive(lambda t: 0.2 * t, lambda t: 0.005 * np.sin(3 * t), _arc)
STRAIGHT = Drive(_none, lambda t: 0.0005 * np.sin(3 * t), lambda t: (0.0, 0.0, 8.0 * t))
REST = Drive(_none, _none, lambda t: (0.0, 0.0, 0.0))


def seen_points(
    drive: Drive,
    focal_px: float,
    *,
    sigma_px: float = 0.0,
    n_frames: int = 18,
    rate_hz: float = 20.0,
    movers: float = 0.0,
    seed: int = 0,
    n_points: int = 4000,
) -> list[SeenPoints]:
    """What a tracker would see: points within the picture and less than 80 m ahead, a third of them on the ground.

    ``movers`` is the part of the points that move to the left together, by 5 m/s.
    """
    rng = np.random.default_rng(seed)
    place = rng.uniform((-70.0, -12.0, -20.0), (70.0, 1.5, 110.0), (n_points, 3))
    place[: n_points // 3, 1] = 1.5
    velocity = np.zeros((n_points, 3))
    velocity[rng.random(n_points) < movers] = (-5.0, 0.0, 0.0)
    return [_seen(drive, focal_px, place + velocity * t_s, t_s, rng, sigma_px) for t_s in np.arange(n_frames) / rate_hz]


def _seen(
    drive: Drive, focal_px: float, place: Floats, t_s: float, rng: np.random.Generator, sigma_px: float
) -> SeenPoints:
    # A camera that turns to the right moves the scene to the left.
    yaw, pitch = drive.yaw_rad(t_s), drive.pitch_rad(t_s)
    cam_R_world = rotation_from_vector(np.array([pitch, 0.0, 0.0])) @ rotation_from_vector(np.array([0.0, -yaw, 0.0]))
    seen = (place - np.array(drive.place_m(t_s))) @ cam_R_world.T
    is_ahead = (seen[:, 2] > 2.0) & (np.linalg.norm(seen, axis=1) < 80.0)
    xy_px = np.full((len(place), 2), np.inf)
    xy_px[is_ahead] = focal_px * seen[is_ahead, :2] / seen[is_ahead, 2:] + CENTRE_PX
    is_inside = np.all((xy_px > 0.0) & (xy_px < np.array([SIZE.width_px, SIZE.height_px]) - 1.0), axis=1)
    track_id = np.flatnonzero(is_inside)
    noisy = xy_px[track_id] + rng.normal(0.0, 1.0, (len(track_id), 2)) * sigma_px
    return SeenPoints(float(t_s), PointSet(track_id, noisy))
