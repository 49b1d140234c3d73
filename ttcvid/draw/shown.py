"""Which objects a picture shows, each with its box and colour, the most urgent first."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.draw.boxes import Box, box_in_pixels
from ttcvid.draw.palette import Colour, ObjectColours
from ttcvid.draw.wording import Urgency, by_urgency, time_text, unseen_text, urgency_of
from ttcvid.model import SCENE_CLUSTER, ClusterRow, FrameResult


@dataclass(frozen=True)
class Shown:
    """An object as it is drawn; ``unseen_s`` is 0 where it has a row in this frame, and so is in view."""

    row: ClusterRow
    box: Box
    colour: Colour
    urgency: Urgency
    unseen_s: float = 0.0

    @property
    def is_in_view(self) -> bool:
        """Whether it is seen in this frame."""
        return self.unseen_s == 0.0

    @property
    def text(self) -> str:
        """Its time, or for how long it has not been seen."""
        return time_text(self.row) if self.is_in_view else unseen_text(self.unseen_s)


class ShownObjects:
    """The objects in view, and those that a warning goes on for while they are hidden, where they were seen last."""

    def __init__(self) -> None:
        self._colours = ObjectColours()
        self._seen: dict[int, tuple[Shown, float]] = {}
        self.colours: dict[int, Colour] = {}

    def follow(self, result: FrameResult) -> list[Shown]:
        """What the next frame shows; ``colours`` are then those of all objects that it has, by ``cluster_id``."""
        tracks, rows = result.tracks, [row for row in by_urgency(result) if all(map(math.isfinite, row.box_px))]
        in_view = {row.cluster_id for row in rows}
        warned = {event.cluster_id for event in result.events}
        hidden = sorted((warned - in_view) & self._seen.keys())
        of_tracks = set(np.unique(tracks.cluster_id[tracks.cluster_id > SCENE_CLUSTER]).tolist())
        self.colours = self._colours.follow(in_view | of_tracks | set(hidden))
        objects = []
        for row in rows:
            xy_px = tracks.xy_px[tracks.cluster_id == row.cluster_id]
            box = box_in_pixels(row, xy_px)
            objects.append(Shown(row, box, self.colours[row.cluster_id], urgency_of(row, result.events)))
        known = {one.row.cluster_id: (one, result.t_s) for one in objects}
        for cluster_id in hidden:
            last, seen_s = known[cluster_id] = self._seen[cluster_id]
            unseen_s, colour = max(result.t_s - seen_s, 1e-9), self.colours[cluster_id]
            objects.append(replace(last, colour=colour, urgency=Urgency.warned, unseen_s=unseen_s))
        self._seen = known
        return sorted(objects, key=lambda one: one.urgency is not Urgency.warned)
