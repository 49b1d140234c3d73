"""Tracks that stay on their pixel while the scene moves: bonnet, wiper, burned-in text.

They look like an object at constant bearing, the most dangerous there is, and are none. They are tracked nevertheless:
what starts to move again, such as a car ahead that kept its distance, is used again at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import KDTree

from ttcvid.model import Bools, Floats, Ints, PointSet
from ttcvid.stages.tracking.groups import places_among

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
    """Which of the points ``(N,)`` of this frame are frozen, and the memory for the next one.

    Parameters
    ----------
    scene_moves : Whether the camera translated or turned in the step before: only then does staying mean anything.
    step_s : Time since the last frame.
    """
    counts = int(scene_moves) * min(1.0, step_s / _WHOLE_FRAME_S)
    anchor_px, place = points.xy_px.copy(), places_among(memory.track_id, points.track_id)
    is_new = place < 0
    n_stayed = np.where(is_new, counts, 0.0)
    old = np.flatnonzero(~is_new)
    moved_px = anchor_px.take(old, axis=0) - memory.anchor_px.take(place[old], axis=0)
    stays = old[(moved_px * moved_px).sum(axis=1) < _STAYS_PX**2]
    anchor_px[stays], n_stayed[stays] = memory.anchor_px[place[stays]], memory.n_stayed[place[stays]] + counts
    is_frozen = n_stayed >= _FROZEN_FRAMES
    if is_frozen.any() and is_new.any():
        distance, _ = KDTree(points.xy_px[is_frozen]).query(points.xy_px[is_new])
        n_stayed[np.flatnonzero(is_new)[distance < _NEAR_FROZEN_PX]] = _FROZEN_FRAMES
    return n_stayed >= _FROZEN_FRAMES, FrozenMemory(points.track_id, anchor_px, n_stayed)
