"""A frame looked at once more, with views of its tracks from the frames after it.

What a frame found out when it came (own motion, which tracks belong together, warnings) stays as it was; directions and
times are estimated again from views on both sides of it. Where a velocity changes, views of the past alone tell what it
was half a window ago.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.rotation import normalize
from ttcvid.model import SCENE_CLUSTER, Camera, Floats
from ttcvid.stages.egomotion import Egomotion
from ttcvid.stages.history import TrackHistory
from ttcvid.stages.motions import FrameMotions, motions_of, scene_motion
from ttcvid.stages.planar import HorizonPlane
from ttcvid.stages.scene_path import with_scene_path

# The scene's direction follows a parabola (three coefficients) over so many steps on each side.
_NEAR_STEPS, _PARABOLA = 5, 3


@dataclass(frozen=True)
class Seen:
    """What the rows of a frame rest on."""

    history: TrackHistory
    egomotion: Egomotion | None
    motions: FrameMotions
    plane: HorizonPlane | None

    def is_continued_by(self, later: TrackHistory) -> bool:
        """Whether a later frame still knows this one: no cut, and no unknown rotation, lies between."""
        return len(later.frame) > 1 and bool(later.frame[0] <= self.history.frame[-1])


def views_after(max_frames: int) -> int:
    """Frames after a frame that its estimates wait for: half of a window."""
    return max_frames // 2


def seen_again(seen: Seen, later: Sequence[TrackHistory], camera: Camera, config: CollisionTimesConfig) -> Seen:
    """The same frame with the views of later ones, and what follows from them for the directions of its clusters.

    Parameters
    ----------
    later : the histories of the next frames in order, each of which knows this frame (`Seen.is_continued_by`).
    """
    if not later or seen.egomotion is None:
        return seen
    history = _around(seen.history, later)
    egomotion = _smoothed_direction(history, seen.egomotion)
    history = with_scene_path(history, seen.motions.is_free, egomotion)
    again = replace(seen, history=history, egomotion=egomotion)
    return replace(again, motions=_motions_again(again, camera, config))


def _around(history: TrackHistory, later: Sequence[TrackHistory]) -> TrackHistory:
    """The tracks of a frame as the last of the later frames knows its window, seen from the camera of the first.

    The last one has the rotations of the whole window, corrected by all that came in between.
    """
    last = later[-1]
    now = int(np.searchsorted(last.frame, history.frame[-1]))
    rays = np.full((len(last.frame), history.n_tracks, 3), np.nan)
    rays[: now + 1] = history.rays[-1 - now :]
    for entry, after in enumerate(later, start=now + 1):
        rays[entry] = _rays_of(after, history)
    return replace(
        history,
        frame=last.frame,
        t_s=last.t_s,
        cam_R_past=last.cam_R_past[now].T @ last.cam_R_past,
        scene_direction=last.scene_direction,
        rays=rays,
        scene=None,
        now=now - len(last.frame),
    )


def _rays_of(after: TrackHistory, history: TrackHistory) -> Floats:
    """Newest rays ``(N, 3)`` that a later history has of the tracks of ``history``; NaN for those that have ended."""
    found = np.full((history.n_tracks, 3), np.nan)
    if after.n_tracks:
        place = np.minimum(np.searchsorted(after.track_id, history.track_id), after.n_tracks - 1)
        lives = after.track_id[place] == history.track_id
        found[lives] = after.rays[-1, place[lives]]
    return found


def _smoothed_direction(history: TrackHistory, egomotion: Egomotion) -> Egomotion:
    """Own motion with the direction that a parabola through the directions of the steps around has.

    Its covariance stays: errors of neighbouring steps hang together.
    """
    directions = np.einsum("lij,lj->li", history.cam_R_past, history.scene_direction)
    near = np.abs(np.arange(len(directions)) - history.n_past) <= _NEAR_STEPS
    known = near & np.isfinite(directions[:, 0])
    if egomotion.direction is None or np.count_nonzero(known) <= _PARABOLA:
        return egomotion
    powers = np.vander(history.since_s[known], _PARABOLA, increasing=True)
    through_now = np.linalg.lstsq(powers, directions[known], rcond=None)[0][0]
    return replace(egomotion, direction=normalize(through_now))


def _motions_again(seen: Seen, camera: Camera, config: CollisionTimesConfig) -> FrameMotions:
    """The clusters with the directions that the views on both sides show."""
    members = {m.cluster_id: m.members for m in seen.motions.clusters if m.cluster_id != SCENE_CLUSTER}
    scene = [
        scene_motion(motion.members, seen.egomotion, seen.plane, camera)
        for motion in seen.motions.clusters
        if motion.cluster_id == SCENE_CLUSTER
    ]
    objects = motions_of(members, seen.history, seen.plane, camera, config)
    status = seen.motions.no_direction_status.copy()
    for motion in objects:
        status[motion.members] = motion.status
    return replace(seen.motions, clusters=(*scene, *objects), no_direction_status=status)
