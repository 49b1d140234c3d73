"""Between pixels and rays, through the lens. NaN in gives NaN out."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.camera.distortion import distort, distorted_area, undistort
from ttcvid.model import Camera, Floats

UNDISTORTION_TOLERANCE_PX = 5e-11
"""How near a pixel's ray comes back to the pixel."""


def rays_from_pixels(camera: Camera, xy_px: Floats) -> Floats:
    """Undistorted rays ``(N, 3)`` with z = 1, camera frame, of distorted source pixels ``(N, 2)``.

    NaN where no ray leads to the pixel: outside of what the lens model reaches, and, since z = 1 cannot represent it,
    at 90 deg or more off the axis of a fisheye lens. A lens model that is unknown is an error as in `undistort`.

    >>> from ttcvid.model import ImageSize
    >>> camera = Camera(fx_px=100.0, fy_px=50.0, cx_px=10.0, cy_px=20.0, image_size=ImageSize(640, 480))
    >>> rays_from_pixels(camera, np.array([[60.0, 20.0], [10.0, 45.0]]))
    array([[0.5, 0. , 1. ],
           [0. , 0.5, 1. ]])
    """
    xy_distorted = (np.asarray(xy_px, dtype=np.float64) - (camera.cx_px, camera.cy_px)) / (camera.fx_px, camera.fy_px)
    tolerance = UNDISTORTION_TOLERANCE_PX / max(camera.fx_px, camera.fy_px)
    rays = np.ones((len(xy_distorted), 3))
    rays[:, :2] = undistort(camera.distortion_model, camera.distortion, xy_distorted, tolerance)
    rays[~np.isfinite(rays[:, 0] + rays[:, 1])] = np.nan
    return rays


def plane_per_px(camera: Camera, rays: Floats) -> Floats:
    """Length ``(N,)`` in the plane z = 1 that a pixel spans at each of ``rays (N, 3)``: the square root of its area.

    Without distortion that is one over the focal length; a fisheye lens packs more into a pixel the farther off the
    axis. Where a ray has none (NaN, z <= 0, where the lens model folds over) it is the value at the axis.

    >>> from ttcvid.model import ImageSize
    >>> camera = Camera(100.0, 100.0, 320.0, 240.0, ImageSize(640, 480), "fisheye", (0.0, 0.0, 0.0, 0.0))
    >>> plane_per_px(camera, np.array([[0.0, 0.0, 1.0], [np.sqrt(3.0), 0.0, 1.0]])).round(4)
    array([0.01  , 0.0257])
    """
    per_px = np.full(len(rays), 1.0 / np.sqrt(camera.fx_px * camera.fy_px))
    with np.errstate(all="ignore"):
        xy = rays[:, :2] / np.where(rays[:, 2] > 0.0, rays[:, 2], np.nan)[:, None]
        area = distorted_area(camera.distortion_model, camera.distortion, xy)
    known = area > 0.0
    per_px[known] /= np.sqrt(area[known])
    return per_px


def pixels_from_rays(camera: Camera, rays: Floats) -> Floats:
    """Distorted source pixels ``(N, 2)`` of rays or points ``(N, 3)`` in the camera frame.

    NaN for z <= 0 (behind the camera or in its picture plane) and where the lens model folds over. A lens model that
    is unknown is an error as in `distort`.

    >>> from ttcvid.model import ImageSize
    >>> camera = Camera(fx_px=100.0, fy_px=50.0, cx_px=10.0, cy_px=20.0, image_size=ImageSize(640, 480))
    >>> pixels_from_rays(camera, np.array([[1.0, 0.0, 2.0], [1.0, 0.0, -2.0]]))
    array([[60., 20.],
           [nan, nan]])
    """
    rays = np.asarray(rays, dtype=np.float64)
    z = rays[:, 2]
    with np.errstate(all="ignore"):
        xy = rays[:, :2] / np.where(z > 0.0, z, np.nan)[:, None]
    xy_distorted = distort(camera.distortion_model, camera.distortion, xy)
    xy_px: Floats = xy_distorted * (camera.fx_px, camera.fy_px) + (camera.cx_px, camera.cy_px)
    xy_px[~np.isfinite(xy_px[:, 0] + xy_px[:, 1])] = np.nan
    return xy_px
