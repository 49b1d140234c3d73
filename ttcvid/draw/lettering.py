"""Text in pictures, from letters that are drawn once and then copied: ten times faster than drawing each text."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ttcvid.draw.palette import Colour
from ttcvid.model import ImageSize, Picture

# A part of DejaVu Sans (Latin letters, signs, arrows); its licence stands beside it.
_FONT = Path(__file__).with_name("fonts") / "DejaVuSansCondensed-Bold.ttf"
_CAP_PER_SIZE = 0.729  # height of the font's capitals
_DESCENDER_PER_CAP = 0.35

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
    """Letters of one size; characters that the font lacks come out as an empty box."""

    def __init__(self, cap_px: int) -> None:
        self.cap_px = cap_px
        self.line_px = round(cap_px * 1.75)
        self._font = ImageFont.truetype(_FONT, cap_px / _CAP_PER_SIZE)
        self._letter = lru_cache(maxsize=512)(self._drawn_letter)
        # What stays from picture to picture (numbers, words, notes) is put together once.
        self._cover_of = lru_cache(maxsize=256)(self._cover)

    def width_px(self, text: str) -> int:
        """Width of a text."""
        return sum(self._letter(letter).shape[1] for letter in text)

    def draw(self, bgr: Picture, text: str, x: int, y: int, ink: Colour) -> None:
        """Write ``text`` with the upper left corner of its capitals at (x, y); what lies outside is cut off."""
        _blend(bgr, self._cover_of(text), x, y, np.array(ink, dtype=np.uint8))

    def _cover(self, text: str) -> Picture:
        """How much of each pixel a text covers, 0 to 255, ``(height, width)``."""
        nothing = self._letter(" ")[:, :0]
        return np.concatenate([nothing, *(self._letter(letter) for letter in text)], axis=1)

    def _drawn_letter(self, letter: str) -> Picture:
        """The cover of one letter, as wide as it advances; the baseline lies ``cap_px`` below the top."""
        height_px = self.cap_px + round(self.cap_px * _DESCENDER_PER_CAP)
        width_px = max(1, round(self._font.getlength(letter)))
        cover = Image.new("L", (width_px, height_px))
        ImageDraw.Draw(cover).text((0, self.cap_px), letter, fill=255, font=self._font, anchor="ls")
        return np.asarray(cover, dtype=np.uint8)


def _blend(bgr: Picture, cover: Picture, x: int, y: int, ink: Picture) -> None:
    """Lays a colour over a picture from (x, y) on, where it is covered, as far as that lies in the picture."""
    share = cover[max(-y, 0) :, max(-x, 0) :, None].astype(np.uint16)
    under = bgr[max(y, 0) :, max(x, 0) :][: share.shape[0], : share.shape[1]]
    share = share[: under.shape[0], : under.shape[1]]
    under[:] = (under * (255 - share) + share * ink) // 255
