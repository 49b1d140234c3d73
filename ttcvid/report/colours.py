"""The colours of objects in plots: those of the annotated video, dark enough for white paper."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable

from ttcvid.draw.palette import Colour, colours_of_clip

LEAST_CONTRAST = 3.0
"""Lines and marks against white, as the Web Content Accessibility Guidelines (1.4.11) want them."""


def colours_of_objects(in_view: Iterable[Iterable[int]]) -> dict[int, dict[str, str]]:
    """Colours of objects by number, on a ``light`` and on a ``dark`` ground, as ``#rrggbb``.

    ``in_view`` are the numbers that are seen, frame by frame.

    >>> colours_of_objects([[1]])
    {1: {'light': '#229de2', 'dark': '#56b4e9'}}
    """
    return {number: _on_both_grounds(colour) for number, colour in colours_of_clip(in_view).items()}


def _on_both_grounds(colour: Colour) -> dict[str, str]:
    blue, green, red = (part / 255 for part in colour)
    hue, lightness, saturation = colorsys.rgb_to_hls(red, green, blue)
    on_white = (red, green, blue)
    while _contrast_with_white(on_white) < LEAST_CONTRAST:
        lightness *= 0.98
        on_white = colorsys.hls_to_rgb(hue, lightness, saturation)
    return {"light": _hex(on_white), "dark": _hex((red, green, blue))}


def _contrast_with_white(rgb: tuple[float, float, float]) -> float:
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in rgb]
    return 1.05 / (0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2] + 0.05)


def _hex(rgb: tuple[float, float, float]) -> str:
    return "#" + "".join(f"{round(part * 255):02x}" for part in rgb)
