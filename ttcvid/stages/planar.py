"""Planar motion: with a known horizon an epipole has to lie on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.horizon import normal_from_horizon
from ttcvid.geometry.planar import planar_epipole
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Camera, Floats, Horizon, Ints, Status
from ttcvid.stages.flows import Flows


@dataclass(frozen=True)
class HorizonPlane:
    """The plane of motion: unit ``normal (3,)``, its error ``sigma_rad``, and the line in px at both picture sides."""

    normal: Floats
    sigma_rad: float
    line_px: tuple[float, float]


def horizon_plane(camera: Camera, horizon: Horizon | None) -> HorizonPlane | None:
    """The plane of a calibrated horizon, None without one."""
    if horizon is None:
        return None
    normal = normal_from_horizon(camera, horizon)
    return HorizonPlane(normal, horizon.sigma_rad, (horizon.y_left_px, horizon.y_right_px))


def onto_horizon(direction: Floats, covariance: Floats, plane: HorizonPlane) -> tuple[Floats, Floats]:
    """A direction moved onto the horizon along its covariance, and the covariance that is left.

    The paper's correction of the epipole before the times are computed; here it is the conditional mean given
    ``n . dir = 0`` within the horizon's own error, so that a well-known epipole moves little sideways.

    Parameters
    ----------
    direction : (3,) unit vector, ``covariance (3, 3)`` in its tangent plane, rad^2.
    """
    basis = tangent_basis(direction)
    tangent_cov = basis.T @ covariance @ basis
    slope = basis.T @ plane.normal
    height = float(plane.normal @ direction)
    # A direction that is known better than the horizon would not come down to it: the plane is taken at its word.
    variance = float(slope @ tangent_cov @ slope) + 1e-18
    gain = tangent_cov @ slope / variance
    moved = normalize(direction - basis @ gain * height)
    reduced = tangent_cov - np.outer(gain, slope @ tangent_cov) + np.outer(gain, gain) * plane.sigma_rad**2
    new_basis = tangent_basis(moved)
    turn = new_basis.T @ basis
    return moved, new_basis @ turn @ reduced @ turn.T @ new_basis.T


def horizon_offset_px(direction: Floats, plane: HorizonPlane, camera: Camera) -> float | None:
    """Distance of an epipole from the horizon line in the undistorted picture, px, positive below it.

    None where the epipole is at infinity.
    """
    if abs(direction[2]) < np.sin(np.radians(1.0)):
        return None
    x_px = camera.fx_px * direction[0] / direction[2] + camera.cx_px
    y_px = camera.fy_px * direction[1] / direction[2] + camera.cy_px
    left, right = plane.line_px
    slope = (right - left) / (camera.image_size.width_px - 1)
    return float((y_px - left - slope * x_px) / np.hypot(1.0, slope))


def planar_directions(flows: Flows, plane: HorizonPlane) -> tuple[Floats, Floats, Ints]:
    """Direction of every track by itself, where its flow line meets the horizon (the paper's planar case).

    Returns
    -------
    direction : (N, 3), NaN where there is none.
    covariance : (N, 3, 3) rad^2.
    status : (N,) why there is none.
    """
    direction, covariance, status = planar_epipole(
        flows.first, flows.second, plane.normal, flows.sigma_rad, plane.sigma_rad
    )
    has_none = ~np.isin(status, [Status.ok, Status.epipole_at_infinity])
    direction = np.where(has_none[:, None], np.nan, direction)
    return direction, np.where(has_none[:, None, None], np.nan, covariance), status
