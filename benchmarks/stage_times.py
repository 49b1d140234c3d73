"""Processor time of each stage of an analysis, all in one thread: what ``speed.py --profile`` prints."""

from __future__ import annotations

import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from ttcvid import pipeline
from ttcvid.draw import OverlayPainter
from ttcvid.jobs.analyze import outputs
from ttcvid.jobs.analyze.outputs import open_sinks
from ttcvid.jobs.clip import open_clip, read_calibration
from ttcvid.jobs.processes.threads import one_opencv_thread, rare_garbage_collections
from ttcvid.jobs.settings.configuration import configure_from_arguments
from ttcvid.posix import share_freed_memory
from ttcvid.sinks.tables import TableSink
from ttcvid.sinks.video import OverlayVideo
from ttcvid.stages import analyzed_frames, update
from ttcvid.stages.tracking import tracked_frames

PIPELINE_STAGES = {
    "prepare_picture": "tracking",
    "follow_points": "tracking",
    "rays_from_pixels": "history",
    "extended": "history",
    "find_frozen": "history",
    "find_own_motion": "own motion",
    "find_motions": "motions",
    "track_rows": "rows",
    "cluster_rows": "rows",
    "update_events": "rows",
}
"""Functions that an analysis of frames calls, and the stage that each is counted to."""
PIPELINE_MODULES = (tracked_frames, update, analyzed_frames)
GEOMETRY = ("history", "own motion", "motions", "rows")
STAGES = ("decode", "tracking", *GEOMETRY, "colour", "paint", "encode", "tables", "closing")


class Stopwatch:
    """Seconds of processor time of this process, by stage: other programs on the machine do not count."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Counts what happens inside to ``stage``."""
        start_s = time.process_time()
        try:
            yield
        finally:
            self.seconds[stage] += time.process_time() - start_s

    def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, counted to ``stage``."""

        def call(*positional: Any, **named: Any) -> Any:
            with self.of(stage):
                return function(*positional, **named)

        return call


def milliseconds_per_stage(clip: Path, **options: Any) -> tuple[dict[str, float], float]:
    """Milliseconds a frame of each stage, and the median number of tracks, of an analysis with these options.

    ``colour`` is the conversion of the picture that is drawn on, ``closing`` ends the video and the tables.
    """
    watch, n_tracks = Stopwatch(), []
    configuration = configure_from_arguments(options)
    share_freed_memory()
    with ExitStack() as stack:
        stack.enter_context(one_opencv_thread())
        stack.enter_context(rare_garbage_collections())
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        for name, stage in PIPELINE_STAGES.items():
            (home,) = (module for module in PIPELINE_MODULES if hasattr(module, name))
            stack.enter_context(patch.object(home, name, watch.timed(stage, getattr(home, name))))
        for owner, name, stage in (
            (TableSink, "write", "tables"),
            (OverlayPainter, "paint", "paint"),
            (OverlayVideo, "write", "encode"),
            (outputs, "_canvas", "colour"),
        ):
            stack.enter_context(patch.object(owner, name, watch.timed(stage, getattr(owner, name))))
        source = stack.enter_context(open_clip(str(clip), configuration.options))
        calibration = read_calibration(configuration.options, source.info.image_size)
        with ExitStack() as sinks:
            write = open_sinks(sinks, folder, source, calibration, configuration)
            frames = _decoded(source, watch)
            for item in pipeline.analyze_frames(
                frames, calibration.camera, configuration.pipeline, calibration.horizon, calibration.mask
            ):
                write(item)
                n_tracks.append(len(item[1].tracks.track_id))
            with watch.of("closing"):
                sinks.close()
    return {stage: 1000.0 * watch.seconds[stage] / len(n_tracks) for stage in STAGES}, float(np.median(n_tracks))


def _decoded(source: Any, watch: Stopwatch) -> Iterator[Any]:
    frames = iter(source)
    while True:
        with watch.of("decode"):
            frame = next(frames, None)
        if frame is None:
            return
        yield frame
