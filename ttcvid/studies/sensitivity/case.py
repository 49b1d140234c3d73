"""The case of a sensitivity study: one point that moves past a camera, and what its picture knows of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.model import Floats

KM_H = 3.6


@dataclass(frozen=True)
class Case:
    """A point straight ahead at ``distance_m``, ``height_m`` off the horizontal plane through the camera.

    It moves relative to the camera with ``speed_m_s``, ``angle_rad`` off the optical axis, towards the camera. The
    picture is ``focal_px`` behind the lens, ``sigma_px`` is the standard deviation of a coordinate, and pictures are
    ``step_s`` apart. ``baseline_m`` is that of the stereo pair.
    """

    distance_m: float
    height_m: float
    speed_m_s: float
    angle_rad: float
    focal_px: float
    sigma_px: float
    step_s: float
    baseline_m: float

    @property
    def position_m(self) -> Floats:
        """P (3,) at the last picture, in the camera."""
        return np.array([0.0, self.height_m, self.distance_m])

    @property
    def velocity_m_s(self) -> Floats:
        """V (3,) relative to the camera: horizontal, and towards it."""
        speed, angle = self.speed_m_s, self.angle_rad
        return np.array([speed * math.sin(angle), 0.0, -speed * math.cos(angle)])

    @property
    def state(self) -> Floats:
        """(x, y, a, b, c) at the last picture: without unit, and in 1/s."""
        x, y, z = self.position_m
        a, b, c = self.velocity_m_s / z
        return np.array([x / z, y / z, a, b, c])

    @property
    def sigma_norm(self) -> float:
        """Standard deviation of a coordinate in the plane z = 1."""
        return self.sigma_px / self.focal_px

    def times_s(self, n_frames: int) -> Floats:
        """Times ``(L,)`` of the last pictures, oldest first, relative to the last one."""
        return np.asarray(self.step_s * np.arange(1 - n_frames, 1))

    def with_(self, **changes: float) -> Case:
        """The same case with some values changed."""
        return replace(self, **changes)


@dataclass(frozen=True)
class Errors:
    """One standard deviation of the direction in rad (both axes together) and of the times, relative to them.

    NaN or infinite where the case defines none.
    """

    direction_rad: float
    ttc_z: float
    tcpa: float


def errors_from_covariance(w: Floats, ray: Floats, cov: Floats) -> Errors:
    """First-order errors from the covariance ``(5, 5)`` of (x, y, a, b, c), with w = (a, b, c) and ray = (x, y, 1).

    dir = w / |w|; ttc_z = -1 / c; tcpa = -(ray . w) / |w|^2.
    """
    speed2 = float(w @ w)
    direction = w / np.sqrt(speed2)
    tangent = (np.eye(3) - np.outer(direction, direction)) / np.sqrt(speed2)
    closing = float(ray @ w)
    # d ln tcpa by (x, y) and by (a, b, c).
    gradient = np.concatenate([w[:2], ray]) / closing if closing else np.full(5, np.inf)
    gradient[2:] -= 2.0 * w / speed2
    direction_variance = float(np.trace(tangent @ cov[2:, 2:] @ tangent))
    with np.errstate(divide="ignore", invalid="ignore"):
        ttc_z = float(np.sqrt(cov[4, 4]) / np.abs(w[2]))
        tcpa = float(np.sqrt(gradient @ cov @ gradient))
    return Errors(float(np.sqrt(direction_variance)), ttc_z, tcpa)
