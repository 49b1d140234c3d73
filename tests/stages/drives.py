"""A camera that drives through points, as the history that the stages see: exact truth frame by frame."""

from dataclasses import dataclass

import numpy as np
from two_views import FOCAL_PX, HEIGHT_PX, WIDTH_PX, points_of_a_street

from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.model import Camera, ImageSize, PointSet
from ttcvid.stages.tracking.history import empty_history, extended

CAMERA = Camera(FOCAL_PX, FOCAL_PX, (WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2, ImageSize(WIDTH_PX, HEIGHT_PX))
DT_S = 0.1


@dataclass(frozen=True)
class Drive:
    """``rays (T, N, 3)`` in the camera of their own frame, and ``cam_R_prev (T, 3, 3)`` of each step."""

    rays: np.ndarray
    cam_R_prev: np.ndarray

    @property
    def n(self):
        return self.rays.shape[1]

    def points(self, frame):
        rays = self.rays[frame]
        xy_px = rays[:, :2] / rays[:, 2:] * FOCAL_PX + [CAMERA.cx_px, CAMERA.cy_px]
        return PointSet(np.arange(self.n), xy_px)

    def cam_R(self, present, past):
        """Rotation that turns a ray of a past camera into the present one."""
        turn = np.eye(3)
        for frame in range(past + 1, present + 1):
            turn = self.cam_R_prev[frame] @ turn
        return turn


def drive(n_frames, rng, n=200, speed_m=0.5, turn_deg=(0.0, 0.0, 0.0), sigma_px=0.0, depth_m=(15.0, 80.0)):
    """Through static points along the axis of the present camera, turning by the same rotation in every step."""
    step = rotation_from_vector(np.radians(np.asarray(turn_deg, dtype=float)))
    places = points_of_a_street(n, rng, depth_m)
    rays, turns = [], []
    for frame in range(n_frames):
        if frame:
            places = places @ step.T - [0.0, 0.0, speed_m]
        plane = places / places[:, 2:]
        plane[:, :2] += sigma_px / FOCAL_PX * rng.normal(size=(n, 2))
        rays.append(normalize(plane))
        turns.append(step if frame else np.eye(3))
    return Drive(np.array(rays), np.array(turns))


def extended_by(history, motion, frame, max_frames=11):
    return extended(history, frame, frame * DT_S, motion.points(frame), motion.rays[frame], max_frames)


def start(sigma_px=0.2):
    return empty_history(CAMERA, sigma_px)
