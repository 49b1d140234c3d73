"""A run and a truth folder, read and held against each other."""

from __future__ import annotations

import json
import logging
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ttcvid.calibration import read_camera_image_size
from ttcvid.errors import InputError
from ttcvid.jobs.runs.addresses import address
from ttcvid.jobs.runs.provenance import digest_of
from ttcvid.jobs.runs.run import Run
from ttcvid.model import ImageSize, Ints
from ttcvid.plain_files import open_plain
from ttcvid.report.evaluation_page import Curve, Metric, evaluation_page
from ttcvid.sinks.whole_text import write_whole
from ttcvid.sources.images import read_picture
from ttcvid.studies.evaluation.evaluate import Evaluation, judge_run
from ttcvid.studies.evaluation.metrics import METRICS
from ttcvid.studies.evaluation.truth import (
    BOX,
    DIRECTION,
    OBSERVATION,
    POINT,
    POSITION,
    ROTATION,
    UNKNOWN_OBJECT,
    VELOCITY,
    RunTables,
    Truth,
    object_at,
    objects_from_tracks,
    plain,
    rows_of,
    with_counted,
)
from ttcvid.studies.evaluation.wording import describe_object, describe_value

_LOG = logging.getLogger(__name__)

REQUIRED_COLUMNS = {
    "truth_objects": ["frame", "t_s", "object_id", *BOX],
    "truth_frames": ["frame", "t_s", *ROTATION, *DIRECTION],
    "truth_encounters": ["object_id", "is_collision", "t_contact_s"],
    "truth_tracks": ["frame", "track_id", "object_id", *POINT, *POSITION, *VELOCITY, "tcpa_s", "miss_s", "ttc_z_s"],
}
"""Tables of a truth and what each has to hold; other columns of the simulator's tables may be missing."""
CAMERA_NAME = "camera.yaml"
CLIP_NAMES = {"clip.mp4": "video", "tracks.parquet": "tracks"}
"""What a simulation is analysed by, and the kind of source that it is."""
LABELS_NAME = "truth_labels"
MAX_CLOCK_DIFFERENCE = 0.5
"""In frames: a larger difference between the times of run and truth means that they are not of the same clip."""


@dataclass(frozen=True)
class EvaluatedRun:
    """The evaluation of one run beside one truth, and where both are."""

    run: Run
    truth: Path
    evaluation: Evaluation

    def as_json(self) -> str:
        """All metrics (null: the truth says nothing of it) and every object, as one JSON object."""
        content = {
            "run": str(self.run.folder),
            "truth": str(self.truth),
            "metrics": self.evaluation.metrics,
            "objects": [asdict(judged) for judged in self.evaluation.objects],
        }
        return json.dumps(content, allow_nan=False)


def evaluate(run: str | Path | Run, truth: str | Path) -> EvaluatedRun:
    """Hold a run against the truth of its clip.

    Parameters
    ----------
    run : The output folder of an analysis, or what ``ttcvid.analyze`` returned.
    truth : The folder of ``ttcvid simulate``, or one with tables of the same names and columns; one table is enough.

    Returns
    -------
    `EvaluatedRun`: its ``evaluation`` has the metrics (docs/evaluation.md) and what became of each true object.

    Raises
    ------
    InputError
        Run or truth cannot be read, or are not of the same clip.
    """
    opened = run if isinstance(run, Run) else Run.open(run)
    _check_clip(opened, Path(truth))
    tables = read_run_tables(opened)
    return EvaluatedRun(opened, Path(truth), judge_run(tables, read_truth(Path(truth), tables)))


def write_page(result: EvaluatedRun, path: Path) -> None:
    """Write the evaluation as an HTML page; OutputError where that cannot be done."""
    title = f"{result.run.folder} beside {result.truth}"
    evaluation = result.evaluation
    metrics = [
        Metric(name, describe_value(name, value), METRICS[name][1])
        for name in METRICS
        if (value := evaluation.metrics[name]) is not None
    ]
    curves = [
        _curve(describe_object(judged), evaluation.joined[evaluation.joined.object_id == judged.object_id])
        for judged in evaluation.objects
    ]
    report = None if result.run.report is None else address(result.run.report, path)
    write_whole(path, evaluation_page(title, metrics, curves, report))


def _curve(heading: str, rows: pd.DataFrame) -> Curve:
    times = ("ttc_z_s", "ttc_z_s_found", "ttc_z_hi_s_found", "ttc_z_lo_s_found")
    with np.errstate(divide="ignore"):
        true_hz, found_hz, low_hz, high_hz = (1 / rows[name].to_numpy(float) for name in times)
    return Curve(heading, rows.t_s.to_numpy(float), true_hz, found_hz, low_hz, high_hz)


def read_run_tables(run: Run) -> RunTables:
    """The tables of a run in ordinary types."""
    names = ("frames", "clusters", "epipoles", "collision_times", "events")
    remedy = "run 'ttcvid analyze' again"
    return RunTables(**{name: _read_plain(run.folder / f"{name}.parquet", remedy) for name in names})


def read_truth(folder: Path, run: RunTables) -> Truth:
    """The truth in a folder, with the true object of each track row of the run where labels or true tracks tell it."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder: expected the folder of 'ttcvid simulate', or one with its tables")
    tables = {name: _read_table(folder, name) for name in REQUIRED_COLUMNS}
    frames, objects, points = tables["truth_frames"], tables["truth_objects"], tables["truth_tracks"]
    if frames is None and objects is None and points is None:
        raise InputError(
            f"{folder}: holds no truth: expected one of {', '.join(f'{n}.parquet' for n in REQUIRED_COLUMNS)}, "
            "as written by 'ttcvid simulate'"
        )
    for name, table in (("truth_frames", frames), ("truth_objects", objects)):
        if table is not None and not table.empty:
            _check_clock(folder / f"{name}.parquet", table, run.frames)
    if objects is not None:
        objects = with_counted(_named(objects))
    elif points is not None and frames is not None:
        objects = objects_from_tracks(points, frames, _names(tables["truth_encounters"]))
    if points is not None:
        track_object: Ints | None = _objects_of_points(run.collision_times, points)
    else:
        track_object = _objects_of_labels(run.collision_times, folder / LABELS_NAME)
    return Truth(objects, frames, tables["truth_encounters"], points, track_object)


def _read_table(folder: Path, name: str) -> pd.DataFrame | None:
    path = folder / f"{name}.parquet"
    if not path.exists():
        return None
    table = _read_plain(path, "simulate the scene again")
    missing = [column for column in REQUIRED_COLUMNS[name] if column not in table]
    if missing:
        raise InputError(f"{path}: column {missing[0]!r} is missing: expected {', '.join(REQUIRED_COLUMNS[name])}")
    return table


def _read_plain(path: Path, remedy: str) -> pd.DataFrame:
    """A table in ordinary types; InputError, which says the ``remedy``, where it cannot be read."""
    try:
        with open_plain(path) as file:
            return plain(pq.read_table(file))
    except (OSError, pa.ArrowInvalid) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as a table ({reason}): {remedy}") from None


def _check_clock(path: Path, truth: pd.DataFrame, frames: pd.DataFrame) -> None:
    _, row, true_row = np.intersect1d(frames.frame, truth.frame, return_indices=True)
    if not len(row):
        raise InputError(f"{path}: has no frame in common with the run: give the truth of the clip that was analysed")
    step_s = float(np.median(np.diff(frames.t_s))) if len(frames) > 1 else np.inf
    t_s, true_s = frames.t_s.to_numpy()[row], truth.t_s.to_numpy()[true_row]
    worst = int(np.abs(t_s - true_s).argmax())
    if abs(t_s[worst] - true_s[worst]) > MAX_CLOCK_DIFFERENCE * step_s:
        raise InputError(
            f"{path}: frame {frames.frame.iloc[row[worst]]} is at t_s = {true_s[worst]:.3f} s, but at "
            f"{t_s[worst]:.3f} s in the run: give the truth of the clip that was analysed"
        )


def _check_clip(run: Run, truth: Path) -> None:
    """InputError where the truth is of another picture size; a warning where its folder holds another clip."""
    if (camera := truth / CAMERA_NAME).is_file():
        true_size, size = read_camera_image_size(camera), ImageSize(**run.manifest["image_size"])
        if true_size is not None and true_size != size:
            raise InputError(
                f"{camera}: is of pictures of {true_size}, the run {run.folder} of {size}: "
                "give the truth of the clip that was analysed"
            )
    analyzed = run.manifest["input"]
    for name, kind in CLIP_NAMES.items():
        clip = truth / name
        if kind != analyzed["kind"] or analyzed["n_files"] != 1 or not clip.is_file():
            continue
        if digest_of((clip,)).sha256 != analyzed["sha256"]:
            _LOG.warning(
                "%s is not the file that the run %s was made of: the figures mean something only if both show the same",
                clip,
                run.folder,
            )


def _named(objects: pd.DataFrame) -> pd.DataFrame:
    if "name" in objects:
        return objects
    return objects.assign(name=[f"object {object_id}" for object_id in objects.object_id])


def _names(encounters: pd.DataFrame | None) -> dict[int, str]:
    if encounters is None or "name" not in encounters:
        return {}
    return dict(zip(encounters.object_id.astype(int), encounters["name"].astype(str), strict=True))


def _objects_of_points(tracks: pd.DataFrame, points: pd.DataFrame) -> Ints:
    row = rows_of(tracks, points, OBSERVATION)
    return np.where(row >= 0, np.append(points.object_id.to_numpy(np.int64), UNKNOWN_OBJECT)[row], UNKNOWN_OBJECT)


def _objects_of_labels(tracks: pd.DataFrame, folder: Path) -> Ints | None:
    """The object that the picture of labels shows at each track row; None where there are no labels."""
    if not folder.is_dir():
        return None
    result = np.full(len(tracks), UNKNOWN_OBJECT)
    frame, xy_px = tracks.frame.to_numpy(), tracks[["x_px", "y_px"]].to_numpy(float)
    for index in np.unique(frame):
        path = folder / f"{index:06d}.png"
        if not path.exists():
            raise InputError(f"{path}: is missing: give the truth of the clip that was analysed, or simulate it again")
        labels = read_picture(path)
        if labels is None or labels.ndim != 2:
            raise InputError(f"{path}: cannot be read as a picture of labels: simulate the scene again")
        rows = frame == index
        result[rows] = object_at(labels, xy_px[rows])
    return result
