"""Text in pictures, from letters that are drawn once and then copied: ten times faster than drawing each text."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from ttcvid.draw.palette import Colour
from ttcvid.geometry.compiled import compiled
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
        self._covers = {letter: _glyph(letter, cap_px) for letter in _PRINTABLE}
        # What stays from picture to picture (numbers, words, notes) is put together once.
        self._cover_of = lru_cache(maxsize=256)(self._cover)
        self._widths_px = {letter: cover.shape[1] for letter, cover in self._covers.items()}

    def width_px(self, text: str) -> int:
        """Width of a text."""
        unknown_px = self._widths_px["?"]
        return sum(self._widths_px.get(letter, unknown_px) for letter in text)

    def draw(self, bgr: Picture, text: str, x: int, y: int, ink: Colour) -> None:
        """Write ``text`` with the upper left corner of its capitals at (x, y); what lies outside is cut off."""
        _blend(bgr, self._cover_of(text), x, y, *ink)

    def _cover(self, text: str) -> Picture:
        """How much of each pixel a text covers, ``(height, width)``."""
        unknown = self._covers["?"]
        return np.concatenate([unknown[:, :0], *(self._covers.get(letter, unknown) for letter in text)], axis=1)


@compiled
def _blend(bgr: Picture, cover: Picture, x: int, y: int, blue: int, green: int, red: int) -> None:
    """Lays a colour over a picture from (x, y) on, where it is covered, as far as that lies in the picture."""
    height, width = bgr.shape[:2]
    for row in range(max(-y, 0), min(cover.shape[0], height - y)):
        for column in range(max(-x, 0), min(cover.shape[1], width - x)):
            share = int(cover[row, column])
            if share:
                u, v = x + column, y + row
                bgr[v, u, 0] = (bgr[v, u, 0] * (255 - share) + share * blue) // 255
                bgr[v, u, 1] = (bgr[v, u, 1] * (255 - share) + share * green) // 255
                bgr[v, u, 2] = (bgr[v, u, 2] * (255 - share) + share * red) // 255


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
