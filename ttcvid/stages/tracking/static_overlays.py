"""Tracks that stay on their pixel while the scene moves: bonnet, wiper, burned-in text.

They look like an object at constant bearing, the most dangerous there is, and are none. They are tracked nevertheless:
what starts to move again, such as a car ahead that kept its distance, is used again at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import KDTree

from ttcvid.geometry.compiled import compiled_for
from ttcvid.model import Bools, Floats, Ints, PointSet

# A track is on its pixel within this distance, px: three times the noise of Lucas-Kanade on an unchanging patch.
_STAYS_PX = 0.3
# So many frames on its pixel while the scene moves make a track frozen.
_FROZEN_FRAMES = 15
# After so many it may be on the way there: it does not found a new mover.
_SUSPECT_FRAMES = 4
# A frame that follows its last one sooner than this, s, counts by its part: at 120 frames/s whatever moves by less than
# a pixel in half a second stays on its pixel for 15 frames.
_WHOLE_FRAME_S = 0.03
# A new track this close to a frozen one is taken as frozen from the start, px: corners of one burned-in letter.
_NEAR_FROZEN_PX = 15.0


@dataclass(frozen=True)
class FrozenMemory:
    """Per live track: the pixel that it is compared with, and for how many frames of a moving scene it stayed there.

    ``n_stayed (N,)`` counts the frames of a fast clip as fractions.
    """

    track_id: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    anchor_px: Floats = field(default_factory=lambda: np.empty((0, 2)))
    n_stayed: Floats = field(default_factory=lambda: np.empty(0))

    @property
    def is_suspect(self) -> Bools:
        """Tracks that may become frozen: ``(N,)``."""
        return np.asarray(self.n_stayed >= _SUSPECT_FRAMES)


def find_frozen(
    memory: FrozenMemory, points: PointSet, *, scene_moves: bool, step_s: float = np.inf
) -> tuple[Bools, FrozenMemory]:
    """Which of the points ``(N,)`` are frozen.

    Parameters
    ----------
    memory
        From the frame before.
    points
        Points of this frame.
    scene_moves
        Whether the camera translated or turned in the step before: only then does staying mean anything.
    step_s
        Time since the last frame.
    """
    n = len(points.track_id)
    anchor_px, n_stayed, is_new = points.xy_px.copy(), np.zeros(n), np.ones(n, dtype=bool)
    counts = int(scene_moves) * min(1.0, step_s / _WHOLE_FRAME_S)
    before = (memory.track_id, memory.anchor_px, memory.n_stayed)
    _count_stays(points.track_id, *before, counts, anchor_px, n_stayed, is_new)
    is_frozen = n_stayed >= _FROZEN_FRAMES
    if is_frozen.any() and is_new.any():
        distance, _ = KDTree(points.xy_px[is_frozen]).query(points.xy_px[is_new])
        n_stayed[np.flatnonzero(is_new)[distance < _NEAR_FROZEN_PX]] = _FROZEN_FRAMES
        is_frozen = n_stayed >= _FROZEN_FRAMES
    return is_frozen, FrozenMemory(points.track_id, anchor_px, n_stayed)


@compiled_for("(i8[::1], i8[::1], f8[:, ::1], f8[::1], f8, f8[:, ::1], f8[::1], b1[::1])")
def _count_stays(
    track_id: Ints,
    known: Ints,
    known_px: Floats,
    known_stayed: Floats,
    counts: float,
    anchor_px: Floats,
    n_stayed: Floats,
    is_new: Bools,
) -> None:
    """Carries what is known of tracks over to the same ones in this frame, with whose places ``anchor_px`` comes.

    ``known (M,)`` and ``track_id (N,)`` are ascending. The frame ``counts`` for so much where a track stays.
    """
    m = 0
    for i in range(len(track_id)):
        while m < len(known) and known[m] < track_id[i]:
            m += 1
        is_new[i] = m == len(known) or known[m] != track_id[i]
        if is_new[i]:
            n_stayed[i] = counts
            continue
        dx, dy = anchor_px[i, 0] - known_px[m, 0], anchor_px[i, 1] - known_px[m, 1]
        if dx * dx + dy * dy < _STAYS_PX * _STAYS_PX:
            anchor_px[i, 0], anchor_px[i, 1] = known_px[m, 0], known_px[m, 1]
            n_stayed[i] = known_stayed[m] + counts
