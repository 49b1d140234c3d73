"""The horizon as a line in undistorted pixels, and as the plane through the focal point and that line.

The plane's unit normal points UP: its y is negative (the camera's y points down), and ``normal . ray`` is positive for
what lies above the horizon, zero on it, negative below. Where the road is flat it is the road's normal; every direction
of motion along the road is normal to it.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.rotation import cross, normalize
from ttcvid.model import Camera, Floats, Horizon


def normal_from_horizon(camera: Camera, horizon: Horizon) -> Floats:
    """Unit normal ``(3,)`` of the plane through the focal point and the horizon line, pointing up, camera frame.

    The line is in undistorted pixels, so only the camera matrix counts, not the distortion. When the camera turns, the
    normal turns with it: ``cam_R_prev @ normal``.

    >>> from ttcvid.model import ImageSize
    >>> size = ImageSize(641, 481)
    >>> camera = Camera(fx_px=500.0, fy_px=500.0, cx_px=320.0, cy_px=240.0, image_size=size)
    >>> normal_from_horizon(camera, Horizon(240.0, 240.0, size, 0.005, "hand")) + 0.0
    array([ 0., -1.,  0.])
    """
    x = (np.array([0.0, horizon.image_size.width_px - 1.0]) - camera.cx_px) / camera.fx_px
    y = (np.array([horizon.y_left_px, horizon.y_right_px]) - camera.cy_px) / camera.fy_px
    left_ray, right_ray = np.column_stack([x, y, np.ones(2)])
    return normalize(cross(right_ray, left_ray))


def horizon_px(camera: Camera, normal: Floats) -> tuple[float, float]:
    """The horizon line ``normal . ray = 0``, of a normal ``(3,)`` of any length and either sign.

    ``(y_left, y_right)`` in undistorted px, at x = 0 and x = width - 1. NaN where the line has no y there: it is
    vertical in the picture (the camera lies on its side), or at infinity (the camera looks straight up or down).

    >>> from ttcvid.model import ImageSize
    >>> camera = Camera(fx_px=500.0, fy_px=500.0, cx_px=320.0, cy_px=240.0, image_size=ImageSize(641, 481))
    >>> horizon_px(camera, np.array([0.0, -1.0, 0.1]))
    (290.0, 290.0)
    """
    x = (np.array([0.0, camera.image_size.width_px - 1.0]) - camera.cx_px) / camera.fx_px
    with np.errstate(all="ignore"):
        y_px = camera.cy_px - camera.fy_px * (normal[0] * x + normal[2]) / normal[1]
    left, right = np.where(np.isfinite(y_px), y_px, np.nan).tolist()
    return left, right


def pitch_roll_rad(normal: Floats) -> tuple[float, float]:
    """Pitch (positive: looks down) and roll (positive: right side low), of the upward unit normal ``(3,)``.

    >>> pitch_roll_rad(np.array([0.0, -1.0, 0.0]))
    (-0.0, -0.0)
    """
    return float(-np.arcsin(np.clip(normal[2], -1, 1))), float(np.arctan2(-normal[0], -normal[1]))


def normal_by_pitch_roll(pitch_rad: float, roll_rad: float) -> Floats:
    """Derivative ``(3, 2)`` of the upward normal (-sin r cos p, -cos r cos p, -sin p) by pitch p and roll r."""
    sin_p, cos_p, sin_r, cos_r = np.sin(pitch_rad), np.cos(pitch_rad), np.sin(roll_rad), np.cos(roll_rad)
    return np.array([[sin_r * sin_p, -cos_r * cos_p], [cos_r * sin_p, sin_r * cos_p], [-cos_p, 0.0]])
