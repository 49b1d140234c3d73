"""Boxes around objects: where they lie, and how they are drawn."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from ttcvid.draw.palette import BLACK, WARNING, Colour
from ttcvid.draw.wording import Urgency
from ttcvid.model import ClusterRow, Floats, Picture

Box = tuple[int, int, int, int]

_FAR_PX = 30_000.0  # within what OpenCV can draw
# At a side of a box, one track in ten may be a stray: beyond a gap of this share of the extent of the rest.
_STRAY_SHARE = 0.1
_STRAY_GAP = 0.15
_DASH_PER_STROKE = 5


def box_in_pixels(cluster: ClusterRow, xy_px: Floats) -> Box:
    """The box of an object in whole pixels, without the strays among its tracks ``(N, 2)``.

    A track that has slid off onto the road would draw the box beside the car. Without tracks it is the row's own box.
    """
    x0, y0, x1, y1 = cluster.box_px
    if len(xy_px) and np.isfinite(xy_px).all():
        (x0, x1), (y0, y1) = _without_strays(xy_px[:, 0]), _without_strays(xy_px[:, 1])
    return _whole(x0), _whole(y0), _whole(x1), _whole(y1)


def draw_box(bgr: Picture, box: Box, colour: Colour, urgency: Urgency, stroke_px: int) -> None:
    """A box in its object's colour: in a red frame where it is warned of, thin where its approach is open."""
    x0, y0, x1, y1 = box
    if urgency is Urgency.untold:
        stroke_px = max(1, stroke_px // 2)
    elif urgency is Urgency.warned:
        cv2.rectangle(bgr, (x0 - stroke_px, y0 - stroke_px), (x1 + stroke_px, y1 + stroke_px), WARNING, 2 * stroke_px)
    else:
        cv2.rectangle(bgr, (x0, y0), (x1, y1), BLACK, stroke_px + 2)
    cv2.rectangle(bgr, (x0, y0), (x1, y1), colour, stroke_px)


def draw_dashed_box(bgr: Picture, box: Box, stroke_px: int) -> None:
    """Around the place where something that is warned of was last seen."""
    margin_px = 3 * stroke_px
    x0, y0, x1, y1 = box[0] - margin_px, box[1] - margin_px, box[2] + margin_px, box[3] + margin_px
    dash_px = _DASH_PER_STROKE * stroke_px
    corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    for start, end in zip(corners, (*corners[1:], corners[0]), strict=True):
        for tail, head in _dashes(start, end, dash_px):
            cv2.line(bgr, tail, head, WARNING, 2 * stroke_px)


def _without_strays(values: Floats) -> tuple[float, float]:
    """The smallest and largest of N values, but for strays."""
    ordered = np.sort(values)
    n_strays = int(_STRAY_SHARE * len(ordered))
    n_low, n_high = _n_before_gap(ordered, n_strays), _n_before_gap(-ordered[::-1], n_strays)
    return float(ordered[n_low]), float(ordered[-1 - n_high])


def _n_before_gap(ordered: Floats, n_most: int) -> int:
    """How many of the first values, at most ``n_most``, lie before a gap that is wide against what comes after it."""
    after = ordered[1 : n_most + 1]
    is_gap = after - ordered[:n_most] > _STRAY_GAP * (ordered[-1] - after)
    return int(np.flatnonzero(is_gap)[-1]) + 1 if is_gap.any() else 0


def _dashes(start: tuple[int, int], end: tuple[int, int], dash_px: int) -> Iterator[tuple[tuple[int, int], ...]]:
    """Dashes from a corner to the next, with gaps as long."""
    length = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    n = max(1, min(length // (2 * dash_px), 500))
    places = np.linspace(start, end, 2 * n).round().astype(int).tolist()
    yield from ((tuple(tail), tuple(head)) for tail, head in zip(places[::2], places[1::2], strict=True))


def _whole(value: float) -> int:
    return round(min(max(value, -_FAR_PX), _FAR_PX))
