"""Where the picture of a camera at rest changes: there something moves, whatever its texture."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ttcvid.model import Picture

# Differences below this are sensor noise or compression, grey levels; and so many times the usual one.
_LEAST_CONTRAST, _CONTRAST_SIGMAS, _SIGMA_PER_MEDIAN = 5.0, 5.0, 1.4826
# Every so many pixels of each axis are enough to know the usual difference.
_SAMPLED_PX = 4
# Pictures are smoothed by this before they are compared; what is narrower than this many pixels is the tremble of an
# edge.
_SMOOTH_PX, _OPENED_PX = 1.0, 3


def changed_places(before: Picture, now: Picture) -> Picture | None:
    """Where two pictures (H, W) uint8 differ: uint8, 255 there, else 0; None where most of the picture does.

    There the light has changed, or the camera moves after all.
    """
    difference = cv2.absdiff(_smoothed(before), _smoothed(now))
    usual = _SIGMA_PER_MEDIAN * float(np.median(difference[::_SAMPLED_PX, ::_SAMPLED_PX]))
    if usual > _LEAST_CONTRAST:
        return None
    differs = (difference > max(_LEAST_CONTRAST, _CONTRAST_SIGMAS * usual)).astype(np.uint8)
    opened = cv2.morphologyEx(differs, cv2.MORPH_OPEN, np.ones((_OPENED_PX, _OPENED_PX), np.uint8))
    return np.asarray(255 * opened, dtype=np.uint8)


def _smoothed(grey: Picture) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTH_PX), dtype=np.float32)
