"""What one analysis writes: the tables and the annotated video, frame by frame."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from ttcvid.draw import OverlayPainter
from ttcvid.errors import OutputError
from ttcvid.jobs.clip import Calibration
from ttcvid.jobs.runs.provenance import table_metadata
from ttcvid.jobs.settings.configuration import TOLD_BY_CLIP, Configuration
from ttcvid.model import Frame, FrameResult, ImageSize, Picture
from ttcvid.sinks.folder import OVERLAY_NAME
from ttcvid.sinks.tables import TableSink
from ttcvid.sinks.video import OverlayVideo, check_video
from ttcvid.sources import Source


def open_sinks(
    stack: ExitStack, folder: Path, source: Source, calibration: Calibration, configuration: Configuration
) -> Callable[[tuple[Frame, FrameResult]], None]:
    """Open tables and, where wanted, the overlay; returns what writes one frame to both."""
    info, options, overlay = source.info, configuration.options, configuration.overlay
    metadata = table_metadata(calibration, configuration.as_manifest())
    tables = stack.enter_context(TableSink(folder, metadata, nominal_dt_s=info.nominal_dt_s))
    if not options.overlay:
        return lambda item: tables.write(item[1])
    dt_s = info.nominal_dt_s * options.stride
    path = folder / OVERLAY_NAME
    video = stack.enter_context(OverlayVideo(path, info.image_size, dt_s, overlay.preset, overlay.crf))
    is_smooth = configuration.pipeline.collision_times.smooth
    is_told = configuration.origins.get("egomotion.platform") == TOLD_BY_CLIP
    told_platform = configuration.pipeline.egomotion.platform.value if is_told else ""
    painter = OverlayPainter(calibration.camera, info.image_size, overlay.trail_frames, is_smooth, told_platform)

    def write(item: tuple[Frame, FrameResult]) -> None:
        frame, result = item
        tables.write(result)
        video.write(painter.paint(_canvas(frame, info.image_size), result), result.t_s)

    return write


def _canvas(frame: Frame, image_size: ImageSize) -> Picture:
    """The picture to draw on; black where the source has tracks only."""
    if frame.colour is not None:
        return frame.colour()
    return np.zeros((image_size.height_px, image_size.width_px, 3), dtype=np.uint8)


def check_overlay(path: Path, n_expected: int) -> None:
    """Read the overlay once; OutputError unless it holds as many frames as were written."""
    n_frames = check_video(path)
    if n_frames != n_expected:
        raise OutputError(
            f"{path}: holds {n_frames} frames, {n_expected} were written: run again, or with --no-overlay"
        )
