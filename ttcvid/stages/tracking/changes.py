"""Where the picture of a camera at rest changes: there something moves, whatever its texture."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ttcvid.model import Picture

# Differences below this are sensor noise or compression, grey levels; and so many times the usual one.
_LEAST_CONTRAST, _CONTRAST_SIGMAS, _SIGMA_PER_MEDIAN = 5.0, 5.0, 1.4826
SAMPLED_PX = 4
"""Every so many pixels of each axis are enough to know the usual difference, or the look of a picture."""
SMOOTH_PX = 1.0
"""Pictures are smoothed by this before they are compared."""
OPENED_PX = 3
"""What is narrower than this is noise, or the tremble of an edge."""


def changed_places(before: Picture, now: Picture) -> Picture | None:
    """Where two pictures (H, W) uint8 differ: uint8, 255 there, else 0; None where most of the picture does.

    There the light has changed, or the camera moves after all.
    """
    difference = np.abs(smoothed(before, SMOOTH_PX) - smoothed(now, SMOOTH_PX))
    contrast = least_contrast(difference[::SAMPLED_PX, ::SAMPLED_PX])
    if contrast > _CONTRAST_SIGMAS * _LEAST_CONTRAST:
        return None
    return 255 * cleaned(difference > contrast, cv2.MORPH_OPEN, OPENED_PX)


def cleaned(mask: NDArray[np.generic], operation: int, side_px: int) -> Picture:
    """A mask, uint8, after one of OpenCV's morphological operations with a square."""
    square = np.ones((side_px, side_px), np.uint8)
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), operation, square), dtype=np.uint8)


def least_contrast(difference: NDArray[np.float32]) -> float:
    """Absolute differences above this are more than noise: most of the picture rests."""
    return max(_LEAST_CONTRAST, _CONTRAST_SIGMAS * _SIGMA_PER_MEDIAN * float(np.median(difference)))


def smoothed(picture: NDArray[np.generic], sigma_px: float) -> NDArray[np.float32]:
    """A picture ``(H, W)``, less sharp by a Gaussian of this standard deviation."""
    return np.asarray(cv2.GaussianBlur(picture.astype(np.float32), (0, 0), sigma_px), dtype=np.float32)
