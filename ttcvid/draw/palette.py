"""Colours of the annotated picture, blue-green-red, and how they are laid over it."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable, Mapping
from functools import lru_cache

import cv2
import numpy as np

from ttcvid.model import SCENE_CLUSTER, Ints, Picture

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


# Golden ratio: hues at its multiples never come back to one another.
_HUE_STEP = 0.618034
# Hues of further colours stay clear of the red of a warning.
_HUES = (0.08, 0.92)
_SATURATIONS = (0.35, 0.65)


class ObjectColours:
    """Colours of objects: no two in view share one, and each keeps its own while it is seen.

    An object has the colour of its number, unless another in view has it: then that which was used longest ago. Where
    there are more objects than `OBJECT_COLOURS`, further colours are made.
    """

    def __init__(self) -> None:
        self._place_of: dict[int, int] = {}
        self._seen_last: dict[int, int] = {}
        self._used_last: dict[int, int] = {}
        self._n_frames = 0

    def follow(self, cluster_ids: Iterable[int]) -> dict[int, Colour]:
        """The colours of the objects that are in view in the next frame, by ``cluster_id``."""
        self._n_frames += 1
        # Whoever was in view last keeps its colour first.
        in_view = sorted(set(cluster_ids), key=lambda one: (-self._seen_last.get(one, 0), one))
        taken: dict[int, int] = {}
        for cluster_id in in_view:
            place = self._place_of.get(cluster_id, (cluster_id - 1) % len(OBJECT_COLOURS))
            taken[self._free_place(place, taken)] = cluster_id
        for place, cluster_id in taken.items():
            self._place_of[cluster_id] = place
            self._seen_last[cluster_id] = self._used_last[place] = self._n_frames
        return {cluster_id: _colour_at(place) for place, cluster_id in taken.items()}

    def _free_place(self, wanted: int, taken: Mapping[int, int]) -> int:
        if wanted not in taken:
            return wanted
        free = [place for place in range(len(OBJECT_COLOURS)) if place not in taken]
        if free:
            return min(free, key=lambda place: (self._used_last.get(place, 0), place))
        return next(place for place in range(len(taken) + 1) if place not in taken)


def colours_of_clip(in_view: Iterable[Iterable[int]]) -> dict[int, Colour]:
    """The colour in which each object is first seen, by ``cluster_id``; ``in_view`` are those in view, frame by frame.

    Who is seen again later may have another colour in the video then.
    """
    colours = ObjectColours()
    first: dict[int, Colour] = {}
    for numbers in in_view:
        first = colours.follow(numbers) | first
    return dict(sorted(first.items()))


def _colour_at(place: int) -> Colour:
    """The colours of `OBJECT_COLOURS`, and after them others without end."""
    if place < len(OBJECT_COLOURS):
        return OBJECT_COLOURS[place]
    hue = _HUES[0] + (_HUES[1] - _HUES[0]) * (place * _HUE_STEP % 1.0)
    red, green, blue = colorsys.hsv_to_rgb(hue, _SATURATIONS[place % len(_SATURATIONS)], 1.0)
    return round(255 * blue), round(255 * green), round(255 * red)


def colours_of_tracks(cluster_id: Ints, colours: Mapping[int, Colour]) -> Picture:
    """The colours ``(N, 3)`` of N tracks: those of their objects, and grey for the scene and for what has none."""
    table = {**colours, SCENE_CLUSTER: SCENE}
    numbers, place = np.unique(cluster_id, return_inverse=True)
    ink = np.array([table.get(number, UNASSIGNED) for number in numbers.tolist()], dtype=np.uint8).reshape(-1, 3)
    return ink[place]


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
