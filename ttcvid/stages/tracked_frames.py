"""Frames with the points found in them: the part of an analysis that looks at pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ttcvid.config import TrackingConfig
from ttcvid.model import (
    Frame,
    FrameStatus,
    Picture,
    PointSet,
)
from ttcvid.stages.table_points import compare_table_points
from ttcvid.stages.tracking.tracker import PreparedPicture, TrackerMemory, follow_points, prepare_picture

MapAhead = Callable[[Callable[[Frame], Any], Iterable[Frame]], Iterator[Any]]

NO_POINTS = PointSet(np.empty(0, dtype=np.int64), np.empty((0, 2)))


@dataclass(frozen=True)
class TrackedFrame:
    """A frame with the points found in it, and what became of it so far."""

    frame: Frame
    points: PointSet
    status: FrameStatus


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
