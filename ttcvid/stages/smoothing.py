"""A frame estimated again, with views of its tracks from the frames after it (``--smooth``).

What a frame found when it came (egomotion, segmentation, warnings) stays as it was; directions and times are estimated
again from views on both sides of it, and objects that the next frames find exist already. Where a velocity changes,
views of the past alone tell what it was half a window ago.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import CollisionTimesConfig, PipelineConfig
from ttcvid.geometry.estimation.rigid_motion import Points, views_by_track
from ttcvid.geometry.estimation.shared_translation import common_velocities
from ttcvid.geometry.rotation import normalize
from ttcvid.model import SCENE_CLUSTER, Camera, Floats, Ints, Status
from ttcvid.stages.egomotion.relative_pose import Egomotion
from ttcvid.stages.egomotion.scene_trajectory import with_scene_path
from ttcvid.stages.horizon.planar_motion import HorizonPlane
from ttcvid.stages.objects.clusters import ClusterMotion
from ttcvid.stages.objects.motions import FrameMotions, motions_of, scene_motion
from ttcvid.stages.segmentation.last_known import STEPS_TO_VELOCITY
from ttcvid.stages.tracking.groups import TrackSets
from ttcvid.stages.tracking.history import FULL_RATE_HZ, TrackHistory

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
        """Whether a later frame continues this one: no cut, and no unknown rotation, lies between."""
        return len(later.frame) > 1 and bool(later.frame[0] <= self.history.frame[-1])


def are_enough(n_after: int, after_s: float, max_frames: int) -> bool:
    """Whether ``n_after`` frames, the last ``after_s`` later, are enough to estimate a frame again: half of a window.

    The window has ``max_frames``.
    """
    half = max_frames // 2
    return n_after >= half and after_s >= (half - 0.5) / FULL_RATE_HZ


def seen_again(seen: Seen, later: Sequence[Seen], camera: Camera, config: PipelineConfig) -> Seen:
    """The same frame with the views of the ``later`` ones, and what follows from them for its clusters.

    Those are the next ones in order, each of which continues this one (`Seen.is_continued_by`).
    """
    if not later or seen.egomotion is None:
        return seen
    history = _around(seen.history, [after.history for after in later])
    egomotion = _smoothed_direction(history, seen.egomotion)
    history = with_scene_path(history, seen.motions.is_free, egomotion, config.egomotion.platform)
    motions = _with_known_objects(seen, later, config.bodies.min_tracks)
    again = replace(seen, history=history, egomotion=egomotion, motions=motions)
    return replace(again, motions=_motions_again(again, camera, config.collision_times))


def _around(history: TrackHistory, later: Sequence[TrackHistory]) -> TrackHistory:
    """The tracks of a frame as the last of the later frames knows its window, seen from the camera of the first.

    The last one has the rotations of the whole window, corrected by all that came in between.
    """
    last, now_frame = later[-1], history.frame[-1]
    now = int(np.searchsorted(last.frame, now_frame))
    frame, t_s = last.frame, last.t_s
    cam_R_past, scene_direction = last.cam_R_past, last.scene_direction
    if frame[now] != now_frame:
        # The views of a fast clip are thinned, and this one has been left out.
        frame, t_s = np.insert(frame, now, now_frame), np.insert(t_s, now, history.t_s[-1])
        cam_R_past = np.insert(cam_R_past, now, cam_R_past[now] @ _turned_up_to(frame[now + 1], later), axis=0)
        scene_direction = np.insert(scene_direction, now, history.scene_direction[-1], axis=0)
    rays = np.full((len(frame), history.n_tracks, 3), np.nan)
    rays[: now + 1] = history.rays[np.searchsorted(history.frame, frame[: now + 1])]
    for after in later:
        entry = int(np.searchsorted(frame, after.frame[-1]))
        if frame[entry] == after.frame[-1]:
            lives, place = _same_tracks(history, after)
            rays[entry, lives] = after.rays[-1, place]
    return replace(
        history,
        frame=frame,
        t_s=t_s,
        cam_R_past=cam_R_past[now].T @ cam_R_past,
        scene_direction=scene_direction,
        rays=rays,
        scene=None,
        now=now - len(frame),
        lost=None,
    )


def _turned_up_to(frame: int, later: Sequence[TrackHistory]) -> Floats:
    """The rotation (3, 3) from the frame before the ``later`` ones to one of them, by the steps in between."""
    turned = np.eye(3)
    for after in later:
        turned = after.cam_R_past[-2] @ turned
        if after.frame[-1] == frame:
            break
    return turned


def _same_tracks(history: TrackHistory, after: TrackHistory) -> tuple[Ints, Ints]:
    """The tracks that a later frame still has: their indices in this one, and in that."""
    return np.intersect1d(history.track_id, after.track_id, assume_unique=True, return_indices=True)[1:]


def _smoothed_direction(history: TrackHistory, egomotion: Egomotion) -> Egomotion:
    """Own motion with the direction that a parabola through the directions of the steps around has.

    Its covariance stays: errors of neighbouring steps are correlated.
    """
    directions = np.einsum("lij,lj->li", history.cam_R_past, history.scene_direction)
    near = np.abs(np.arange(len(directions)) - history.n_past) <= _NEAR_STEPS
    known = near & np.isfinite(directions[:, 0])
    if egomotion.direction is None or np.count_nonzero(known) <= _PARABOLA:
        return egomotion
    powers = np.vander(history.since_s[known], _PARABOLA, increasing=True)
    through_now = np.linalg.lstsq(powers, directions[known], rcond=None)[0][0]
    return replace(egomotion, direction=normalize(through_now))


def _with_known_objects(seen: Seen, later: Sequence[Seen], min_tracks: int) -> FrameMotions:
    """The clusters, with tracks already in the object in which a later frame first has them.

    A new mover gets its number when enough tracks have found it, for some frames, and a new track is with the scene at
    first. An object that was not there yet has to have ``min_tracks`` tracks, and to be there still in the last frame.
    """
    before = seen.motions.cluster_id
    numbers = np.append(before, later[-1].motions.cluster_id)
    cluster_id, lasting = before.copy(), numbers[numbers > SCENE_CLUSTER]
    for after in later:
        here, there = _same_tracks(seen.history, after.history)
        theirs = after.motions.cluster_id[there]
        joins = (cluster_id[here] <= SCENE_CLUSTER) & seen.motions.is_free[here] & np.isin(theirs, lasting)
        cluster_id[here[joins]] = theirs[joins]
    known = {motion.cluster_id: motion for motion in seen.motions.clusters}
    number, count = np.unique(cluster_id[cluster_id > SCENE_CLUSTER], return_counts=True)
    too_few = [one for one, n in zip(number, count, strict=True) if n < min_tracks and one not in known]
    cluster_id = np.where(np.isin(cluster_id, too_few), before, cluster_id)
    clusters = []
    for one in sorted({*known, *number.tolist()} - set(too_few)):
        members = np.flatnonzero(cluster_id == one)
        motion = known.get(one, ClusterMotion(one, members, None, None, Status.no_parallax, "whole-tracks"))
        if len(members):
            clusters.append(replace(motion, members=members))
    return replace(seen.motions, cluster_id=cluster_id, clusters=tuple(clusters))


def _motions_again(seen: Seen, camera: Camera, config: CollisionTimesConfig) -> FrameMotions:
    """The clusters with the directions that the views on both sides show."""
    history = seen.history
    clusters = [one for one in seen.motions.clusters if one.cluster_id != SCENE_CLUSTER]
    scene = [one for one in seen.motions.clusters if one.cluster_id == SCENE_CLUSTER]
    members = {one.cluster_id: one.members for one in clusters if not one.is_one_surface}
    # The velocities that the tracks of each share, by their views near the present one.
    views, sets = history.views_within(config.object_window_s), TrackSets.of(list(members.values()))
    by_track = views_by_track(history.rays[views].take(sets.index, axis=1))
    track = np.arange(len(sets.index))
    points = Points(by_track, history.sigma_norm[sets.index], history.since_s[views], track, sets.set_of)
    velocities = common_velocities(points, history.cam_R_past[views], np.zeros((len(members), 3)), STEPS_TO_VELOCITY)
    objects = motions_of(members, *velocities, history, seen.plane, camera)
    status = seen.motions.no_direction_status.copy()
    for motion in objects:
        status[motion.members] = motion.status
    objects = sorted([*objects, *(one for one in clusters if one.is_one_surface)], key=lambda one: one.cluster_id)
    scene = [scene_motion(one.members, seen.egomotion, seen.plane, camera) for one in scene]
    return replace(seen.motions, clusters=(*scene, *objects), no_direction_status=status)
