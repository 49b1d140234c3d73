"""One clip of a suite, rendered and analysed in processes of their own, and what is measured there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ttcvid.jobs.analyze.run_analysis import analyze
from ttcvid.jobs.processes.memory import PeakMemory
from ttcvid.jobs.runs.run import Run
from ttcvid.model import Horizon, Platform
from ttcvid.studies.evaluation.metrics import Value

CALIBRATION_OPTIONS = (
    "camera",
    "focal_px",
    "hfov",
    "image_size",
    "mask",
    "fps",
    "timestamps",
    "start",
    "end",
    "stride",
)
"""What a calibration of the horizon takes over from the options of the analysis."""


@dataclass(frozen=True)
class ClipTask:
    """What is to be done with one clip: paths are resolved; ``truth`` is None where nothing is to be evaluated."""

    input: Path
    out: Path
    options: Mapping[str, Any]
    truth: Path | None = None
    needs_horizon: bool = False


@dataclass(frozen=True)
class ClipRun:
    """A finished analysis: where it is, and what was measured beside it.

    ``max_rss_mb`` is the peak of resident memory in 10^6 bytes; ``fps_ratio`` frames analysed over frames recorded per
    second; ``horizon_y_px`` is at the middle of the picture, None for ``horizon_reason``; ``metrics`` of `evaluate`.
    """

    folder: Path
    n_frames: int
    n_objects: int
    n_events: int
    max_rss_mb: float
    fps_ratio: float
    horizon_y_px: float | None
    horizon_reason: str
    metrics: dict[str, Value] | None


def render_scene(scene: Path, folder: Path, n_frames: int | None) -> Path:
    """Render a scene into ``folder`` (one of a former run is replaced) and return the clip."""
    from ttcvid.jobs.simulate import simulate

    return simulate(scene, folder, n_frames=n_frames, overwrite=True).input


def run_clip(task: ClipTask) -> ClipRun:
    """Analyse a clip; evaluate it and calibrate its horizon where that is asked for.

    What only those need is imported after the analysis: it would count as memory of the analysis.
    """
    with PeakMemory() as memory:
        run = analyze(task.input, task.out, **{"overlay": False, "report": False, **task.options, "overwrite": True})
        max_rss_mb = memory.peak_mb
    horizon_y_px, reason = _horizon(run, task) if task.needs_horizon else (None, "")
    metrics = _metrics(run, task.truth) if task.truth is not None else None
    counts, timings = run.manifest["counts"], run.manifest["timings"]
    return ClipRun(
        folder=run.folder,
        n_frames=counts["frames"],
        n_objects=counts["objects"],
        n_events=counts["events"],
        max_rss_mb=max_rss_mb,
        fps_ratio=timings["frames_per_s"] * _recorded_dt_s(run),
        horizon_y_px=horizon_y_px,
        horizon_reason=reason,
        metrics=metrics,
    )


def _recorded_dt_s(run: Run) -> float:
    stride = run.manifest["configuration"]["analyze"]["stride"]["value"]
    return float(run.manifest["input"]["nominal_dt_s"]) * int(stride)


def _metrics(run: Run, truth: Path) -> dict[str, Value]:
    from ttcvid.jobs.evaluate import evaluate

    return evaluate(run, truth).evaluation.metrics


def _horizon(run: Run, task: ClipTask) -> tuple[float | None, str]:
    """The horizon that the run was given, else the one that a calibration finds in its clip."""
    given = run.manifest["horizon"]
    if given is not None:
        return (given["y_left_px"] + given["y_right_px"]) / 2, ""
    from ttcvid.jobs.calibrate_horizon.run_calibration import calibrate_horizon

    options = {name: value for name, value in task.options.items() if name in CALIBRATION_OPTIONS}
    moving = task.options.get("platform", Platform.free) != Platform.static
    target = task.out.with_name(f"{task.out.name}_horizon")
    target.mkdir(parents=True, exist_ok=True)
    found = calibrate_horizon(task.input, target / "horizon.yaml", moving=moving, overwrite=True, **options)
    return (None, found.reason) if found.horizon is None else (_centre_px(found.horizon), "")


def _centre_px(horizon: Horizon) -> float:
    return float(np.mean([horizon.y_left_px, horizon.y_right_px]))
