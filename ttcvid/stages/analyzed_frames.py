"""The rows and warnings of a frame: the part of an analysis that no later frame depends on."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, replace

import numpy as np

from ttcvid.model import NO_CLUSTER, ClusterRow, CollisionTimes, FrameResult, FrameStatus, Platform, Status, TrackRows
from ttcvid.stages.objects.consistency import PastStates
from ttcvid.stages.objects.nearest_surface import LEAST_TRACKS
from ttcvid.stages.objects.reached_first import Since, nearest_object
from ttcvid.stages.rows import cluster_rows, no_tracks, track_rows
from ttcvid.stages.smoothing import Seen, are_enough, seen_again
from ttcvid.stages.update import Clip, SeenFrame
from ttcvid.stages.warnings.course import Viewpoint
from ttcvid.stages.warnings.events import EventMemory, standing_events, update_events


@dataclass(frozen=True)
class AnalyzedFrame:
    """The result of a frame and what that rests on; None for a frame that gives no number."""

    result: FrameResult
    seen: Seen | None


@dataclass(frozen=True)
class RowMemory:
    """What the rows of a frame rest on of those before: warnings, who approaches since when, and states."""

    watch: EventMemory = field(default_factory=EventMemory)
    since: Since = field(default_factory=dict)
    states: PastStates = field(default_factory=dict)


def analyze_seen(item: SeenFrame, memory: RowMemory, clip: Clip) -> tuple[FrameResult, RowMemory]:
    """The rows of a frame and its warnings: states, times, events."""
    frame, seen = item.frame, item.seen
    line_px = None if item.plane is None else item.plane.line_px
    result = FrameResult(frame.index, frame.t_s, item.dt_s, item.status, no_tracks(), (), horizon_px=line_px)
    if seen is None:
        # It gives no number, only a reason: what was warned of before stands.
        return replace(result, events=standing_events(memory.watch, frame.t_s, clip.config.events)), memory
    if item.status == FrameStatus.cut:
        # The numbers of warnings go on.
        memory = RowMemory(EventMemory(next_event_id=memory.watch.next_event_id))
    tracks, clusters, states = _rows(seen, clip, memory.states)
    platform, step_s = clip.config.egomotion.platform, seen.history.step_s
    view = Viewpoint(clip.camera, platform == Platform.vehicle, platform == Platform.static, seen.motions.bend)
    events, watch = update_events(
        memory.watch, frame.index, frame.t_s, clusters, view, clip.config.events, step_s=step_s
    )
    nearest, since = nearest_object(memory.since, frame.t_s, clusters, clip.config)
    if seen.egomotion is not None:
        own = seen.egomotion
        result = replace(result, rotation_rad=own.rotation_rad, rotation_sigma_rad=own.rotation_sigma_rad)
    tracks, clusters = without_remnants(tracks, clusters, platform)
    result = replace(result, tracks=tracks, clusters=clusters, nearest=nearest, events=events)
    return result, RowMemory(watch, since, states)


def smoothed(analyzed: Iterable[AnalyzedFrame], clip: Clip) -> Iterator[AnalyzedFrame]:
    """Each frame once the frames after it have been analysed, with directions and times estimated again."""
    max_frames = clip.config.collision_times.max_frames
    held: deque[AnalyzedFrame] = deque()
    memory = RowMemory()

    def released() -> AnalyzedFrame:
        nonlocal memory
        first = held.popleft()
        again, memory = _estimated_again(first, [item.seen for item in held if item.seen is not None], memory, clip)
        return again

    for item in analyzed:
        seen = item.seen
        if seen is not None and any(not h.seen.is_continued_by(seen.history) for h in held if h.seen is not None):
            while held:
                yield released()
        held.append(item)
        while are_enough(len(held) - 1, item.result.t_s - held[0].result.t_s, max_frames):
            yield released()
    while held:
        yield released()


def _estimated_again(
    item: AnalyzedFrame, later: list[Seen], memory: RowMemory, clip: Clip
) -> tuple[AnalyzedFrame, RowMemory]:
    """A frame with the rows that views on both sides give; status, own rotation and warnings stay as they were."""
    if item.seen is None:
        return item, memory
    if item.result.status == FrameStatus.cut:
        memory = RowMemory()
    tracks, clusters, states = item.result.tracks, item.result.clusters, memory.states
    if later:
        seen = seen_again(item.seen, later, clip.camera, clip.config)
        tracks, clusters, states = _rows(seen, clip, states)
        tracks, clusters = without_remnants(tracks, clusters, clip.config.egomotion.platform)
    nearest, since = nearest_object(memory.since, item.result.t_s, clusters, clip.config)
    result = replace(item.result, tracks=tracks, clusters=clusters, nearest=nearest)
    return replace(item, result=result), RowMemory(since=since, states=states)


def _rows(seen: Seen, clip: Clip, past: PastStates) -> tuple[TrackRows, tuple[ClusterRow, ...], PastStates]:
    """Rows of tracks and clusters, and the states of objects seen so far."""
    states, tracks = track_rows(seen.history, seen.motions, clip.config.collision_times, seen.plane)
    return tracks, *cluster_rows(seen.history, seen.motions, states, clip.camera, past)


def without_remnants(
    tracks: TrackRows, clusters: tuple[ClusterRow, ...], platform: Platform
) -> tuple[TrackRows, tuple[ClusterRow, ...]]:
    """Both without objects that have no times and fewer tracks than a surface needs; their tracks have no value.

    Most of them are what is left of an object, or never were one. Before a camera at rest few tracks make a mover.
    """
    told = [
        one for one in clusters if one.role == "scene" or one.state_abc_hz is not None or one.n_tracks >= LEAST_TRACKS
    ]
    if platform == Platform.static or len(told) == len(clusters):
        return tracks, clusters
    is_left = ~np.isin(tracks.cluster_id, [NO_CLUSTER, *(one.cluster_id for one in told)])
    times = (np.where(is_left, np.nan, getattr(tracks.times, field.name)) for field in fields(CollisionTimes))
    tracks = replace(
        tracks,
        cluster_id=np.where(is_left, NO_CLUSTER, tracks.cluster_id),
        alpha_rad=np.where(is_left, np.nan, tracks.alpha_rad),
        times=CollisionTimes(*times),
        status=np.where(is_left, Status.no_epipole, tracks.status),
    )
    return tracks, tuple(told)
