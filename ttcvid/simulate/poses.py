"""Where the camera and every body are at each picture, in the road frame and in the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ttcvid.model import Camera, Floats
from ttcvid.simulate.motion import Motion, heading_at, position_at, velocity_at
from ttcvid.simulate.scene import Body, Scene, camera_of

ROAD_FROM_MOUNT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Columns: the camera's x (right), y (down), z (forward) in a vehicle's axes (ahead, left, up)."""
JITTER_HZ = (1.1, 1.9, 3.1)
"""Frequencies of the pitch jitter: a car's body on its springs."""


@dataclass(frozen=True)
class CameraPath:
    """The camera at N times: ``t_s (N,)``, ``cam_R_road (N, 3, 3)``, ``position_m`` and ``velocity_m_s (N, 3)``."""

    t_s: Floats
    cam_R_road: Floats
    position_m: Floats
    velocity_m_s: Floats


@dataclass(frozen=True)
class BodyPath:
    """A body at N times, in the road frame: ``road_R_body (N, 3, 3)``, positions, velocities ``(N, 3)``."""

    road_R_body: Floats
    position_m: Floats
    velocity_m_s: Floats
    yaw_rate_rad_s: float


def camera_path(scene: Scene, t_s: Floats) -> CameraPath:
    """The camera of a scene at times ``(N,)``."""
    motion = own_motion(scene)
    pitch = np.radians(scene.camera.pitch_deg) + _pitch_jitter_rad(scene, t_s)
    roll = np.full_like(pitch, np.radians(scene.camera.roll_deg))
    road_R_cam = _rotations(heading_at(motion, t_s), pitch, roll) @ ROAD_FROM_MOUNT
    return CameraPath(t_s, np.swapaxes(road_R_cam, 1, 2), position_at(motion, t_s), velocity_at(motion, t_s))


def body_path(body: Body, t_s: Floats) -> BodyPath:
    """A body at times ``(N,)``."""
    motion = body_motion(body)
    pitch = np.full_like(t_s, np.radians(body.pitch_deg))
    roll = np.full_like(t_s, np.radians(body.bank_deg))
    rotation = _rotations(heading_at(motion, t_s), pitch, roll)
    return BodyPath(rotation, position_at(motion, t_s), velocity_at(motion, t_s), motion.yaw_rate_rad_s)


def own_motion(scene: Scene) -> Motion:
    """The camera's own motion."""
    own = scene.own_motion
    return Motion(
        start_m=(0.0, 0.0, scene.camera.height_m),
        course_rad=np.radians(own.heading_deg),
        speed_m_s=own.speed_m_s,
        acceleration_m_s2=own.acceleration_m_s2,
        acceleration_from_s=own.acceleration_from_s,
        acceleration_until_s=np.inf if own.acceleration_until_s is None else own.acceleration_until_s,
        yaw_rate_rad_s=np.radians(own.yaw_rate_deg_s),
        climb_m_s=own.climb_m_s,
        sideslip_rad=np.radians(own.sideslip_amplitude_deg),
        sideslip_period_s=own.sideslip_period_s,
    )


def body_motion(body: Body) -> Motion:
    """The motion of a body."""
    course = np.radians(body.heading_deg or 0.0)
    speed, climb, facing = body.speed_m_s, 0.0, 0.0
    if body.velocity_m_s is not None:
        vx, vy, climb = body.velocity_m_s
        speed = float(np.hypot(vx, vy))
        heading = course
        course = float(np.arctan2(vy, vx)) if speed > 0 else heading
        facing = heading - course if body.heading_deg is not None else 0.0
    return Motion(
        start_m=body.at_m,
        course_rad=course,
        speed_m_s=speed,
        acceleration_m_s2=body.acceleration_m_s2,
        acceleration_from_s=body.acceleration_from_s,
        acceleration_until_s=np.inf if body.acceleration_until_s is None else body.acceleration_until_s,
        yaw_rate_rad_s=np.radians(body.yaw_rate_deg_s),
        climb_m_s=climb,
        facing_rad=facing,
    )


def rotation_vectors_rad(path: CameraPath) -> Floats:
    """Rotation vectors ``(N, 3)`` of ``cam_R_prev`` of each picture; NaN in the first row."""
    result = np.full((len(path.t_s), 3), np.nan)
    if len(path.t_s) > 1:
        cam_R_prev = path.cam_R_road[1:] @ np.swapaxes(path.cam_R_road[:-1], 1, 2)
        result[1:] = Rotation.from_matrix(cam_R_prev).as_rotvec()
    return result


def mean_velocities_m_s(path: CameraPath) -> Floats:
    """Own mean velocity since the previous picture in the present camera ``(N, 3)``; NaN in the first row."""
    result = np.full((len(path.t_s), 3), np.nan)
    mean = np.diff(path.position_m, axis=0) / np.diff(path.t_s)[:, None]
    result[1:] = np.einsum("nij,nj->ni", path.cam_R_road[1:], mean)
    return result


def horizon_lines_px(camera: Camera, cam_R_road: Floats) -> Floats:
    """The horizon ``(N, 2)``: y at x = 0 and at x = width - 1, in undistorted pixels.

    The rays of the horizon are those normal to the road's vertical: up . ray = 0.
    """
    up = cam_R_road[:, :, 2]
    x_px = np.array([0.0, camera.image_size.width_px - 1.0])
    x = (x_px - camera.cx_px) / camera.fx_px
    y = -(up[:, :1] * x + up[:, 2:]) / up[:, 1:2]
    return y * camera.fy_px + camera.cy_px


def mean_horizon_px(scene: Scene) -> tuple[float, float]:
    """The horizon of the camera as mounted, without the jitter: y at x = 0 and at x = width - 1."""
    pitch, roll = np.radians([scene.camera.pitch_deg]), np.radians([scene.camera.roll_deg])
    road_R_cam = _rotations(np.zeros(1), pitch, roll) @ ROAD_FROM_MOUNT
    left, right = horizon_lines_px(camera_of(scene), np.swapaxes(road_R_cam, 1, 2))[0]
    return float(left), float(right)


def _rotations(yaw_rad: Floats, pitch_rad: Floats, roll_rad: Floats) -> Floats:
    """Rotation matrices ``(N, 3, 3)`` from a vehicle's axes to the road's: yaw, then pitch, then roll (ISO 8855)."""
    return np.asarray(Rotation.from_euler("ZYX", np.stack([yaw_rad, pitch_rad, roll_rad], axis=-1)).as_matrix())


def _pitch_jitter_rad(scene: Scene, t_s: Floats) -> Floats:
    """Smooth pitch jitter ``(N,)`` of the given standard deviation: a few sines with phases from the seed."""
    phases = np.random.default_rng([scene.seed, 7]).uniform(0, 2 * np.pi, len(JITTER_HZ))
    waves = np.sin(2 * np.pi * np.multiply.outer(t_s, JITTER_HZ) + phases).sum(axis=-1)
    return np.asarray(np.radians(scene.own_motion.pitch_jitter_deg) * waves * np.sqrt(2 / len(JITTER_HZ)))
