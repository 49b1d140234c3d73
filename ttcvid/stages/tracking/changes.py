"""Where the picture of a camera at rest changes: there something moves, whatever its texture."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ttcvid.model import Picture

# Differences below this are sensor noise or compression, grey levels; and so many times the usual one.
_LEAST_CONTRAST, _CONTRAST_SIGMAS, _SIGMA_PER_MEDIAN = 5.0, 5.0, 1.4826
SAMPLED_PX = 4
"""Every so many pixels of each axis are enough to know the usual difference."""
SMOOTH_PX = 1.0
"""Pictures are smoothed by this before they are compared."""
# What is narrower than this is the tremble of an edge, px.
_OPENED_PX = 3


def changed_places(before: Picture, now: Picture) -> Picture | None:
    """Where two pictures (H, W) uint8 differ: uint8, 255 there, else 0; None where most of the picture does.

    There the light has changed, or the camera moves after all.
    """
    difference = np.abs(smoothed(before, SMOOTH_PX) - smoothed(now, SMOOTH_PX))
    contrast = least_contrast(difference[::SAMPLED_PX, ::SAMPLED_PX])
    if contrast > _CONTRAST_SIGMAS * _LEAST_CONTRAST:
        return None
    differs = (difference > contrast).astype(np.uint8)
    opened = cv2.morphologyEx(differs, cv2.MORPH_OPEN, np.ones((_OPENED_PX, _OPENED_PX), np.uint8))
    return np.asarray(255 * opened, dtype=np.uint8)


def least_contrast(difference: NDArray[np.float32]) -> float:
    """Absolute differences above this are more than noise: most of the picture rests."""
    return max(_LEAST_CONTRAST, _CONTRAST_SIGMAS * _SIGMA_PER_MEDIAN * float(np.median(difference)))


def smoothed(picture: NDArray[np.generic], sigma_px: float) -> NDArray[np.float32]:
    """A picture ``(H, W)``, less sharp by a Gaussian of this standard deviation."""
    return np.asarray(cv2.GaussianBlur(picture.astype(np.float32), (0, 0), sigma_px), dtype=np.float32)
