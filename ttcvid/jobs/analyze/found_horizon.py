"""``--horizon auto``: the horizon found in the clip that is to be analysed."""

from __future__ import annotations

import logging
from dataclasses import replace

from ttcvid.errors import UndeterminedError
from ttcvid.jobs.calibrate_horizon.run_calibration import horizon_from_fit, horizon_of, watch_clips
from ttcvid.jobs.clip import Calibration
from ttcvid.jobs.settings.configuration import Configuration

_LOG = logging.getLogger(__name__)


def with_found_horizon(input_: str, calibration: Calibration, configuration: Configuration) -> Calibration:
    """The calibration with the horizon that the clip itself shows: as seen by a camera at rest, else by a driving one.

    Raises
    ------
    UndeterminedError
        The clip does not tell it.
    """
    if calibration.camera.is_found:
        options = configuration.options.model_copy(update={"focal_px": calibration.camera.fx_px})
        configuration = replace(configuration, options=options)
    clips, _ = watch_clips([input_], configuration)
    if clips[0].complaint:
        _LOG.info("%s: the camera does not rest: the horizon is taken from its own motion", input_)
        config = configuration.pipeline.horizon_calibration.model_copy(update={"moving": True})
        pipeline = configuration.pipeline.model_copy(update={"horizon_calibration": config})
        configuration = replace(configuration, pipeline=pipeline)
        clips, _ = watch_clips([input_], configuration)
    result = horizon_of(clips, calibration.camera, configuration)
    if result.fit is None:
        raise UndeterminedError(f"{input_}: --horizon auto: {result.reason}; or leave --horizon out")
    for note in result.notes:
        _LOG.warning("horizon found in the clip: %s", note)
    return replace(calibration, horizon=horizon_from_fit(calibration.camera, result.fit, f"auto: {input_}"))
