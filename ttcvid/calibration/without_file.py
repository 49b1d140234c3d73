"""Cameras that nobody calibrated: from a focal length, a field of view, what the clip tells, or neither."""

from __future__ import annotations

import math
from dataclasses import replace

from ttcvid.calibration.intrinsics import MAX_FOCAL_WIDTHS, MIN_FOCAL_WIDTHS
from ttcvid.errors import UsageError
from ttcvid.model import Camera, ImageSize

ASSUMED_HFOV_DEG = 55.0
"""Horizontal field of view where nothing is known: between a telephone and a dashboard camera."""
MIN_HFOV_DEG, MAX_HFOV_DEG = 1.0, 179.0


def camera_from_focal(focal_px: float, image_size: ImageSize, origin: str = "focal_px") -> Camera:
    """Camera with square pixels, no distortion and its principal point at the centre of the picture.

    Raises
    ------
    UsageError
        The focal length is not between 0.04 and 60 picture widths (171 and 1 deg of view).
    """
    low, high = MIN_FOCAL_WIDTHS * image_size.width_px, MAX_FOCAL_WIDTHS * image_size.width_px
    if not low < focal_px < high:
        raise UsageError(
            f"{origin}: got {focal_px}; expected a focal length from {low:.4g} to {high:.4g} px for pictures "
            f"{image_size.width_px} px wide: give it in px, not in mm"
        )
    return _centred(float(focal_px), image_size, origin)


def camera_from_hfov(hfov_deg: float, image_size: ImageSize, origin: str = "hfov_deg") -> Camera:
    """Camera that sees ``hfov_deg`` from the left to the right border, else as `camera_from_focal`.

    Raises
    ------
    UsageError
        The field of view is not between 1 and 179 deg.
    """
    if not MIN_HFOV_DEG < hfov_deg < MAX_HFOV_DEG:
        raise UsageError(
            f"{origin}: got {hfov_deg}; expected a horizontal field of view between {MIN_HFOV_DEG:g} and "
            f"{MAX_HFOV_DEG:g} deg: correct it"
        )
    focal_px = 0.5 * image_size.width_px / math.tan(math.radians(hfov_deg) / 2.0)
    return _centred(focal_px, image_size, origin)


def assumed_camera(image_size: ImageSize) -> Camera:
    """The camera where nothing is known of it; ``is_assumed`` is true, and every output has to say so."""
    return camera_from_hfov(ASSUMED_HFOV_DEG, image_size, origin="assumed")


def found_camera(focal_px: float, focal_sigma_px: float, image_size: ImageSize) -> Camera:
    """The camera whose focal length was found in its clip; ``is_found`` is true, and every output has to say so."""
    return replace(_centred(focal_px, image_size, "found"), focal_sigma_px=focal_sigma_px)


def _centred(focal_px: float, image_size: ImageSize, origin: str) -> Camera:
    cx_px, cy_px = (image_size.width_px - 1) / 2, (image_size.height_px - 1) / 2
    return Camera(focal_px, focal_px, cx_px, cy_px, image_size, origin=origin)
