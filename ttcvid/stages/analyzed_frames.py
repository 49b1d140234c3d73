"""The rows and warnings of a frame: the part of an analysis of which no later frame knows."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

from ttcvid.model import (
    ClusterRow,
    Event,
    FrameResult,
    FrameStatus,
    Platform,
    TrackRows,
)
from ttcvid.stages.events import EventMemory, restarted_events, standing_events, update_events
from ttcvid.stages.planar import HorizonPlane
from ttcvid.stages.results import closing_of_cluster, cluster_rows, minimum_ttc_z_s, no_tracks, track_rows
from ttcvid.stages.seen_frames import Clip, SeenFrame
from ttcvid.stages.smoothing import Seen, are_enough, seen_again


@dataclass(frozen=True)
class AnalyzedFrame:
    """The result of a frame and what that rests on; None for a frame that gives no number."""

    result: FrameResult
    seen: Seen | None


def analyze_seen(item: SeenFrame, watch: EventMemory, clip: Clip) -> tuple[FrameResult, EventMemory]:
    """The rows of a frame and its warnings: states, times, events."""
    frame, seen = item.frame, item.seen
    if seen is None:
        return _empty_result(item, standing_events(watch, frame.t_s, clip.config.events)), watch
    if item.status == FrameStatus.cut:
        watch = restarted_events(watch)
    tracks, clusters = _rows(seen, clip)
    events, watch = update_events(
        watch,
        frame.index,
        frame.t_s,
        clusters,
        clip.camera,
        clip.config.events,
        step_s=seen.history.step_s,
        on_ground=clip.config.egomotion.platform == Platform.vehicle,
        closing_of=partial(closing_of_cluster, history=seen.history, motions=seen.motions),
    )
    egomotion = seen.egomotion
    result = FrameResult(
        frame=frame.index,
        t_s=frame.t_s,
        dt_s=item.dt_s,
        status=item.status,
        tracks=tracks,
        clusters=clusters,
        rotation_rad=None if egomotion is None else egomotion.rotation_rad,
        rotation_sigma_rad=None if egomotion is None else egomotion.rotation_sigma_rad,
        min_ttc_z_s=minimum_ttc_z_s(clusters),
        horizon_px=_line_px(item.plane),
        events=events,
    )
    return result, watch


def smoothed(analyzed: Iterable[AnalyzedFrame], clip: Clip) -> Iterator[AnalyzedFrame]:
    """Each frame once the frames after it have been analysed, its directions and times estimated again with them."""
    max_frames = clip.config.collision_times.max_frames
    held: deque[AnalyzedFrame] = deque()

    def released() -> AnalyzedFrame:
        first = held.popleft()
        return _estimated_again(first, [item.seen for item in held if item.seen is not None], clip)

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


def _estimated_again(item: AnalyzedFrame, later: list[Seen], clip: Clip) -> AnalyzedFrame:
    """A frame with the rows that views on both sides give; status, own rotation and warnings stay as they were."""
    if item.seen is None or not later:
        return item
    seen = seen_again(item.seen, later, clip.camera, clip.config)
    tracks, clusters = _rows(seen, clip)
    result = replace(item.result, tracks=tracks, clusters=clusters, min_ttc_z_s=minimum_ttc_z_s(clusters))
    return replace(item, result=result)


def _rows(seen: Seen, clip: Clip) -> tuple[TrackRows, tuple[ClusterRow, ...]]:
    states, tracks = track_rows(seen.history, seen.motions, clip.config.collision_times, seen.plane)
    return tracks, cluster_rows(seen.history, seen.motions, states, clip.camera)


def _empty_result(item: SeenFrame, events: tuple[Event, ...]) -> FrameResult:
    """A frame that gives no number, only a reason: what was warned of before stands."""
    frame, line_px = item.frame, _line_px(item.plane)
    return FrameResult(
        frame.index, frame.t_s, item.dt_s, item.status, no_tracks(), (), horizon_px=line_px, events=events
    )


def _line_px(plane: HorizonPlane | None) -> tuple[float, float] | None:
    return None if plane is None else plane.line_px
