"""The stages in order: what happens to a frame between source and sinks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from ttcvid.config import PipelineConfig, TrackingConfig
from ttcvid.geometry.camera import rays_from_pixels
from ttcvid.geometry.rotation import normalize
from ttcvid.model import (
    Bools,
    Camera,
    ClusterRow,
    Event,
    Frame,
    FrameResult,
    FrameStatus,
    Horizon,
    Picture,
    PointSet,
    TrackRows,
)
from ttcvid.stages.egomotion import Egomotion, EgomotionMemory
from ttcvid.stages.events import EventMemory, restarted_events, standing_events, update_events
from ttcvid.stages.frozen import FrozenMemory, find_frozen
from ttcvid.stages.history import TrackHistory, empty_history, extended
from ttcvid.stages.motions import find_motions
from ttcvid.stages.own_motion import find_own_motion
from ttcvid.stages.planar import HorizonPlane, followed_plane, horizon_plane
from ttcvid.stages.results import cluster_rows, minimum_ttc_z_s, no_tracks, track_rows
from ttcvid.stages.segmentation import BodyMemory, restarted_bodies
from ttcvid.stages.smoothing import Seen, are_enough, seen_again
from ttcvid.stages.table_points import compare_table_points
from ttcvid.stages.tracking.tracker import PreparedPicture, TrackerMemory, follow_points, prepare_picture

T = TypeVar("T")
MapAhead = Callable[[Callable[[Frame], Any], Iterable[Frame]], Iterator[Any]]


class RunAhead(Protocol):
    """Like ``iter``; may run the items early in another thread."""

    def __call__(self, items: Iterable[T], /) -> Iterable[T]:
        """The same items in the same order."""
        ...


NO_POINTS = PointSet(np.empty(0, dtype=np.int64), np.empty((0, 2)))

# Flow left after the rotation that is not taken for motion, however small the noise, px: matching errs in common.
LEAST_PARALLAX_PX = 0.25
# A rotation that moves the picture by more than this shows which pixels are frozen, px.
_TURNING_PX = 0.5
# Third differences need four frames of history.
_LEAST_HISTORY = 4


@dataclass(frozen=True)
class Clip:
    """What does not change during an analysis."""

    camera: Camera
    config: PipelineConfig
    plane: HorizonPlane | None


@dataclass(frozen=True)
class TrackedFrame:
    """A frame with the points found in it, and what became of it so far."""

    frame: Frame
    points: PointSet
    status: FrameStatus


@dataclass(frozen=True)
class SeenFrame:
    """A frame with what moves in it, which the next frame goes on from; ``seen`` None for one that gives no number.

    ``dt_s`` is the time over which the motion of the frame goes, ``plane`` where the horizon was last seen to be.
    """

    frame: Frame
    dt_s: float | None
    status: FrameStatus
    plane: HorizonPlane | None
    seen: Seen | None = None


@dataclass(frozen=True)
class AnalyzedFrame:
    """A frame with its result and what that rests on; None for a frame that gives no number."""

    frame: Frame
    result: FrameResult
    seen: Seen | None


@dataclass(frozen=True)
class Memory:
    """Everything about motions that is remembered from one frame to the next.

    ``t_s`` is the time of the last frame, ``used_t_s`` that of the last one that gave points to the history.
    ``before_gap`` is the history before frames with too few tracks: it goes on where enough of its tracks come back.
    """

    history: TrackHistory
    t_s: float | None = None
    used_t_s: float | None = None
    egomotion: EgomotionMemory = field(default_factory=EgomotionMemory)
    frozen: FrozenMemory = field(default_factory=FrozenMemory)
    bodies: BodyMemory = field(default_factory=BodyMemory)
    scene_moves: bool = False
    plane: HorizonPlane | None = None
    before_gap: TrackHistory | None = None


def analyze_frames(
    frames: Iterable[Frame],
    camera: Camera,
    config: PipelineConfig,
    horizon: Horizon | None = None,
    mask: Picture | None = None,
    *,
    map_ahead: MapAhead = map,
    run_ahead: RunAhead = iter,
) -> Iterator[tuple[Frame, FrameResult]]:
    """Each frame with its result, in order; memory does not grow with the length of the clip.

    Parameters
    ----------
    mask : (H, W) uint8, 0 where nothing is to be looked at.
    map_ahead : like ``map``; may work some items early in other threads (finding features is the slow part).
    run_ahead : like ``iter``; may run a stage some items early in another thread (tracking ahead of motions, and these
        ahead of the rows, of which no later frame knows).
    """
    clip = Clip(camera, config, horizon_plane(camera, horizon))
    tracked = run_ahead(track_frames(frames, config.tracking, mask, map_ahead))
    analyzed = _analyzed(run_ahead(_seen(tracked, clip)), clip)
    for item in _smoothed(analyzed, clip) if config.collision_times.smooth else analyzed:
        yield item.frame, item.result


def _seen(tracked_frames: Iterable[TrackedFrame], clip: Clip) -> Iterator[SeenFrame]:
    """Each frame with what moves in it."""
    memory = Memory(empty_history(clip.camera, clip.config.tracking.sigma_start_px))
    for tracked in tracked_frames:
        item, memory = see_motions(tracked, memory, clip)
        yield item


def _analyzed(seen_frames: Iterable[SeenFrame], clip: Clip) -> Iterator[AnalyzedFrame]:
    """Each frame with its causal result."""
    watch = EventMemory()
    for item in seen_frames:
        result, watch = analyze_seen(item, watch, clip)
        yield AnalyzedFrame(item.frame, result, item.seen)


def _smoothed(analyzed: Iterable[AnalyzedFrame], clip: Clip) -> Iterator[AnalyzedFrame]:
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
        # The picture is not looked at any more.
        held.append(replace(item, frame=replace(item.frame, grey=None)))
        while are_enough(len(held) - 1, item.frame.t_s - held[0].frame.t_s, max_frames):
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


def track_frames(
    frames: Iterable[Frame], config: TrackingConfig, mask: Picture | None, map_ahead: MapAhead = map
) -> Iterator[TrackedFrame]:
    """Each frame with its points: from the tracker, or from the table that the source reads."""
    memory, last_points = TrackerMemory(), None

    def prepare(frame: Frame) -> tuple[Frame, PreparedPicture | None]:
        return frame, None if frame.grey is None else prepare_picture(frame.grey, mask, config)

    last_t_s = -np.inf
    for frame, prepared in map_ahead(prepare, frames):
        if not frame.t_s > last_t_s:
            yield TrackedFrame(frame, NO_POINTS, FrameStatus.bad_dt)
            continue
        last_t_s = frame.t_s
        if prepared is not None:
            points, status, memory = follow_points(memory, prepared, mask, config)
        elif frame.points is not None:
            points, status = frame.points, compare_table_points(last_points, frame.points)
            last_points = points
        else:
            raise ValueError(f"frame {frame.index}: expected a picture or points, got neither")
        yield TrackedFrame(frame, points, status)


def see_motions(tracked: TrackedFrame, memory: Memory, clip: Clip) -> tuple[SeenFrame, Memory]:
    """What later frames go on from: own motion, and which tracks move together."""
    frame, points, status = tracked.frame, tracked.points, tracked.status
    followed = clip.plane if memory.plane is None else memory.plane
    if status == FrameStatus.bad_dt:
        return SeenFrame(frame, _since(memory.t_s, frame), status, followed), memory
    dt_s = _since(memory.used_t_s, frame)
    memory = replace(memory, t_s=frame.t_s)
    if status in (FrameStatus.dark, FrameStatus.duplicate):
        return SeenFrame(frame, dt_s, status, followed), memory
    memory = replace(memory, used_t_s=frame.t_s)
    if status == FrameStatus.cut:
        memory = _after_cut(memory, clip)

    step_s = np.inf if dt_s is None else dt_s
    is_frozen, frozen = find_frozen(memory.frozen, points, scene_moves=memory.scene_moves, step_s=step_s)
    egomotion, history, ego_memory = _own_motion(frame, points, ~is_frozen, memory, clip)
    before_gap = None
    if egomotion is None:
        before_gap = _before_gap(memory, frame.t_s)
    else:
        dt_s = float(history.t_s[-1] - history.t_s[-2])
    if status == FrameStatus.ok:
        status = _motion_status(egomotion)
    plane = followed_plane(
        memory.plane, clip.plane, None if egomotion is None else egomotion.cam_R_prev, dt_s, clip.camera
    )
    motions, history, bodies = find_motions(
        history, egomotion, ~is_frozen, ~frozen.is_suspect, memory.bodies, plane, clip.camera, clip.config
    )
    memory = replace(
        memory,
        history=history,
        frozen=frozen,
        egomotion=ego_memory,
        bodies=restarted_bodies(bodies) if egomotion is None and before_gap is None else bodies,
        scene_moves=_shows_frozen_pixels(egomotion, clip.camera),
        plane=plane,
        before_gap=before_gap,
    )
    return SeenFrame(frame, dt_s, status, plane, Seen(history, egomotion, motions, plane)), memory


def _own_motion(
    frame: Frame, points: PointSet, is_free: Bools, memory: Memory, clip: Clip
) -> tuple[Egomotion | None, TrackHistory, EgomotionMemory]:
    """Own motion since the last frame, or since the one before a gap where that has more tracks to go on from."""
    for before in (memory.before_gap, memory.history):
        if before is None:
            continue
        found = find_own_motion(
            _with_points(frame, points, before, clip),
            is_free,
            memory.egomotion,
            clip.config.egomotion,
            LEAST_PARALLAX_PX,
            clip.config.tracking.sigma_floor_px,
        )
        if found[0] is not None:
            break
    return found


def _before_gap(memory: Memory, t_s: float) -> TrackHistory | None:
    """The history before a frame with too few tracks, for as long as it reaches back."""
    before = memory.history if memory.before_gap is None else memory.before_gap
    return before if len(before.t_s) > 1 and t_s - before.t_s[-1] <= before.t_s[-1] - before.t_s[0] else None


def _since(t_s: float | None, frame: Frame) -> float | None:
    return None if t_s is None else frame.t_s - t_s


def analyze_seen(item: SeenFrame, watch: EventMemory, clip: Clip) -> tuple[FrameResult, EventMemory]:
    """The rows of a frame and its warnings: states, times, events."""
    frame, seen = item.frame, item.seen
    if seen is None:
        return _empty_result(item, standing_events(watch, frame.t_s, clip.config.events)), watch
    if item.status == FrameStatus.cut:
        watch = restarted_events(watch)
    tracks, clusters = _rows(seen, clip)
    events, watch = update_events(
        watch, frame.index, frame.t_s, clusters, clip.camera, clip.config.events, step_s=seen.history.step_s
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


def _after_cut(memory: Memory, clip: Clip) -> Memory:
    """Nothing is carried over a cut but the numbers already given away."""
    return Memory(
        history=empty_history(clip.camera, clip.config.tracking.sigma_start_px),
        t_s=memory.t_s,
        used_t_s=memory.used_t_s,
        bodies=restarted_bodies(memory.bodies),
    )


def _with_points(frame: Frame, points: PointSet, before: TrackHistory, clip: Clip) -> TrackHistory:
    """The history with this frame's points as rays; a point that no ray belongs to (far outside a lens) has NaN."""
    rays = normalize(rays_from_pixels(clip.camera, points.xy_px))
    times = clip.config.collision_times
    max_frames = max(_LEAST_HISTORY, times.max_gap_frames + 1, times.max_frames)
    # A tracker of pictures gives no number twice; of another one, who knows.
    from_table = frame.points is not None
    return extended(before, frame.index, frame.t_s, points, rays, max_frames, may_come_back=from_table)


def _motion_status(egomotion: Egomotion | None) -> FrameStatus:
    if egomotion is None:
        return FrameStatus.few_tracks
    return FrameStatus.rotation_only if egomotion.direction is None else FrameStatus.ok


def _shows_frozen_pixels(egomotion: Egomotion | None, camera: Camera) -> bool:
    """Whether the camera moved so that every pixel of the scene had to change its place."""
    if egomotion is None:
        return False
    turned_px = float(np.linalg.norm(egomotion.rotation_rad)) * camera.fx_px
    return egomotion.direction is not None or turned_px > _TURNING_PX


def _empty_result(item: SeenFrame, events: tuple[Event, ...]) -> FrameResult:
    """A frame that gives no number, only a reason: what was warned of before stands."""
    frame, line_px = item.frame, _line_px(item.plane)
    return FrameResult(
        frame.index, frame.t_s, item.dt_s, item.status, no_tracks(), (), horizon_px=line_px, events=events
    )


def _line_px(plane: HorizonPlane | None) -> tuple[float, float] | None:
    return None if plane is None else plane.line_px
