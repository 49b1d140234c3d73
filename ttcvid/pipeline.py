"""The stages in order: what happens to a frame between source and sinks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from typing import Protocol, TypeVar

from ttcvid.config import PipelineConfig
from ttcvid.model import (
    Camera,
    Frame,
    FrameResult,
    Horizon,
    Picture,
    Platform,
)
from ttcvid.stages.analyzed_frames import AnalyzedFrame, RowMemory, analyze_seen, smoothed
from ttcvid.stages.horizon.planar_motion import horizon_plane
from ttcvid.stages.tracking.history import empty_history
from ttcvid.stages.tracking.tracked_frames import MapAhead, TrackedFrame, track_frames
from ttcvid.stages.update import Clip, Memory, SeenFrame, see_motions

T = TypeVar("T")
R = TypeVar("R")


class RunApart(Protocol):
    """Calls a function of a stream with the stream, perhaps in another process, which its block ends."""

    def __call__(
        self, function: Callable[[Iterable[T]], Iterator[R]], items: Iterable[T], /
    ) -> AbstractContextManager[Iterable[R]]:
        """What ``function(items)`` yields."""
        ...


@contextmanager
def run_here(function: Callable[[Iterable[T]], Iterator[R]], items: Iterable[T]) -> Iterator[Iterable[R]]:
    """What ``function(items)`` yields."""
    yield function(items)


def analyze_frames(
    frames: Iterable[Frame],
    camera: Camera,
    config: PipelineConfig,
    horizon: Horizon | None = None,
    mask: Picture | None = None,
    *,
    map_ahead: MapAhead = map,
    run_apart: RunApart = run_here,
) -> Generator[tuple[Frame, FrameResult], None, None]:
    """Each frame, without ``grey``, with its result, in order; memory does not grow with the length of the clip.

    Parameters
    ----------
    mask : (H, W) uint8, 0 where nothing is to be looked at.
    map_ahead : like ``map``; may work some items early in other threads (finding features is the slow part).
    run_apart : may run the geometry of all frames in other processes; only points of tracks go there, and results back.
    """
    waiting, camera_rests = deque[Frame](), config.egomotion.platform == Platform.static
    tracked = _without_pictures(
        track_frames(frames, config.tracking, mask, map_ahead, camera_rests=camera_rests), waiting
    )
    geometry = partial(analyze_tracked, camera=camera, config=config, horizon=horizon, run_apart=run_apart)
    with run_apart(geometry, tracked) as results:
        for result in results:
            yield waiting.popleft(), result


def analyze_tracked(
    tracked_frames: Iterable[TrackedFrame],
    camera: Camera,
    config: PipelineConfig,
    horizon: Horizon | None = None,
    *,
    run_apart: RunApart = run_here,
) -> Iterator[FrameResult]:
    """The result of each frame from its tracked points: all of an analysis but what looks at pictures.

    ``run_apart`` may run the motions in one process more: no motion waits for the rows of the frame before it.
    """
    plane = None if horizon is None else horizon_plane(camera, horizon)
    clip = Clip(camera, _with_platform(config), plane)
    with run_apart(partial(_with_motions, clip=clip), tracked_frames) as seen:
        analyzed = _analyzed(seen, clip)
        for item in smoothed(analyzed, clip) if config.collision_times.smooth else analyzed:
            yield item.result


def _with_platform(config: PipelineConfig) -> PipelineConfig:
    """What carries the camera, where nobody has told (`stages.egomotion.platform`): any motion is as likely."""
    if config.egomotion.platform != Platform.auto:
        return config
    return config.model_copy(update={"egomotion": config.egomotion.model_copy(update={"platform": Platform.free})})


def _without_pictures(tracked_frames: Iterable[TrackedFrame], waiting: deque[Frame]) -> Iterator[TrackedFrame]:
    """The points of each frame alone; the frames themselves go to those that are ``waiting`` for their results."""
    for tracked in tracked_frames:
        frame = tracked.frame
        # They keep only what is drawn on: several wait, many where estimates need frames that come after them.
        waiting.append(replace(frame, grey=None))
        yield replace(tracked, frame=replace(frame, grey=None, colour=None))


def _with_motions(tracked_frames: Iterable[TrackedFrame], clip: Clip) -> Iterator[SeenFrame]:
    """Each frame with its motions."""
    memory = Memory(empty_history(clip.camera, clip.config.tracking.sigma_start_px))
    for tracked in tracked_frames:
        item, memory = see_motions(tracked, memory, clip)
        yield item


def _analyzed(seen: Iterable[SeenFrame], clip: Clip) -> Iterator[AnalyzedFrame]:
    """Each frame with its causal result."""
    rows = RowMemory()
    for item in seen:
        result, rows = analyze_seen(item, rows, clip)
        yield AnalyzedFrame(result, item.seen)
