"""Colours of the annotated picture, blue-green-red, and how they are laid over it."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from ttcvid.model import Ints, Picture

Colour = tuple[int, int, int]

# Okabe and Ito's colours, told apart with any colour vision, without black and without vermilion (too near to the
# red of a warning). https://jfly.uni-koeln.de/color/
OBJECT_COLOURS: tuple[Colour, ...] = (
    (233, 180, 86),  # sky blue
    (66, 228, 240),  # yellow
    (167, 121, 204),  # reddish purple
    (0, 159, 230),  # orange
    (115, 158, 0),  # bluish green
    (178, 114, 0),  # blue
)
SCENE: Colour = (140, 140, 140)
UNASSIGNED: Colour = (95, 95, 95)
WHITE: Colour = (255, 255, 255)
BLACK: Colour = (0, 0, 0)
DARK: Colour = (20, 20, 20)
WARNING: Colour = (30, 30, 215)
CLOSE: Colour = (40, 190, 255)
HORIZON: Colour = (230, 230, 160)
MUTED_INK: Colour = (190, 190, 190)


def object_colour(cluster_id: int) -> Colour:
    """The colour of an object, the same for its whole life."""
    return OBJECT_COLOURS[(cluster_id - 1) % len(OBJECT_COLOURS)]


def object_colours(cluster_id: Ints) -> Picture:
    """The colours ``(N, 3)`` of N objects."""
    return np.array(OBJECT_COLOURS, dtype=np.uint8)[(cluster_id - 1) % len(OBJECT_COLOURS)]


def shade(bgr: Picture, box: tuple[int, int, int, int], colour: Colour, opacity: float) -> None:
    """Lay a colour over the part ``x0, y0, x1, y1`` (ends excluded) of a picture."""
    height, width = bgr.shape[:2]
    x0, y0, x1, y1 = max(box[0], 0), max(box[1], 0), min(box[2], width), min(box[3], height)
    if x0 < x1 and y0 < y1:
        part = bgr[y0:y1, x0:x1]
        part[:] = colour if opacity >= 1 else cv2.LUT(np.ascontiguousarray(part), _blend_table(colour, opacity))


@lru_cache(maxsize=32)
def _blend_table(colour: Colour, opacity: float) -> Picture:
    levels = np.arange(256)[None, :, None] * (1 - opacity) + np.array(colour) * opacity
    return np.asarray(np.round(levels), dtype=np.uint8)
