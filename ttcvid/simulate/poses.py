"""Where the camera and every body are at each picture, in the road frame and in the camera."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from ttcvid.model import Camera, Floats
from ttcvid.simulate.motion import Motion, heading_at, position_at, turn_rate_at, velocity_at
from ttcvid.simulate.scene import Body, Scene, camera_of

ROAD_FROM_MOUNT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Columns: the camera's x (right), y (down), z (forward) in a vehicle's axes (ahead, left, up)."""
JITTER_HZ = (1.1, 1.9, 3.1)
"""Frequencies of the pitch jitter: a car's body on its springs."""
SHAKE_HZ = (4.3, 6.1, 8.7)
"""Frequencies of the shake: a hand, a mount, a rotor."""
OVERTONES = (1.0, 1.7, 0.61)
"""Frequencies of sway and swing over that of their period."""


@dataclass(frozen=True)
class CameraPath:
    """The camera at N times: ``t_s (N,)``, ``cam_R_road (N, 3, 3)``, ``position_m`` and ``velocity_m_s (N, 3)``."""

    t_s: Floats
    cam_R_road: Floats
    position_m: Floats
    velocity_m_s: Floats


@dataclass(frozen=True)
class BodyPath:
    """A body at N times, in the road frame: ``road_R_body (N, 3, 3)``; positions, velocities, turning ``(N, 3)``."""

    road_R_body: Floats
    position_m: Floats
    velocity_m_s: Floats
    turn_rad_s: Floats


def camera_path(scene: Scene, t_s: Floats) -> CameraPath:
    """The camera of a scene at times ``(N,)``."""
    motion, own = own_motion(scene), scene.own_motion
    swing, _ = _waves(scene, 8, t_s, np.array(OVERTONES) / own.swing_period_s)
    shake, _ = _waves(scene, 9, t_s, np.array(SHAKE_HZ))
    pan, tilt, rock = np.radians(np.asarray(own.swing_deg) * swing + own.shake_deg * shake).T
    pitch = np.radians(scene.camera.pitch_deg) + _pitch_jitter_rad(scene, t_s) + tilt
    roll = np.radians(scene.camera.roll_deg) + rock
    road_R_cam = _rotations(heading_at(motion, t_s) + pan, pitch, roll) @ ROAD_FROM_MOUNT
    sway, sway_rate = _waves(scene, 10, t_s, np.array(OVERTONES) / own.sway_period_s)
    start, _ = _waves(scene, 10, np.zeros(1), np.array(OVERTONES) / own.sway_period_s)
    position = position_at(motion, t_s) + np.asarray(own.sway_m) * (sway - start)
    velocity = velocity_at(motion, t_s) + np.asarray(own.sway_m) * sway_rate
    return CameraPath(t_s, np.swapaxes(road_R_cam, 1, 2), position, velocity)


def body_path(body: Body, t_s: Floats) -> BodyPath:
    """A body at times ``(N,)``."""
    motion = body_motion(body)
    spin = np.radians(body.spin_deg_s)
    if not (motion.is_moving or motion.yaw_rate_rad_s or motion.lane_change_m or spin.any()):
        # Scenery, of which there is much: one time stands for all.
        rotation = _resting_rotation(motion.course_rad + motion.facing_rad, body.pitch_deg, body.bank_deg)
        at_rest = np.zeros((len(t_s), 3))
        position = np.broadcast_to(motion.start_m, (len(t_s), 3))
        return BodyPath(np.broadcast_to(rotation, (len(t_s), 3, 3)), position, at_rest, at_rest)
    pitch = np.full_like(t_s, np.radians(body.pitch_deg))
    roll = np.full_like(t_s, np.radians(body.bank_deg))
    rotation = _rotations(heading_at(motion, t_s), pitch, roll)
    if spin.any():
        rotation = Rotation.from_rotvec(np.multiply.outer(t_s, spin)).as_matrix() @ rotation
    turn = spin + turn_rate_at(motion, t_s)[:, None] * np.array([0.0, 0.0, 1.0])
    return BodyPath(rotation, position_at(motion, t_s), velocity_at(motion, t_s), turn)


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
        yaw_from_s=own.yaw_from_s,
        yaw_until_s=np.inf if own.yaw_until_s is None else own.yaw_until_s,
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
        yaw_from_s=body.yaw_from_s,
        yaw_until_s=np.inf if body.yaw_until_s is None else body.yaw_until_s,
        climb_m_s=climb,
        facing_rad=facing,
        lane_change_m=body.lane_change_m,
        lane_change_from_s=body.lane_change_from_s,
        lane_change_duration_s=body.lane_change_duration_s,
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


@lru_cache(maxsize=1024)
def _resting_rotation(yaw_rad: float, pitch_deg: float, roll_deg: float) -> Floats:
    """Rotation matrix ``(3, 3)`` of a body at rest, kept: the same scene is made ready several times."""
    return np.asarray(_rotations(np.array([yaw_rad]), np.radians([pitch_deg]), np.radians([roll_deg]))[0])


def _rotations(yaw_rad: Floats, pitch_rad: Floats, roll_rad: Floats) -> Floats:
    """Rotation matrices ``(N, 3, 3)`` from a vehicle's axes to the road's: yaw, then pitch, then roll (ISO 8855)."""
    return np.asarray(Rotation.from_euler("ZYX", np.stack([yaw_rad, pitch_rad, roll_rad], axis=-1)).as_matrix())


def _pitch_jitter_rad(scene: Scene, t_s: Floats) -> Floats:
    """Smooth pitch jitter ``(N,)`` of the given standard deviation: a few sines with phases from the seed."""
    phases = np.random.default_rng([scene.seed, 7]).uniform(0, 2 * np.pi, len(JITTER_HZ))
    waves = np.sin(2 * np.pi * np.multiply.outer(t_s, JITTER_HZ) + phases).sum(axis=-1)
    return np.asarray(np.radians(scene.own_motion.pitch_jitter_deg) * waves * np.sqrt(2 / len(JITTER_HZ)))


def _waves(scene: Scene, purpose: int, t_s: Floats, frequencies_hz: Floats) -> tuple[Floats, Floats]:
    """Smooth noise ``(N, 3)`` of unit standard deviation on three axes, and its rate in 1/s; phases from the seed."""
    phases = np.random.default_rng([scene.seed, purpose]).uniform(0, 2 * np.pi, (len(frequencies_hz), 3))
    angle = 2 * np.pi * np.multiply.outer(t_s, frequencies_hz)[:, :, None] + phases
    unit = np.sqrt(2 / len(frequencies_hz))
    rate = np.cos(angle) * (2 * np.pi * frequencies_hz)[:, None]
    return unit * np.sin(angle).sum(axis=1), unit * rate.sum(axis=1)
