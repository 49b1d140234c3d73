"""Planar motion: with a known horizon, epipoles lie on it.

The calibrated horizon is that of the camera as mounted. A car pitches and rolls on its springs, and the horizon moves
in the picture: it follows the camera's rotation from frame to frame, and returns to the calibrated one within seconds,
since errors of rotation add up, and a road that bends upwards turns the camera together with its plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.horizon.plane import horizon_px, normal_by_pitch_roll, normal_from_horizon, pitch_roll_rad
from ttcvid.geometry.paper.epipole import INFINITY_COSINE
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Camera, Floats, Horizon, HorizonOffset

# Time in which the horizon returns to where it was calibrated, s: a car's springs swing at 1 to 2 Hz and a braking car
# dips for a second or two, while the road's own slope changes over tens of seconds.
_RETURN_S = 2.0


@dataclass(frozen=True)
class HorizonPlane:
    """The plane of motion: unit ``normal (3,)`` with its ``covariance (3, 3)`` in rad^2, and its line in px.

    ``line_px`` are the heights of the line at both sides of the picture. The covariance is that of the calibration, in
    the camera as mounted; the few degrees of its springs do not matter.
    """

    normal: Floats
    covariance: Floats
    line_px: tuple[float, float]

    def sigma_rad(self, directions: Floats) -> Floats:
        """Standard deviation of n . dir by the plane's own error, for directions ``(..., 3)``."""
        variance = np.einsum("...i,ij,...j->...", directions, self.covariance, directions)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def horizon_plane(camera: Camera, horizon: Horizon) -> HorizonPlane:
    """The plane of a calibrated horizon."""
    normal = normal_from_horizon(camera, horizon)
    if horizon.covariance_rad2 is None:
        covariance = horizon.sigma_rad**2 * (np.eye(3) - np.outer(normal, normal))
    else:
        by_angles = normal_by_pitch_roll(*pitch_roll_rad(normal))
        covariance = by_angles @ np.array(horizon.covariance_rad2) @ by_angles.T
    return HorizonPlane(normal, covariance, (horizon.y_left_px, horizon.y_right_px))


def centre_sigma_px(camera: Camera, horizon: Horizon) -> float:
    """Standard deviation of the calibrated horizon's height at the centre of the picture, px."""
    plane = horizon_plane(camera, horizon)
    middle = 0.5 * (horizon.y_left_px + horizon.y_right_px)
    ahead = np.array([0.0, (middle - camera.cy_px) / camera.fy_px, 1.0])
    return float(camera.fy_px * plane.sigma_rad(ahead) / abs(plane.normal[1]))


def followed_plane(
    plane: HorizonPlane | None,
    calibrated: HorizonPlane | None,
    cam_R_prev: Floats | None,
    dt_s: float | None,
    camera: Camera,
) -> HorizonPlane | None:
    """The plane in the camera of this frame; None without a calibrated one.

    ``plane`` is that in the camera of the frame before, None where there was none; ``cam_R_prev (3, 3)`` the rotation
    since then, None where it is unknown.
    """
    if plane is None or calibrated is None:
        return calibrated
    normal = plane.normal if cam_R_prev is None else cam_R_prev @ plane.normal
    share = 1.0 if dt_s is None else 1.0 - np.exp(-max(dt_s, 0.0) / _RETURN_S)
    normal = normalize(normal + share * (calibrated.normal - normal))
    return replace(calibrated, normal=normal, line_px=horizon_px(camera, normal))


def onto_horizon(direction: Floats, covariance: Floats, plane: HorizonPlane) -> tuple[Floats, Floats]:
    """Move a direction onto the horizon along its covariance.

    The paper's correction of the epipole before times are computed; here it is the conditional mean given ``n . dir =
    0`` within the horizon's own error, so that a well-known epipole moves little. A unit vector ``(3,)`` and its
    covariance ``(3, 3)`` in the tangent plane, rad^2, in and out.

    Source: the paper's section 2.1, "Planar Motion".
    """
    basis = tangent_basis(direction)
    tangent_cov = basis.T @ covariance @ basis
    slope = basis.T @ plane.normal
    height = float(plane.normal @ direction)
    # The plane is taken as exact: a direction with a smaller covariance would not reach it otherwise.
    variance = float(slope @ tangent_cov @ slope) + 1e-18
    gain = tangent_cov @ slope / variance
    moved = normalize(direction - basis @ gain * height)
    reduced = tangent_cov - np.outer(gain, slope @ tangent_cov) + np.outer(gain, gain) * plane.sigma_rad(moved) ** 2
    new_basis = tangent_basis(moved)
    turn = new_basis.T @ basis
    return moved, new_basis @ turn @ reduced @ turn.T @ new_basis.T


def horizon_offset_px(direction: Floats, plane: HorizonPlane, camera: Camera) -> float | None:
    """Distance of an epipole from the horizon line in the undistorted picture, px, positive below it.

    None where the epipole is at infinity.
    """
    if abs(direction[2]) < INFINITY_COSINE:
        return None
    x_px = camera.fx_px * direction[0] / direction[2] + camera.cx_px
    y_px = camera.fy_px * direction[1] / direction[2] + camera.cy_px
    left, right = plane.line_px
    slope = (right - left) / (camera.image_size.width_px - 1)
    return float((y_px - left - slope * x_px) / np.hypot(1.0, slope))


def horizon_offset(direction: Floats, covariance: Floats, plane: HorizonPlane) -> HorizonOffset:
    """Angle of a direction ``(3,)`` below the horizon, with the standard deviation by its ``covariance (3, 3)``."""
    ahead = direction if direction[2] > 0.0 else -direction
    below_rad = -float(np.arcsin(np.clip(float(plane.normal @ ahead), -1.0, 1.0)))
    sigma_rad = float(np.sqrt(max(float(plane.normal @ covariance @ plane.normal), 0.0)))
    return HorizonOffset(below_rad, sigma_rad, float(ahead[2]))
