"""What a clip shows that the method cannot tell, or not well: said of that clip, beside its numbers."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from ttcvid.errors import counted
from ttcvid.model import SCENE_CLUSTER, SCENE_MOTION, FrameResult, FrameStatus, Platform

# Of fewer tracks in the median frame, what is small or plain has too few: an object takes six, side by side.
_LITTLE_TEXTURE = 150
# Objects of fewer tracks on the average have wide intervals, and come and go; so many frames make one that counts.
_FEW_POINTS, _LEAST_FRAMES = 10, 5
# A limit is told from this part of the frames, or of the objects, on.
_OFTEN = 0.2
# Travel within this of the optical axis is along the view.
_AHEAD_COSINE = float(np.cos(np.radians(20.0)))


@dataclass(frozen=True)
class Limit:
    """A limit of the method that a clip runs into: its ``name`` for one line, and a sentence."""

    name: str
    text: str


@dataclass
class LimitWatch:
    """Gathers, frame by frame, where a clip runs into the limits of the method."""

    n_frames: int = 0
    n_turns_only: int = 0
    n_ahead: int = 0
    track_counts: list[int] = field(default_factory=list)
    rows_of_objects: dict[int, tuple[int, int]] = field(default_factory=dict)

    def add(self, result: FrameResult) -> None:
        """Look at one frame."""
        self.n_frames += 1
        self.n_turns_only += result.status == FrameStatus.rotation_only
        if result.status in (FrameStatus.ok, FrameStatus.rotation_only, FrameStatus.static):
            self.track_counts.append(len(result.tracks.track_id))
        for row in result.clusters:
            if row.cluster_id == SCENE_CLUSTER:
                self.n_ahead += row.direction is not None and abs(row.direction[2]) > _AHEAD_COSINE
            elif row.motion_id != SCENE_MOTION:
                n_rows, n_tracks = self.rows_of_objects.get(row.cluster_id, (0, 0))
                self.rows_of_objects[row.cluster_id] = (n_rows + 1, n_tracks + row.n_tracks)

    def limits(self, platform: Platform) -> list[dict[str, str]]:
        """The limits that the clip runs into, ready for the manifest."""
        found = [self._texture(), self._few_points(), self._turns_only(platform), self._own_direction(platform)]
        return [asdict(limit) for limit in found if limit is not None]

    def _texture(self) -> Limit | None:
        if not self.track_counts or np.median(self.track_counts) >= _LITTLE_TEXTURE:
            return None
        n = int(np.median(self.track_counts))
        text = f"{n} tracks in the median frame: small or plain objects have too few to be found"
        return Limit("little texture", text)

    def _few_points(self) -> Limit | None:
        objects = [(n, total) for n, total in self.rows_of_objects.values() if n >= _LEAST_FRAMES]
        n_small = sum(total < _FEW_POINTS * n for n, total in objects)
        if not objects or n_small < _OFTEN * len(objects):
            return None
        text = f"{n_small} of {counted(len(objects), 'mover')} have fewer than {_FEW_POINTS} tracks: they come late, "
        return Limit("few points", text + "with wide intervals, and others like them may be missed")

    def _turns_only(self, platform: Platform) -> Limit | None:
        if platform == Platform.static or self.n_turns_only < _OFTEN * max(self.n_frames, 1):
            return None
        text = f"no own travel, or not where to, is seen in {self.n_turns_only} of {counted(self.n_frames, 'frame')} "
        text += "(rotation_only): at rest, or before a plain sky, what heads straight at the camera looks static"
        return Limit("own travel unseen", text)

    def _own_direction(self, platform: Platform) -> Limit | None:
        if self.n_ahead < _OFTEN * max(self.n_frames, 1):
            return None
        text = "what moves along our own direction at constant speed looks like a static point at another depth: "
        if platform == Platform.vehicle:
            return Limit("own direction", f"{text}it is found late, by the road below it, or not at all")
        return Limit("own direction", f"{text}the road is not used with --platform {platform.value}")
