"""Everything written into the picture: labels of boxes, legend, clock, notes, banner."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ttcvid.draw.lettering import Lettering
from ttcvid.draw.palette import CLOSE, DARK, MUTED_INK, WARNING, WHITE, Colour, object_colour, shade
from ttcvid.draw.signs import draw_top_view
from ttcvid.draw.wording import BACKINGS, INKS, Urgency, banner_text, interval_text, time_text, urgency_of
from ttcvid.model import Camera, ClusterRow, FrameResult, FrameStatus, Picture

Box = tuple[int, int, int, int]

MAX_LEGEND_ROWS = 6
MAX_LABELS = 8
_FAR_PX = 30_000.0
_LEGEND_SHARE = 0.4  # of the picture's height
_PANEL_OPACITY = 0.62
_BANNER_OPACITY = 0.85
_LEGEND_INKS: dict[Urgency, Colour] = {Urgency.calm: WHITE, Urgency.close: CLOSE, Urgency.warned: (110, 110, 255)}


class Panels:
    """Writes with one size of letters, and keeps labels from covering each other and the panels."""

    def __init__(self, lettering: Lettering) -> None:
        self._letters = lettering
        self._pad_px = max(2, lettering.cap_px // 3)
        self._taken: list[Box] = []
        self._n_bottom_rows = 1

    def begin(self) -> None:
        """Forget what the last picture held."""
        self._taken = []
        self._n_bottom_rows = 1

    def legend(self, bgr: Picture, result: FrameResult, objects: Sequence[ClusterRow]) -> None:
        """Colour, direction from above, number and time of the most urgent objects, in the upper left corner."""
        letters, pad_px = self._letters, self._pad_px
        height, width = bgr.shape[:2]
        n_rows = min(MAX_LEGEND_ROWS, max(1, int(_LEGEND_SHARE * height / letters.line_px)))
        shown = objects[:n_rows]
        if not shown:
            return
        numbers = [f"#{cluster.cluster_id}" for cluster in shown]
        times = [self._legend_time(cluster, width) for cluster in shown]
        number_x = pad_px + round(3.3 * letters.cap_px)
        time_x = number_x + max(letters.width_px(text) for text in numbers) + letters.cap_px
        right = time_x + max(letters.width_px(text) for text in times) + 2 * pad_px
        box = (0, 0, right, len(shown) * letters.line_px + 2 * pad_px)
        shade(bgr, box, DARK, _PANEL_OPACITY)
        self._taken.append(box)
        for row, (cluster, number, time) in enumerate(zip(shown, numbers, times, strict=True)):
            y = pad_px + row * letters.line_px + (letters.line_px - letters.cap_px) // 2
            colour = object_colour(cluster.cluster_id)
            shade(bgr, (pad_px, y, pad_px + letters.cap_px, y + letters.cap_px), colour, 1.0)
            if cluster.direction is not None and all(math.isfinite(part) for part in cluster.direction):
                centre = (pad_px + round(2.1 * letters.cap_px), y + letters.cap_px // 2)
                draw_top_view(bgr, cluster.direction, centre, WHITE, letters.cap_px)
            letters.draw(bgr, number, number_x, y, WHITE)
            letters.draw(bgr, time, time_x, y, _LEGEND_INKS[urgency_of(cluster, result.events)])

    def _legend_time(self, cluster: ClusterRow, width: int) -> str:
        time, interval = time_text(cluster), interval_text(cluster)
        long = f"{time}  {interval}"
        return long if interval and self._letters.width_px(long) < 0.35 * width else time

    def clock(self, bgr: Picture, result: FrameResult, is_smooth: bool) -> None:
        """Time and frame in the lower left corner, with the frame's status where it is not ok."""
        text = f"{result.t_s:.2f} s  frame {result.frame}" + ("  smooth" if is_smooth else "")
        right = self._corner(bgr, text, 0, WHITE)
        if result.status is not FrameStatus.ok:
            self._corner(bgr, result.status.value.replace("_", " "), right, CLOSE)

    def camera_note(self, bgr: Picture, camera: Camera) -> None:
        """Says in the lower right corner that the field of view is assumed, or found in the clip, where it is."""
        if camera.is_assumed or camera.is_found:
            text = "assumed field of view" if camera.is_assumed else "field of view found in the clip"
            left = bgr.shape[1] - self._letters.width_px(text) - 2 * self._pad_px
            is_free = all(box[2] <= left for box in self._taken if box[3] == bgr.shape[0])
            self._n_bottom_rows = 1 if is_free else 2
            self._corner(bgr, text, left if is_free else 0, MUTED_INK, row=0 if is_free else 1)

    def _corner(self, bgr: Picture, text: str, x: int, ink: Colour, row: int = 0) -> int:
        """A text on the last or a higher line of the picture; returns where it ends."""
        letters, pad_px = self._letters, self._pad_px
        bottom = bgr.shape[0] - row * letters.line_px
        box = (x, bottom - letters.line_px, x + letters.width_px(text) + 2 * pad_px, bottom)
        shade(bgr, box, DARK, _PANEL_OPACITY)
        letters.draw(bgr, text, x + pad_px, box[1] + (letters.line_px - letters.cap_px) // 2, ink)
        self._taken.append(box)
        return box[2]

    def banner(self, bgr: Picture, result: FrameResult, objects: Sequence[ClusterRow]) -> None:
        """A red line across the picture while a warning is active: that of the most urgent object."""
        if not result.events:
            return
        order = {cluster.cluster_id: place for place, cluster in enumerate(objects)}
        event = min(result.events, key=lambda one: (order.get(one.cluster_id, len(order)), one.event_id))
        letters, pad_px = self._letters, self._pad_px
        text = banner_text(event, result)
        height, width = bgr.shape[:2]
        bottom = height - self._n_bottom_rows * letters.line_px - pad_px
        box = (0, bottom - letters.line_px - 2 * pad_px, width, bottom)
        shade(bgr, box, WARNING, _BANNER_OPACITY)
        x = max(pad_px, (width - letters.width_px(text)) // 2)
        letters.draw(bgr, text, x, box[1] + pad_px + (letters.line_px - letters.cap_px) // 2, WHITE)
        self._taken.append(box)

    def labels(self, bgr: Picture, result: FrameResult, objects: Sequence[ClusterRow]) -> None:
        """Number and time at the boxes of the most urgent objects, where there is room; the legend has the rest."""
        letters, pad_px = self._letters, self._pad_px
        boxes = {cluster.cluster_id: box_in_pixels(cluster) for cluster in objects}
        for cluster in objects[:MAX_LABELS]:
            text = f"#{cluster.cluster_id} {time_text(cluster)}"
            label_size = (letters.width_px(text) + 3 * pad_px, letters.cap_px + 2 * pad_px)
            others = [box for cluster_id, box in boxes.items() if cluster_id != cluster.cluster_id]
            place = self._free_place(bgr, boxes[cluster.cluster_id], label_size, others)
            if place is None:
                continue
            urgency = urgency_of(cluster, result.events)
            shade(bgr, place, BACKINGS[urgency], 1.0)
            shade(bgr, (place[0], place[1], place[0] + pad_px, place[3]), object_colour(cluster.cluster_id), 1.0)
            letters.draw(bgr, text, place[0] + 2 * pad_px, place[1] + pad_px, INKS[urgency])
            self._taken.append(place)

    def _free_place(self, bgr: Picture, own: Box, label_size: tuple[int, int], others: Sequence[Box]) -> Box | None:
        """Above, below or inside the own box; clear of all text, and of the other boxes where that can be had."""
        height, width = bgr.shape[:2]
        label_width, label_height = label_size
        x = min(max(own[0], 0), max(width - label_width, 0))
        rows = (own[1] - label_height - 1, own[3] + 2, own[1] + 2)
        places = [(x, y, x + label_width, y + label_height) for y in rows if 0 <= y <= height - label_height]
        free = [place for place in places if not _overlaps_any(place, self._taken)]
        clear = [place for place in free if not _overlaps_any(place, others)]
        return next(iter(clear or free), None)


def box_in_pixels(cluster: ClusterRow) -> Box:
    """An object's box in whole pixels, within what OpenCV can draw."""
    x0, y0, x1, y1 = (round(min(max(side, -_FAR_PX), _FAR_PX)) for side in cluster.box_px)
    return x0, y0, x1, y1


def _overlaps_any(one: Box, others: Sequence[Box]) -> bool:
    return any(one[0] < box[2] and box[0] < one[2] and one[1] < box[3] and box[1] < one[3] for box in others)
