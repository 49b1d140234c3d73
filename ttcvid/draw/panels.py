"""Everything written into the picture: labels of boxes, legend, clock, notes, banner."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ttcvid.draw.boxes import Box
from ttcvid.draw.lettering import Lettering
from ttcvid.draw.palette import CLOSE, DARK, MUTED_INK, WARNING, WHITE, Colour, shade
from ttcvid.draw.shown import Shown
from ttcvid.draw.signs import draw_top_view
from ttcvid.draw.wording import BACKINGS, INKS, NOT_IN_VIEW, Urgency, banner_text, interval_text
from ttcvid.model import Camera, FrameResult, FrameStatus, Picture

MAX_LEGEND_ROWS = 6
MAX_LABELS = 8
_LEGEND_SHARE = 0.4  # of the picture's height
_PANEL_OPACITY = 0.62
_BANNER_OPACITY = 0.85
_HIDDEN_SHARE = 0.5  # of a box under the banner, from which on the banner stands on top of the picture
_NO_FAULTS = (FrameStatus.ok, FrameStatus.static)
_LEGEND_INKS: dict[Urgency, Colour] = {Urgency.calm: WHITE, Urgency.close: CLOSE, Urgency.warned: (110, 110, 255)}


class Panels:
    """Writes with one size of letters, and keeps labels from covering each other and the panels."""

    def __init__(self, lettering: Lettering) -> None:
        self._letters = lettering
        self._pad_px = max(2, lettering.cap_px // 3)
        self._taken: list[Box] = []
        self._n_bottom_rows = 1
        self._top_px = 0

    def begin(self) -> None:
        """Forget what the last picture held."""
        self._taken = []
        self._n_bottom_rows = 1
        self._top_px = 0

    def legend(self, bgr: Picture, objects: Sequence[Shown]) -> None:
        """Colour, direction from above, number and time of the most urgent objects, in the upper left corner.

        Left out are those of which nothing is told.
        """
        letters, pad_px = self._letters, self._pad_px
        height, width = bgr.shape[:2]
        n_rows = min(MAX_LEGEND_ROWS, max(1, int(_LEGEND_SHARE * height / letters.line_px)))
        shown = [one for one in objects if one.urgency is not Urgency.untold][:n_rows]
        if not shown:
            return
        numbers = [f"#{one.row.cluster_id}" for one in shown]
        times = [self._legend_time(one, width) for one in shown]
        number_x = pad_px + round(3.3 * letters.cap_px)
        time_x = number_x + max(letters.width_px(text) for text in numbers) + letters.cap_px
        right = time_x + max(letters.width_px(text) for text in times) + 2 * pad_px
        box = (0, self._top_px, right, self._top_px + len(shown) * letters.line_px + 2 * pad_px)
        shade(bgr, box, DARK, _PANEL_OPACITY)
        self._taken.append(box)
        for row, (one, number, time) in enumerate(zip(shown, numbers, times, strict=True)):
            y = box[1] + pad_px + row * letters.line_px + (letters.line_px - letters.cap_px) // 2
            shade(bgr, (pad_px, y, pad_px + letters.cap_px, y + letters.cap_px), one.colour, 1.0)
            direction = one.row.direction
            if direction is not None and all(math.isfinite(part) for part in direction):
                centre = (pad_px + round(2.1 * letters.cap_px), y + letters.cap_px // 2)
                draw_top_view(bgr, direction, centre, WHITE, letters.cap_px)
            letters.draw(bgr, number, number_x, y, WHITE)
            letters.draw(bgr, time, time_x, y, _LEGEND_INKS[one.urgency])

    def _legend_time(self, one: Shown, width: int) -> str:
        interval = interval_text(one.row) if one.is_in_view else ""
        long = f"{one.text}  {interval}"
        return long if interval and self._letters.width_px(long) < 0.35 * width else one.text

    def clock(self, bgr: Picture, result: FrameResult, notes: Sequence[str]) -> None:
        """Time, frame and notes in the lower left corner, with the frame's status where something is wrong."""
        text = "  ".join([f"{result.t_s:.2f} s", f"frame {result.frame}", *notes])
        right = self._corner(bgr, text, 0, WHITE)
        if result.status not in _NO_FAULTS:
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

    def banner(self, bgr: Picture, result: FrameResult, objects: Sequence[Shown]) -> None:
        """A red line across the picture while a warning is active: that of the most urgent object with a box.

        It stands at the bottom, or on top where it would hide that box.
        """
        if not result.events:
            return
        order = {one.row.cluster_id: place for place, one in enumerate(objects)}
        event = min(result.events, key=lambda one: (order.get(one.cluster_id, len(order)), one.event_id))
        named = objects[order[event.cluster_id]] if event.cluster_id in order else None
        letters, pad_px = self._letters, self._pad_px
        text = banner_text(event, NOT_IN_VIEW if named is None else named.text)
        height, width = bgr.shape[:2]
        bottom = height - self._n_bottom_rows * letters.line_px - pad_px
        top = bottom - letters.line_px - 2 * pad_px
        if named is not None and min(named.box[3], height) - top > _HIDDEN_SHARE * (named.box[3] - named.box[1]):
            top, bottom = 0, bottom - top
            self._top_px = bottom
        box = (0, top, width, bottom)
        shade(bgr, box, WARNING, _BANNER_OPACITY)
        x = max(pad_px, (width - letters.width_px(text)) // 2)
        letters.draw(bgr, text, x, box[1] + pad_px + (letters.line_px - letters.cap_px) // 2, WHITE)
        self._taken.append(box)

    def labels(self, bgr: Picture, objects: Sequence[Shown]) -> None:
        """Number and time at the boxes of the most urgent objects, where there is room; of those warned of, always."""
        letters, pad_px = self._letters, self._pad_px
        for one in objects[:MAX_LABELS]:
            text = f"#{one.row.cluster_id} {one.text}"
            label_size = (letters.width_px(text) + 3 * pad_px, letters.cap_px + 2 * pad_px)
            others = [other.box for other in objects if other is not one]
            place = self._free_place(bgr, one.box, label_size, others, is_needed=one.urgency is Urgency.warned)
            if place is None:
                continue
            shade(bgr, place, BACKINGS[one.urgency], 1.0)
            shade(bgr, (place[0], place[1], place[0] + pad_px, place[3]), one.colour, 1.0)
            letters.draw(bgr, text, place[0] + 2 * pad_px, place[1] + pad_px, INKS[one.urgency])
            self._taken.append(place)

    def _free_place(
        self, bgr: Picture, own: Box, label_size: tuple[int, int], others: Sequence[Box], *, is_needed: bool
    ) -> Box | None:
        """Above, below or inside the own box; clear of all text, and of the other boxes where that can be had.

        What is needed stands over other text where it has to.
        """
        height, width = bgr.shape[:2]
        label_width, label_height = label_size
        x = min(max(own[0], 0), max(width - label_width, 0))
        rows = (own[1] - label_height - 1, own[3] + 2, own[1] + 2)
        places = [(x, y, x + label_width, y + label_height) for y in rows if 0 <= y <= height - label_height]
        free = [place for place in places if not _overlaps_any(place, self._taken)]
        clear = [place for place in free if not _overlaps_any(place, others)]
        inside = min(max(own[1] + 2, 0), max(height - label_height, 0))
        forced = [*places, (x, inside, x + label_width, inside + label_height)] if is_needed else []
        return next(iter(clear or free or forced), None)


def _overlaps_any(one: Box, others: Sequence[Box]) -> bool:
    return any(one[0] < box[2] and box[0] < one[2] and one[1] < box[3] and box[1] < one[3] for box in others)
