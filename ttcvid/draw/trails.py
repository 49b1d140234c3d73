"""Tracks with the way that they have come, coloured by cluster."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ttcvid.compiled import compiled_for
from ttcvid.draw.palette import Colour, colours_of_tracks
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Floats, Ints, Picture, TrackRows
from ttcvid.stages.tracking.groups import places_among

# Tracks of no cluster show their last step only, those of the scene half of their way.
_LOOSE_STEPS, _SCENE_PART = 1, 0.5
# Lines go through every second position: paths are smooth.
_LINE_STEP = 2


class Trails:
    """The last positions of the live tracks.

    ``positions_px`` is ``(N, trail_frames + 1, 2)``, the newest first; a young track repeats its oldest position.
    """

    def __init__(self, trail_frames: int) -> None:
        self._n_positions = trail_frames + 1
        self._track_id: Ints = np.zeros(0, dtype=np.int64)
        self.positions_px: Floats = np.zeros((0, self._n_positions, 2))

    def follow(self, tracks: TrackRows) -> None:
        """Take in the tracks of the next frame."""
        positions = np.repeat(tracks.xy_px[:, None, :], self._n_positions, axis=1)
        place = places_among(self._track_id, tracks.track_id)
        is_old = place >= 0
        positions[is_old, 1:] = self.positions_px[place[is_old], :-1]
        self._track_id, self.positions_px = tracks.track_id, positions

    def draw(self, bgr: Picture, tracks: TrackRows, colours: Mapping[int, Colour], stroke_px: int) -> None:
        """Draw all tracks, objects last and with the full trail, so that they stand out from the scene.

        ``colours`` are those of the objects by ``cluster_id``.
        """
        is_loose, is_scene = tracks.cluster_id == NO_CLUSTER, tracks.cluster_id == SCENE_CLUSTER
        is_object = ~(is_loose | is_scene)
        colour = colours_of_tracks(tracks.cluster_id, colours)
        n_steps = np.where(is_object, self._n_positions - 1, int(_SCENE_PART * (self._n_positions - 1)))
        n_steps[is_loose] = _LOOSE_STEPS
        order = np.concatenate([np.flatnonzero(is_loose), np.flatnonzero(is_scene), np.flatnonzero(is_object)])
        # An odd width lies evenly about its line.
        stroke = np.where(is_object, stroke_px | 1, 1)
        _draw_lines(bgr, self.positions_px, n_steps, np.where(is_loose, 1, _LINE_STEP), order, colour, stroke)
        # A square at each: a line as wide as it is long.
        side_px, n = stroke_px + 1, np.count_nonzero(is_object)
        ends = np.array([[0.0, 0.0], [side_px - 1.0, 0.0]]) - (side_px // 2, 0.0)
        lines, ones = np.rint(tracks.xy_px[is_object])[:, None] + ends, np.ones(n, dtype=np.int64)
        _draw_lines(bgr, lines, ones, ones, np.arange(n), colour[is_object], side_px * ones)


@compiled_for("(u1[:, :, ::1], f8[:, :, ::1], i8[::1], i8[::1], i8[::1], u1[:, ::1], i8[::1])")
def _draw_lines(
    bgr: Picture, way: Floats, n_steps: Ints, line_step: Ints, order: Ints, colour: Picture, stroke: Ints
) -> None:
    """Lines through the ways ``(N, positions, 2)``, over ``n_steps (N,)`` and ``line_step`` of them at a time.

    Along its longer axis a line has one bar of ``stroke`` pixels at each pixel. A line longer than the picture is left
    out.
    """
    height, width = bgr.shape[:2]
    for i in order:
        low = stroke[i] // 2
        for k in range(0, n_steps[i], line_step[i]):
            last = min(k + line_step[i], n_steps[i])
            x, y = way[i, k, 0], way[i, k, 1]
            dx, dy = way[i, last, 0] - x, way[i, last, 1] - y
            length = max(abs(dx), abs(dy))
            if not length < width + height:
                continue
            count = max(int(np.ceil(length)), 1)
            down = abs(dx) > abs(dy)
            for step in range(count + 1):
                column = int(np.floor(x + dx * step / count + 0.5)) - (0 if down else low)
                row = int(np.floor(y + dy * step / count + 0.5)) - (low if down else 0)
                for across in range(stroke[i]):
                    u, v = (column, row + across) if down else (column + across, row)
                    if 0 <= u < width and 0 <= v < height:
                        for channel in range(3):
                            bgr[v, u, channel] = colour[i, channel]
