"""The focal length found in the clip that is to be analysed, where nobody gave it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

from ttcvid.calibration import found_camera
from ttcvid.config import PipelineConfig
from ttcvid.jobs.clip import Calibration, open_clip
from ttcvid.jobs.processes.side_by_side import ReadAhead
from ttcvid.jobs.settings.configuration import Configuration
from ttcvid.model import FrameStatus, Platform
from ttcvid.sources import Source
from ttcvid.stages.egomotion.focal_length import SeenPoints, find_focal_length
from ttcvid.stages.tracking.tracked_frames import track_frames

_LOG = logging.getLogger(__name__)

MOST_FRAMES = 150
"""So many frames at the beginning of a clip are looked at."""
# Points that are followed, and their least distance in picture widths: fewer than for the analysis, all over the place.
_MAX_TRACKS, _LEAST_DISTANCE = 500, 0.015


def with_found_focal(input_: str, calibration: Calibration, configuration: Configuration) -> Calibration:
    """The calibration with the focal length that the first frames of the clip tell; as it was where they do not.

    Nothing is looked for where the camera is known, or where it rests (``--platform static``): a camera that does not
    turn shows nothing of its focal length.
    """
    pipeline = configuration.pipeline
    camera = calibration.camera
    if not camera.is_assumed or pipeline.egomotion.platform == Platform.static:
        return calibration
    with open_clip(input_, configuration.options) as source:
        found = find_focal_length(_seen_points(source, calibration, pipeline), camera.image_size)
    if found is None:
        _LOG.info("%s: its first %d frames do not determine the focal length", input_, MOST_FRAMES)
        return calibration
    sigma_px = found.sigma * found.focal_px
    _LOG.info("%s: focal length found: %.1f +- %.1f px", input_, found.focal_px, sigma_px)
    return replace(calibration, camera=found_camera(found.focal_px, sigma_px, camera.image_size))


def _seen_points(source: Source, calibration: Calibration, pipeline: PipelineConfig) -> Iterator[SeenPoints]:
    """The points of the first frames, by the tracker that is configured."""
    tracking = pipeline.tracking
    tracking = tracking.model_copy(
        update={
            "max_tracks": min(tracking.max_tracks, _MAX_TRACKS),
            "min_distance_px": max(tracking.min_distance_px, _LEAST_DISTANCE * source.info.image_size.width_px),
            # Our own way is told by what is near.
            "far_share": 0.0,
        }
    )
    with ReadAhead(source) as frames:
        for tracked in islice(track_frames(frames, tracking, calibration.mask), MOST_FRAMES):
            if tracked.status in (FrameStatus.first, FrameStatus.ok, FrameStatus.cut):
                yield SeenPoints(tracked.frame.t_s, tracked.points, tracked.status == FrameStatus.cut)
