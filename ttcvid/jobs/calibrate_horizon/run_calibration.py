"""From one or several clips of a camera to its horizon file, with the table and the picture of what it is made of."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import ttcvid
from ttcvid.calibration import write_horizon
from ttcvid.config import PipelineConfig
from ttcvid.draw.horizon_picture import write_horizon_picture
from ttcvid.errors import OutputError, UsageError
from ttcvid.geometry.horizon.line import HorizonFit, band_px, pitch_roll_covariance_rad2
from ttcvid.geometry.horizon.plane import pitch_roll_rad
from ttcvid.jobs.calibrate_horizon.clips import WatchedClip, watch_driving_clip, watch_resting_clip
from ttcvid.jobs.clip import ASSUMED_CAMERA_WARNING, Calibration, open_clip, read_calibration
from ttcvid.jobs.runs.provenance import digest_of
from ttcvid.jobs.settings.configuration import Configuration, configure_from_arguments
from ttcvid.model import Camera, Horizon, Platform
from ttcvid.plain_files import printable
from ttcvid.sinks.failures import output_errors
from ttcvid.sinks.motions import motion_row
from ttcvid.sinks.tables import write_table
from ttcvid.stages.horizon.at_rest import HorizonResult, calibrated_horizon
from ttcvid.stages.horizon.driving import driving_horizon

_LOG = logging.getLogger(__name__)

DEFAULT_OUT = Path("horizon.yaml")
MOTIONS_NAME, PICTURE_NAME = "motions.parquet", "horizon.png"
EXIT_UNDETERMINED = 5

RESTING_DEFAULTS = {
    "tracking": {
        "window_px": 13,
        "max_forward_backward_px": 0.5,
        "min_distance_px": 4.0,
        "close_share": 0.0,
        "far_share": 0.0,
    }
}
"""Before a resting camera only movers are followed: as many points as they have, people's clothes among them. Closer
than that their windows would see the same."""
DRIVING_DEFAULTS: dict[str, dict[str, Any]] = {
    "egomotion": {"platform": Platform.vehicle},
    "tracking": {"far_share": 0.0},
}

OnFrame = Callable[[int, int | None], None]


@dataclass(frozen=True)
class HorizonCalibration:
    """What a calibration found; without a horizon nothing was written and ``reason`` says why.

    ``files`` are the horizon file and, where they were asked for, the table of motions and the picture;
    ``result`` holds fit and motions.
    """

    horizon: Horizon | None
    camera: Camera
    result: HorizonResult
    files: tuple[Path, ...]
    warnings: tuple[str, ...]

    @property
    def reason(self) -> str:
        """Why there is no horizon; empty where there is one."""
        return self.result.reason

    @property
    def exit_code(self) -> int:
        """What the command line ends with."""
        return 0 if self.horizon is not None else EXIT_UNDETERMINED

    def summary(self) -> str:
        """One line: the horizon with its band, what it is made of, and what to know before trusting it."""
        if self.horizon is None or self.result.fit is None:
            return f"undetermined: {self.reason}"
        _, y_px, half_px = _band(self.camera, self.result.fit)
        pitch, roll = np.degrees(pitch_roll_rad(self.result.fit.normal))
        parts = [
            f"{self.files[0]}: y = {y_px[0]:.1f} px left, {y_px[2]:.1f} px right; "
            f"{y_px[1]:.1f} +- {half_px[1]:.1f} px at the centre (95 %)",
            f"pitch {pitch:.2f} deg, roll {roll:.2f} deg" if not self.camera.is_assumed else "focal length ASSUMED",
            f"{n_used(self.result)} of {len(self.result.motions)} motions used",
            *self.result.notes,
        ]
        return "; ".join(parts)

    def summary_json(self) -> str:
        """The summary as one JSON object."""
        content: dict[str, Any] = {
            "state": "determined" if self.horizon is not None else "undetermined",
            "exit_code": self.exit_code,
            "reason": self.reason,
            "files": [str(path) for path in self.files],
            "warnings": list(self.warnings),
            "n_motions": n_used(self.result),
        }
        if self.horizon is not None and self.result.fit is not None:
            content["horizon"] = {"y_left_px": self.horizon.y_left_px, "y_right_px": self.horizon.y_right_px}
            content |= _information(self.camera, self.result)
        return json.dumps(content, sort_keys=True, allow_nan=False)


def calibrate_horizon(
    clips: str | Path | Sequence[str | Path],
    out: str | Path = DEFAULT_OUT,
    *,
    evidence: str | Path | None = None,
    config: str | Path | None = None,
    **options: Any,
) -> HorizonCalibration:
    """Find the horizon of a camera from objects that move in straight lines.

    Parameters
    ----------
    clips : One clip or several of the same camera in the same place: videos, folders of pictures, tables of tracks.
    out : The horizon file, written alone.
    evidence : A folder for what the horizon rests on: ``motions.parquet`` and ``horizon.png``.
    config : A TOML configuration file. ``TTCVID_*`` variables and ``./ttcvid.toml`` count as on the command line.
    **options : The options of ``ttcvid calibrate-horizon`` with underscores (``moving=True``, ``focal_px=721``), and
        the parameters of stages as mappings (``horizon_calibration={"min_motions": 4}``).

    Returns
    -------
    A `HorizonCalibration`; where the horizon is undetermined, its ``horizon`` is None and its ``reason`` says why.

    Raises
    ------
    TtcvidError
        Input, calibration, configuration or output place cannot be used.
    """
    configuration = configure_from_arguments(options, Path(config) if config is not None else None)
    inputs = [clips] if isinstance(clips, (str, Path)) else list(clips)
    folder = None if evidence is None else Path(evidence)
    return run_calibration([str(clip) for clip in inputs], Path(out), configuration, evidence=folder)


def run_calibration(
    inputs: Sequence[str],
    out: Path,
    configuration: Configuration,
    *,
    evidence: Path | None = None,
    on_frame: OnFrame | None = None,
) -> HorizonCalibration:
    """Calibrate as configured, and write what was asked for where the horizon is determined."""
    if not inputs:
        raise UsageError("no clip given: expected at least one")
    files = (out,) if evidence is None else (out, evidence / MOTIONS_NAME, evidence / PICTURE_NAME)
    _refuse_existing(files, configuration.options.overwrite)
    clips, calibration = watch_clips(inputs, configuration, on_frame)
    warnings = [ASSUMED_CAMERA_WARNING] if calibration.camera.is_assumed else []
    warnings += [warning for clip in clips for warning in clip.warnings]
    for warning in warnings:
        _LOG.warning("%s", warning)
    result = horizon_of(clips, calibration.camera, configuration)
    if result.fit is None:
        return HorizonCalibration(None, calibration.camera, result, (), tuple(warnings))
    horizon = horizon_from_fit(calibration.camera, result.fit, str(out))
    done = HorizonCalibration(horizon, calibration.camera, result, files, tuple(warnings))
    _write(done, clips)
    return done


def watch_clips(
    inputs: Sequence[str], configuration: Configuration, on_frame: OnFrame | None = None
) -> tuple[list[WatchedClip], Calibration]:
    """Follow the points of all clips; UsageError where their pictures have different sizes."""
    moving = configuration.pipeline.horizon_calibration.moving
    watch = watch_driving_clip if moving else watch_resting_clip
    pipeline = with_own_defaults(configuration, DRIVING_DEFAULTS if moving else RESTING_DEFAULTS)
    clips: list[WatchedClip] = []
    calibration: Calibration | None = None
    for input_ in inputs:
        with open_clip(input_, configuration.options) as source:
            size = source.info.image_size
        if calibration is None:
            calibration = read_calibration(configuration.options, size)
        elif size != calibration.camera.image_size:
            raise UsageError(
                f"{input_}: pictures of {size}, but {calibration.camera.image_size} in {inputs[0]}: "
                "give clips of one camera and one size"
            )
        open_again = partial(open_clip, input_, configuration.options)
        clips.append(watch(open_again, calibration, pipeline, len(clips), on_frame))
    assert calibration is not None
    return clips, calibration


def with_own_defaults(configuration: Configuration, defaults: dict[str, dict[str, Any]]) -> PipelineConfig:
    """The parameters of the stages, with other defaults where the user has not said anything."""
    pipeline = configuration.pipeline
    for section, values in defaults.items():
        said = getattr(pipeline, section)
        unsaid = {
            key: value
            for key, value in values.items()
            if f"{section}.{key}" not in configuration.origins or getattr(said, key) == Platform.auto
        }
        pipeline = pipeline.model_copy(update={section: said.model_copy(update=unsaid)})
    return pipeline


def horizon_of(clips: list[WatchedClip], camera: Camera, configuration: Configuration) -> HorizonResult:
    """The horizon of all clips together, or why there is none."""
    config = configuration.pipeline.horizon_calibration
    complaints = [f"{clip.path}: {clip.complaint}" for clip in clips if clip.complaint]
    motions = [motion for clip in clips for motion in clip.motions]
    if complaints:
        return HorizonResult(None, tuple(motions), "; ".join(complaints))
    if config.moving:
        return driving_horizon(motions, camera, config)
    return calibrated_horizon(motions, camera, config, from_pictures=any(clip.has_pictures for clip in clips))


def horizon_from_fit(camera: Camera, fit: HorizonFit, origin: str) -> Horizon:
    """The line at both sides of the picture, with the covariance of pitch and roll."""
    _, y_px, _ = _band(camera, fit)
    covariance = pitch_roll_covariance_rad2(fit)
    (pp, pr), (_, rr) = covariance.tolist()
    sigma_rad = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    return Horizon(float(y_px[0]), float(y_px[2]), camera.image_size, sigma_rad, origin, ((pp, pr), (pr, rr)))


def n_used(result: HorizonResult) -> int:
    """Number of motions that the horizon is made of."""
    return sum(motion.status == "used" for motion in result.motions)


def _band(camera: Camera, fit: HorizonFit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns at the left, in the centre and at the right, the line there, and half the width of its 95 % band."""
    x_px = np.array([0.0, 0.5, 1.0]) * (camera.image_size.width_px - 1.0)
    return x_px, *band_px(camera, fit, x_px)


def _information(camera: Camera, result: HorizonResult) -> dict[str, Any]:
    """What the file says beside the line."""
    assert result.fit is not None
    used = [motion for motion in result.motions if motion.status == "used"]
    _, _, half_px = _band(camera, result.fit)
    content: dict[str, Any] = {}
    if not camera.is_assumed:
        pitch, roll = np.degrees(pitch_roll_rad(result.fit.normal)).tolist()
        content |= {"pitch_deg": round(pitch, 4), "roll_deg": round(roll, 4)}
    names = ("left", "centre", "right")
    residual_deg = np.degrees(result.fit.residual_rad[result.fit.is_used])
    content |= {
        "band_95_px": {name: round(float(half), 2) for name, half in zip(names, half_px, strict=True)},
        "n_motions": len(used),
        "n_tracks": sum(len(motion.track_id) for motion in used),
        "residuals": {
            "median_deg": round(float(np.median(np.abs(residual_deg))), 4),
            "rms_deg": round(float(np.sqrt(np.mean(residual_deg**2))), 4),
        },
        "roll_zero": result.roll_zero,
    }
    return content


def _refuse_existing(files: tuple[Path, ...], overwrite: bool) -> None:
    for path in files:
        if path.exists() and not overwrite:
            raise OutputError(f"{path}: exists already: choose another place with -o, or replace it with --overwrite")


def _write(done: HorizonCalibration, clips: list[WatchedClip]) -> None:
    """All files under temporary names first, so that none stands there half written."""
    assert done.horizon is not None
    temporary = [path.with_name(f".{path.name}.partial") for path in done.files]
    horizon_file, *evidence = temporary
    for path in temporary:
        with output_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)  # of a run that was killed, or a link, whose file is not ours to write
    try:
        with output_errors(done.files[0]):
            write_horizon(horizon_file, done.horizon, _said_in_file(done, clips))
        if evidence:
            table, picture = evidence
            _write_evidence(table, picture, done, clips[0])
        with output_errors(done.files[0]):
            for path, final in zip(reversed(temporary), reversed(done.files), strict=True):
                os.replace(path, final)
    finally:
        for path in temporary:
            path.unlink(missing_ok=True)


def _said_in_file(done: HorizonCalibration, clips: list[WatchedClip]) -> dict[str, Any]:
    """What the horizon file says beside the line."""
    sources = [printable(clip.path) for clip in clips]
    digests = [digest_of(clip.files).sha256 for clip in clips]
    return _information(done.camera, done.result) | {
        "source": sources[0] if len(sources) == 1 else sources,
        "source_sha256": digests[0] if len(digests) == 1 else digests,
        "ttcvid_version": ttcvid.__version__,
    }


def _write_evidence(table: Path, picture: Path, done: HorizonCalibration, first: WatchedClip) -> None:
    """The table of motions, and the picture of the first clip."""
    fit, motions = done.result.fit, done.result.motions
    assert fit is not None
    metadata = {"ttcvid_version": ttcvid.__version__, "camera_is_assumed": str(done.camera.is_assumed).lower()}
    write_table(table, "motions", [motion_row(m, fit, done.camera) for m in motions], metadata)
    with output_errors(picture):
        title = printable(done.summary())
        write_horizon_picture(picture, done.camera, fit, motions, first.rows, first.background, title)
