"""The stages in order: what happens to a frame between source and sinks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

from ttcvid.config import PipelineConfig
from ttcvid.model import (
    Camera,
    Frame,
    FrameResult,
    Horizon,
    Picture,
)
from ttcvid.stages.analyzed_frames import AnalyzedFrame, analyze_seen, smoothed
from ttcvid.stages.events import EventMemory
from ttcvid.stages.history import empty_history
from ttcvid.stages.planar import horizon_plane
from ttcvid.stages.seen_frames import Clip, Memory, SeenFrame, see_motions
from ttcvid.stages.tracked_frames import MapAhead, TrackedFrame, track_frames

T = TypeVar("T")


class RunAhead(Protocol):
    """Like ``iter``; may run the items early in another thread."""

    def __call__(self, items: Iterable[T], /) -> Iterable[T]:
        """The same items in the same order."""
        ...


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
    for item in smoothed(analyzed, clip) if config.collision_times.smooth else analyzed:
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
