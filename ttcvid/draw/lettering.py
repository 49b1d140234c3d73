"""Text in pictures, from letters that are drawn once and then copied: ten times faster than drawing each text."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ttcvid.draw.palette import Colour
from ttcvid.model import ImageSize, Picture

_FONT = cv2.FONT_HERSHEY_DUPLEX
_CAP_HEIGHT_AT_SCALE_1 = 21  # px, height of capitals in OpenCV's Hershey fonts
_OVERSAMPLING = 4
_STROKE_PER_CAP = 0.15  # bold enough to be read on a small screen
_DESCENDER_PER_CAP = 0.35
_ADVANCE = 0.92  # the font's own spacing is meant for plotters
_SPACE_ADVANCE = 0.6
_PRINTABLE = "".join(chr(code) for code in range(32, 127))

# Height of capitals. A wide picture is shrunk to the width of a phone, so its letters follow the width too.
_CAP_PER_HEIGHT = 0.035
_CAP_PER_WIDTH = 0.0135
_MAX_CAP_PER_WIDTH = 0.042
_MIN_CAP_PX = 7


def cap_height_px(size: ImageSize) -> int:
    """Height of capital letters that can be read when the picture fills a phone's screen."""
    wanted = max(_CAP_PER_HEIGHT * size.height_px, _CAP_PER_WIDTH * size.width_px)
    return max(_MIN_CAP_PX, round(min(wanted, _MAX_CAP_PER_WIDTH * size.width_px)))


class Lettering:
    """ASCII letters of one size; other characters come out as ``?``."""

    def __init__(self, cap_px: int) -> None:
        self.cap_px = cap_px
        self.line_px = round(cap_px * 1.75)
        # All three channels are spelled out, because numpy is slow in loops of three.
        self._covers = {letter: np.repeat(_glyph(letter, cap_px)[..., None], 3, axis=2) for letter in _PRINTABLE}
        # What stays from picture to picture (numbers, words, notes) is put together once.
        self._layers_of = lru_cache(maxsize=256)(self._layers)
        self._widths_px = {letter: cover.shape[1] for letter, cover in self._covers.items()}

    def width_px(self, text: str) -> int:
        """Width of a text."""
        unknown_px = self._widths_px["?"]
        return sum(self._widths_px.get(letter, unknown_px) for letter in text)

    def draw(self, bgr: Picture, text: str, x: int, y: int, ink: Colour) -> None:
        """Write ``text`` with the upper left corner of its capitals at (x, y); what lies outside is cut off."""
        kept, added = self._layers_of(text, ink)
        height, width = bgr.shape[:2]
        x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + kept.shape[1], width), min(y + kept.shape[0], height)
        if x0 < x1 and y0 < y1:
            within = slice(y0 - y, y1 - y), slice(x0 - x, x1 - x)
            part = bgr[y0:y1, x0:x1]
            part[:] = (part * kept[within] + added[within]) >> 8

    def _layers(self, text: str, ink: Colour) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
        """What a text leaves of the picture and what it adds, both ``(height, width, 3)``, times 255."""
        unknown = self._covers["?"]
        covers = [self._covers.get(letter, unknown) for letter in text]
        cover = np.concatenate([unknown[:, :0], *covers], axis=1, dtype=np.uint16)
        return 255 - cover, cover * np.array(ink, dtype=np.uint16)


def _glyph(letter: str, cap_px: int) -> Picture:
    """How much of each pixel a letter covers, 0 to 255; the baseline lies ``cap_px`` below the top."""
    scale = cap_px * _OVERSAMPLING / _CAP_HEIGHT_AT_SCALE_1
    stroke = max(1, round(cap_px * _OVERSAMPLING * _STROKE_PER_CAP))
    (advance, _), _ = cv2.getTextSize(letter, _FONT, scale, 1)
    height = cap_px + round(cap_px * _DESCENDER_PER_CAP)
    width = max(1, round(advance / _OVERSAMPLING * (_SPACE_ADVANCE if letter == " " else _ADVANCE)))
    large = np.zeros((height * _OVERSAMPLING, width * _OVERSAMPLING), dtype=np.uint8)
    baseline = (0, cap_px * _OVERSAMPLING - stroke // 2)
    cv2.putText(large, letter, baseline, _FONT, scale * (1 - _STROKE_PER_CAP), 255, stroke, cv2.LINE_AA)
    return np.asarray(cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
