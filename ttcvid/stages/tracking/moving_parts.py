"""What moves before a camera at rest, cut out of its pictures, so that a tracker follows it alone.

A Lucas-Kanade window that holds both a mover and the street behind it follows a mixture of the two; and all windows
that hold the same piece of a mover follow that piece, wherever they stand: they then seem not to come apart as the
mover comes nearer. So the street is painted over, and each track is put where the content of its window lies
(`stages.tracking.content`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ttcvid.model import Picture

# Differences from the background below this are sensor noise or compression, grey levels; and so many times the usual.
_LEAST_CONTRAST, _CONTRAST_SIGMAS = 5.0, 5.0
_SIGMA_PER_MEDIAN = 1.4826
# Every so many pixels of each axis are enough to know the usual difference.
_SAMPLED_PX = 4
# Smoothing before pictures are compared: for what moves at all, and for where exactly it ends.
_SMOOTH_PX, _SHARP_PX = 1.0, 0.7
# Gaps in a mover are closed up to this width, px; what is narrower than the other is noise.
_CLOSED_PX, _OPENED_PX = 5, 3
# Within this distance of its border a mover ends where its contrast has fallen to this part of the largest near it.
_BORDER_PX, _BORDER_CONTRAST = 7, 0.5
# The cut-out fades into the plain colour over this, px.
_FADE_PX = 0.8
# The median of the background is taken over so many rows at a time, to keep memory small.
_ROWS_AT_ONCE = 64


@dataclass(frozen=True)
class Background:
    """The street without its traffic: ``smooth, sharp (H, W)`` float32, smoothed more and less.

    ``contrast`` is how much a pixel has to differ from it to be something else; ``plain`` a grey level to paint it over
    with.
    """

    smooth: NDArray[np.float32]
    sharp: NDArray[np.float32]
    contrast: float
    plain: int


def background_of(pictures: Sequence[Picture]) -> Background:
    """The median of pictures ``(H, W)`` uint8 spread over a clip: what is seen at a place most of the time."""
    rows = range(0, pictures[0].shape[0], _ROWS_AT_ONCE)
    strips = [np.median([p[row : row + _ROWS_AT_ONCE] for p in pictures], axis=0).astype(np.float32) for row in rows]
    street = np.concatenate(strips)
    smooth, sharp = _smoothed(street, _SMOOTH_PX), _smoothed(street, _SHARP_PX)
    sampled = [_smoothed(picture, _SMOOTH_PX) - smooth for picture in pictures]
    usual = float(np.median([np.abs(d[::_SAMPLED_PX, ::_SAMPLED_PX]) for d in sampled]))
    contrast = max(_LEAST_CONTRAST, _CONTRAST_SIGMAS * _SIGMA_PER_MEDIAN * usual)
    return Background(smooth, sharp, contrast, int(np.median(street)))


def only_moving(grey: Picture, background: Background) -> Picture:
    """The picture ``(H, W)`` uint8 with everything that looks like the background painted over.

    A smoothed difference reaches beyond the border of a mover by about a pixel, always the same, however near the mover
    comes; therefore the border is put where the contrast has fallen to a half.
    """
    differs = np.abs(_smoothed(grey, _SMOOTH_PX) - background.smooth) > background.contrast
    whole = cv2.morphologyEx(differs.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((_CLOSED_PX, _CLOSED_PX), np.uint8))
    square = np.ones((_BORDER_PX, _BORDER_PX), np.uint8)
    contrast = np.abs(_smoothed(grey, _SHARP_PX) - background.sharp)
    is_inner = cv2.erode(whole, square) > 0
    part = (whole > 0) & (is_inner | (contrast > _BORDER_CONTRAST * cv2.dilate(contrast, square)))
    part = cv2.morphologyEx(part.astype(np.uint8), cv2.MORPH_OPEN, np.ones((_OPENED_PX, _OPENED_PX), np.uint8))
    part = cv2.morphologyEx(part, cv2.MORPH_CLOSE, np.ones((_CLOSED_PX, _CLOSED_PX), np.uint8))
    share = _smoothed(part, _FADE_PX)
    return np.asarray(share * grey + (1.0 - share) * background.plain, dtype=np.uint8)


def _smoothed(picture: NDArray[np.generic], sigma_px: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(picture.astype(np.float32), (0, 0), sigma_px), dtype=np.float32)
