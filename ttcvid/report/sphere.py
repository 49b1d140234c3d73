"""Directions on the sphere about the camera, as azimuth and elevation in degrees, with their errors.

Azimuth is positive to the right of the optical axis, elevation positive above it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.model import Camera, Floats

OUTLINE_POINTS_PER_SIDE = 16


def azimuth_elevation_deg(directions: Floats) -> Floats:
    """Azimuth and elevation ``(N, 2)`` of directions ``(N, 3)`` of any length, in deg.

    >>> azimuth_elevation_deg(np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 0.0], [0.0, -1.0, 1.0]]))
    array([[ 0.,  0.],
           [90.,  0.],
           [ 0., 45.]])
    """
    x, y, z = np.asarray(directions, dtype=float).T
    return np.asarray(np.degrees(np.stack([np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z))], axis=1)) + 0.0)


def azimuth_elevation_errors(directions: Floats, covariances: Floats) -> Floats:
    """Standard deviations of azimuth and elevation in deg, and their correlation, ``(N, 3)``.

    ``directions (N, 3)`` are unit vectors, ``covariances (N, 3, 3)`` theirs, in the tangent plane; by first order,
    which says nothing near the poles.
    """
    x, y, z = np.asarray(directions, dtype=float).T
    across = np.hypot(x, z)
    with np.errstate(divide="ignore", invalid="ignore"):
        none = np.zeros_like(x)
        of_azimuth = np.stack([z / across**2, none, -x / across**2], axis=1)
        of_elevation = np.stack([x * y / across, -across, z * y / across], axis=1)
        jacobian = np.stack([of_azimuth, of_elevation], axis=1)
        cov = jacobian @ covariances @ jacobian.transpose(0, 2, 1)
        sigma = np.sqrt(np.maximum(np.einsum("nii->ni", cov), 0.0))
        correlation = cov[:, 0, 1] / (sigma[:, 0] * sigma[:, 1])
    return np.column_stack([np.degrees(sigma), np.nan_to_num(np.clip(correlation, -1.0, 1.0))])


def bearings_deg(camera: Camera, xy_px: Floats) -> Floats:
    """Azimuth and elevation ``(N, 2)`` in deg at which pixels ``(N, 2)`` are seen; NaN where no ray leads there."""
    return azimuth_elevation_deg(rays_from_pixels(camera, xy_px))


def outline_deg(camera: Camera) -> Floats:
    """The picture's border as azimuth and elevation ``(N, 2)`` in deg, going round; what no ray reaches is left out."""
    width, height = camera.image_size.width_px - 1.0, camera.image_size.height_px - 1.0
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height], [0.0, 0.0]])
    steps = np.linspace(0.0, 1.0, OUTLINE_POINTS_PER_SIDE, endpoint=False)[:, None]
    sides = [start + steps * (end - start) for start, end in pairwise(corners)]
    border = bearings_deg(camera, np.concatenate([*sides, corners[:1]]))
    return np.asarray(border[np.isfinite(border).all(axis=1)])
