"""``ttcvid sensitivity``: the errors of each method over what is varied, as a table, pictures and a sentence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from ttcvid.config import SensitivityConfig
from ttcvid.jobs.runs.provenance import versions
from ttcvid.jobs.settings.configuration import configure_study
from ttcvid.sinks.failures import output_errors
from ttcvid.sinks.folder import OutputFolder
from ttcvid.sinks.tables import write_table
from ttcvid.studies.collision_map.picture import write_figure
from ttcvid.studies.sensitivity.case import Errors
from ttcvid.studies.sensitivity.picture import sensitivity_figure
from ttcvid.studies.sensitivity.study import Point, is_small, lengths_of, methods, reaches_m, summary, varied
from ttcvid.studies.sensitivity.study import sensitivity as points_of

SENSITIVITY_NAMES = ("sensitivity.parquet", "sensitivity.png", "sensitivity.svg")
DEFAULT_FOLDER = "sensitivity"


@dataclass(frozen=True)
class SensitivityResult:
    """What was written: the folder, the sentence, and up to which distance in m each method is useful."""

    folder: Path
    sentence: str
    reach_m: dict[str, float]

    @property
    def table(self) -> pd.DataFrame:
        """A row per value and method."""
        frame = pq.read_table(self.folder / SENSITIVITY_NAMES[0]).to_pandas()
        assert isinstance(frame, pd.DataFrame)
        return frame

    def as_json(self) -> dict[str, Any]:
        """The summary as plain values."""
        return {"folder": str(self.folder), "summary": self.sentence, "reach_m": self.reach_m}


def sensitivity(
    config: str | Path | None = None,
    out: str | Path | None = None,
    *,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> SensitivityResult:
    """How well a camera can tell direction of motion and time to collision, before it is bought.

    Parameters
    ----------
    config : A TOML file with the section ``[sensitivity]``; ``TTCVID_*`` variables and ``./ttcvid.toml`` count as well.
    out : Output folder; default ``sensitivity`` in the working folder.
    overwrite : Replace the result in a folder that exists.
    progress : Called with (points done, points in all).
    **options : The parameters of ``SensitivityConfig``, as ``focal_mm=12``; the rest is the paper's case.

    Returns
    -------
    `SensitivityResult`: the output folder, the reach of each method, and a ``table``, a row per value and method.

    Raises
    ------
    TtcvidError
        Parameters or output place cannot be used.
    """
    path = Path(config) if config is not None else None
    parameters = configure_study("sensitivity", SensitivityConfig, options, path)
    return run_sensitivity(parameters, Path(out) if out is not None else None, overwrite, progress)


def run_sensitivity(
    config: SensitivityConfig,
    out: Path | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> SensitivityResult:
    """Make the study as configured."""
    target = out if out is not None else Path(DEFAULT_FOLDER)
    ways = methods(lengths_of(config))
    with OutputFolder.create(target, overwrite, SENSITIVITY_NAMES) as folder:
        points = []
        for point in points_of(config):
            points.append(point)
            if progress is not None:
                progress(len(points), config.steps * len(ways))
        metadata = {name: str(value) for name, value in config.model_dump(mode="json").items()}
        write_table(
            folder.partial / SENSITIVITY_NAMES[0], "sensitivity", [_row(config.over, p) for p in points], metadata
        )
        reaches = reaches_m(config)
        sentence = summary(config, reaches)
        figure = sensitivity_picture(config, points)
        with output_errors(target):
            for name in SENSITIVITY_NAMES[1:]:
                write_figure(figure, folder.partial / name)
        folder.publish(
            {
                "state": "complete",
                "command": "sensitivity",
                "versions": versions(),
                "configuration": config.model_dump(mode="json"),
                "summary": sentence,
                "reach_m": reaches,
            }
        )
    return SensitivityResult(target, sentence, reaches)


def sensitivity_picture(config: SensitivityConfig, points: Sequence[Point]) -> Figure:
    """The curves of a study."""
    what = varied(config)
    return sensitivity_figure(points, what.label, what.is_geometric, config.within, _title(config))


def _row(over: str, point: Point) -> tuple[Any, ...]:
    """A row of the table, in the order of its columns."""
    small = is_small(point.formula)
    ways = (point.formula, point.bound, point.trials)
    errors: list[Any] = []
    for quantity, name in (("direction", "direction_rad"), ("ttc_z", "ttc_z"), ("tcpa", "tcpa")):
        errors += [*(_value(way, name) for way in ways), small[quantity]]
    return (over, point.value, point.method.name, point.method.n_frames, point.case.distance_m, *errors)


def _value(errors: Errors, name: str) -> float:
    return float(getattr(errors, name))


def _title(config: SensitivityConfig) -> str:
    given = {
        "speed": f"{config.speed_km_h:g} km/h",
        "angle": f"{config.angle_deg:g} deg",
        "distance": f"{config.distance_m:g} m",
        "height": f"{config.height_m:g} m off the horizon",
        "focal": f"f = {config.focal_mm:g} mm at {config.pixel_pitch_um:g} um a pixel",
        "noise": f"{config.sigma_px:g} px",
        "rate": f"{config.frame_rate_hz:g} pictures/s",
        "baseline": f"stereo baseline {100 * config.baseline_m:g} cm",
    }
    given.pop(config.over)
    return ", ".join(given.values())
