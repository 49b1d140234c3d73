"""Cuts what moves before a resting camera out of its pictures, so that a tracker follows it alone.

A Lucas-Kanade window with both a mover and the street behind follows a mixture of the two; and all windows that hold
the same piece of a mover follow that piece, wherever they stand: they do not diverge as the mover approaches. So the
street is masked, and each track is placed where the content of its window lies (`stages.tracking.content`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ttcvid.model import Picture
from ttcvid.stages.tracking.changes import OPENED_PX, SAMPLED_PX, SMOOTH_PX, cleaned, least_contrast, smoothed

# Smoothing before pictures are compared for where exactly a mover ends.
_SHARP_PX = 0.7
# What an outline encloses is closed up to this part of the picture's width: the inside of a plain coat.
_ENCLOSED_PART = 0.04
# Places darker than this, grey levels, tell nothing of the brightness of a picture.
_DARK = 20.0
# Gaps in a mover are closed up to this width, px.
_CLOSED_PX = 5
# Within this distance of its border a mover ends where its contrast has fallen to this part of the largest near it.
_BORDER_PX, _BORDER_CONTRAST = 7, 0.5
# The cut-out fades into the plain colour over this, px.
_FADE_PX = 0.8
# The median of the background is taken over so many rows at a time, to keep memory small.
_ROWS_AT_ONCE = 64


@dataclass(frozen=True)
class StreetSample:
    """A ``picture (H, W)`` uint8 and where something ``moves`` in it, (H / 2, W / 2) uint8, not 0 where it does."""

    picture: Picture
    moves: Picture


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


def street_sample(before: Picture, now: Picture, after: Picture) -> StreetSample:
    """A picture ``(H, W)`` uint8 with what moves between it and those some tenths of a second before and after it.

    The inside of a plain coat does not change as it passes, so that what its outline encloses counts as well.
    """
    middle = _halved(now)
    small = [picture / _brightness(picture, middle) for picture in (_halved(before), middle, _halved(after))]
    change = np.maximum(np.abs(small[0] - small[1]), np.abs(small[2] - small[1]))
    opened = cleaned(change > least_contrast(change), cv2.MORPH_OPEN, OPENED_PX)
    moves = cleaned(opened, cv2.MORPH_CLOSE, 2 * max(1, round(0.5 * _ENCLOSED_PART * middle.shape[1])) + 1)
    return StreetSample(now, cleaned(moves, cv2.MORPH_DILATE, _CLOSED_PX))


def background_of(samples: Sequence[StreetSample]) -> Background:
    """The median of the pictures spread over a clip, of each place where nothing moved there, all in one brightness.

    Without a look at what moves, a place where people pass more than half of the time would look like their coats. A
    place where something always moves is taken as it looks most of the time.
    """
    first = _median([sample.picture for sample in samples], None)
    pictures = [
        np.clip(np.rint(one.picture / np.float32(_brightness(one.picture, first))), 0, 255).astype(np.uint8)
        for one in samples
    ]
    moves = [sample.moves for sample in samples]
    street = _median(pictures, moves)
    smooth, sharp = smoothed(street, SMOOTH_PX), smoothed(street, _SHARP_PX)
    sampled = [smoothed(picture, SMOOTH_PX)[::SAMPLED_PX, ::SAMPLED_PX] for picture in pictures]
    differences = np.abs(np.array(sampled) - smooth[::SAMPLED_PX, ::SAMPLED_PX])
    return Background(smooth, sharp, least_contrast(differences), int(np.median(street)))


def _halved(picture: NDArray[np.generic]) -> NDArray[np.float32]:
    """Half as wide and high, each pixel the mean of four: (ceil(H / 2), ceil(W / 2))."""
    size = (-(-picture.shape[1] // 2), -(-picture.shape[0] // 2))
    return np.asarray(cv2.resize(picture.astype(np.float32), size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _median(pictures: Sequence[NDArray[np.generic]], moves: Sequence[Picture] | None) -> NDArray[np.float32]:
    """Median of pictures ``(H, W)`` at each place, without those in which something moves there."""
    height, width = pictures[0].shape
    strips = []
    for row in range(0, height, _ROWS_AT_ONCE):
        values = np.array([picture[row : row + _ROWS_AT_ONCE] for picture in pictures], dtype=np.float32)
        if moves is not None:
            in_row = (np.arange(row, row + values.shape[1]) * moves[0].shape[0]) // height
            in_column = (np.arange(width) * moves[0].shape[1]) // width
            moving = np.array([mask[np.ix_(in_row, in_column)] for mask in moves]) > 0
            values[moving & ~moving.all(axis=0)] = np.inf
        values.sort(axis=0)
        count = np.isfinite(values).sum(axis=0)
        middle = [np.take_along_axis(values, place[None], axis=0)[0] for place in ((count - 1) // 2, count // 2)]
        strips.append(0.5 * (middle[0] + middle[1]))
    return np.concatenate(strips)


def _brightness(picture: Picture | NDArray[np.float32], street: NDArray[np.float32]) -> float:
    """How much brighter a picture is than the street in most places: an exposure that follows the traffic."""
    sampled = street[::SAMPLED_PX, ::SAMPLED_PX]
    is_bright = sampled > _DARK
    if not is_bright.any():
        return 1.0
    return float(np.median(picture[::SAMPLED_PX, ::SAMPLED_PX][is_bright] / sampled[is_bright]))


def moving_part(grey: Picture, background: Background) -> tuple[Picture, Picture]:
    """What moves in a picture ``(H, W)`` uint8: its mask (H, W) of 0 and 1, and the picture with all else painted over.

    A smoothed difference reaches beyond the border of a mover by about a pixel, always the same, however near the mover
    comes; therefore the border is put where the contrast has fallen to a half.
    """
    factor = _brightness(grey, background.sharp)
    level = grey.astype(np.float32) / factor
    # Bright lamps follow an exposure in part only: anything between the two is the background.
    low, high = background.smooth * min(1.0, 1.0 / factor), background.smooth * max(1.0, 1.0 / factor)
    smooth = smoothed(level, SMOOTH_PX)
    whole = cleaned(np.maximum(low - smooth, smooth - high) > background.contrast, cv2.MORPH_CLOSE, _CLOSED_PX)
    contrast = np.abs(smoothed(level, _SHARP_PX) - background.sharp)
    highest = cv2.dilate(contrast, np.ones((_BORDER_PX, _BORDER_PX), np.uint8))
    is_inner = cleaned(whole, cv2.MORPH_ERODE, _BORDER_PX) > 0
    rough = (whole > 0) & (is_inner | (contrast > _BORDER_CONTRAST * highest))
    part = cleaned(cleaned(rough, cv2.MORPH_OPEN, OPENED_PX), cv2.MORPH_CLOSE, _CLOSED_PX)
    share = smoothed(part, _FADE_PX)
    cut_out = np.clip(share * level + (1.0 - share) * background.plain, 0, 255).astype(np.uint8)
    return cleaned(whole, cv2.MORPH_OPEN, OPENED_PX), cut_out
