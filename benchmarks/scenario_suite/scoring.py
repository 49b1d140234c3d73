"""One analysed scene beside its truth: what there was to be found, and what became of it.

A score is kept beside the run (``score/``) and is made anew when the run or the code that judges has changed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import ttcvid
from scenario_suite.drawing import code_digest, read_json, write_json
from ttcvid.jobs.evaluate import read_run_tables, read_truth
from ttcvid.model import SCENE_CLUSTER, Bools, Floats
from ttcvid.simulate.scene import OwnMotion
from ttcvid.studies.evaluation.directions import angle_deg
from ttcvid.studies.evaluation.evaluate import Evaluation, judge_run
from ttcvid.studies.evaluation.times import TIME_RANGE_S, TIMES, is_within, relative_error_of_eta
from ttcvid.studies.evaluation.truth import (
    BOX,
    DIRECTION,
    OBSERVATION,
    POSITION,
    VELOCITY,
    RunTables,
    Truth,
    columns_of,
    rows_of,
)

LEAST_SIZE_PX = 24.0
"""An object has to be found where it is larger than this: the geometric mean of its visible box's sides."""
MOTION_SIGMAS, MOTION_WINDOW_S = 3.0, 0.5
"""It moves if its own motion shifts it in the picture, or its outline, by so many sigmas within this time, or since it
came in view."""
PICTURE_SIGMA_PX, LEAST_SIGMA_PX = 0.2, 0.1
"""What a tracked corner errs by in pictures; the least for tables of tracks, those without noise too."""
LEAST_SPEED_M_S, _LEAST_DEPTH_M = 0.2, 1e-3
REACHES_US_S = 3.0
"""What stands in our way has to be found from this long before the contact."""
_OWN_RADIUS_M = OwnMotion().radius_m
"""Of what carries the camera, in all families."""
_LEAST_SPEED2 = 1e-9
"""As a divisor, m^2/s^2."""
_STUDIES = Path(ttcvid.__file__).parent / "studies"


@dataclass(frozen=True)
class SceneScore:
    """What is to be said of one scene.

    ``facts`` is ``scenario.json`` with ``exit_code, seconds, error`` of the run and the sums of ``_sums``.
    ``object_frames`` has a row per frame and true object: ``frame, object_id, is_wanted`` (`wanted`), ``is_due``
    (wanted and large enough), ``is_found, size_px, distance_m, direction_deg`` and, of each time, ``*_error``
    (relative error of 1/time, NaN: not judged or no value) and ``*_within`` (the 90 % interval holds the truth).
    ``frames`` has a row per frame: ``frame, status, n_false, rotation_deg, epipole_deg``; of tables of tracks also what
    `scene_tracks` says.
    Both tables are empty where the analysis failed.
    """

    facts: Mapping[str, Any]
    object_frames: pd.DataFrame
    frames: pd.DataFrame
    folder: Path

    @property
    def name(self) -> str:
        """Family and seed."""
        return str(self.facts["name"])


def score(folder: Path) -> SceneScore:
    """The score of a finished scene, made unless it is there."""
    place = keep_score(folder)
    tables = (pd.read_parquet(place / f"{name}.parquet") for name in ("object_frames", "frames"))
    return SceneScore(read_json(place / "facts.json"), *tables, folder)


def keep_score(folder: Path) -> Path:
    """The folder of the score of a finished scene, made unless it is there."""
    run, place = read_json(folder / "run.json"), folder / "score"
    key = hashlib.sha256((str(run["key"]) + _judging_code()).encode()).hexdigest()
    known = read_json(place / "facts.json")
    if known.get("key") != key:
        facts = read_json(folder / "scenario.json") | {name: run[name] for name in ("exit_code", "seconds", "error")}
        made = _scored(folder, facts)
        place.mkdir(exist_ok=True)
        (place / "facts.json").unlink(missing_ok=True)
        made.object_frames.to_parquet(place / "object_frames.parquet")
        made.frames.to_parquet(place / "frames.parquet")
        write_json(place / "facts.json", {"key": key, **made.facts})
    return place


def _judging_code() -> str:
    return code_digest(_STUDIES) + code_digest(Path(__file__))


def _scored(folder: Path, facts: dict[str, Any]) -> SceneScore:
    if facts["exit_code"] != 0:
        return SceneScore(facts, pd.DataFrame(), pd.DataFrame(), folder)
    tables = read_run_tables(ttcvid.Run.open(folder / "run"))
    truth = read_truth(folder / "truth", tables)
    evaluation = judge_run(tables, truth)
    is_table = facts["kind"] == "tracks"
    sigma_px = max(facts["nuisances"]["track_noise_px"], LEAST_SIGMA_PX) if is_table else PICTURE_SIGMA_PX
    rows, focal_px = evaluation.joined, float(facts["true_focal_px"])
    if len(rows):
        rows = judged_rows(rows, wanted(rows, truth, focal_px, sigma_px))
    by_frame = evaluation.by_frame.assign(status=tables.frames.status.astype(str))
    by_frame.loc[~by_frame.is_epipole_judged, "epipole_deg"] = np.nan
    if truth.track_points is not None:
        by_frame = by_frame.merge(scene_tracks(tables.collision_times, truth.track_points), on="frame", how="left")
    return SceneScore(facts | _sums(evaluation, truth, tables, focal_px), rows, by_frame, folder)


def scene_tracks(tracks: pd.DataFrame, points: pd.DataFrame) -> pd.DataFrame:
    """How good the ttc_z of tracks of the static scene is in each frame that tells any.

    Parameters
    ----------
    tracks : ``collision_times`` of a run.
    points : ``truth_tracks``; its outliers do not count.

    Returns
    -------
    ``frame``, ``scene_ttc_z_error`` the median error, as ``*_error`` of `SceneScore`, and of how many tracks
    (``n_scene_ttc_z``) the 90 % interval holds the truth (``n_scene_ttc_z_within``).
    """
    point = rows_of(tracks, points, OBSERVATION)
    true = points.iloc[point].reset_index(drop=True)
    is_scene = (point >= 0) & (true.object_id == SCENE_CLUSTER).to_numpy() & ~true.is_outlier.to_numpy(bool)
    true_s, value_s = true.ttc_z_s.to_numpy(float), tracks.ttc_z_s.to_numpy(float)
    is_judged = is_scene & np.isfinite(value_s)
    is_judged &= (np.abs(true_s) >= TIME_RANGE_S[0]) & (np.abs(true_s) <= TIME_RANGE_S[1])
    bounds_s = (tracks[f"ttc_z_{end}_s"].to_numpy(float) for end in ("lo", "hi"))
    judged = pd.DataFrame(
        {
            "frame": tracks.frame.to_numpy(),
            "error": np.abs(relative_error_of_eta(true_s, value_s)),
            "is_within": is_within("ttc_z", true_s, *bounds_s),
        }
    )[is_judged].groupby("frame")
    return pd.DataFrame(
        {
            "scene_ttc_z_error": judged.error.median(),
            "n_scene_ttc_z": judged.size(),
            "n_scene_ttc_z_within": judged.is_within.sum(),
        }
    ).reset_index()


def wanted(rows: pd.DataFrame, truth: Truth, focal_px: float, sigma_px: float) -> Bools:
    """Which rows ``(N,)`` of ``Evaluation.joined`` have an object that has to be found if it is large enough.

    It counts for ``ttcvid evaluate``, and moves over the ground by more than the noise of tracks, or is about to be
    hit.
    """
    assert truth.frames is not None
    assert truth.encounters is not None
    own = own_velocity_m_s(truth.frames).loc[rows.frame.to_numpy()].to_numpy(float)
    place, over_ground = columns_of(rows, POSITION), columns_of(rows, VELOCITY) + own
    seen_for_s = (rows.t_s - rows.groupby("object_id").t_s.transform("min")).to_numpy(float)
    growth_px_s = 0.5 * size_px(rows) * np.abs(over_ground[:, 2]) / np.maximum(place[:, 2], _LEAST_DEPTH_M)
    flow_px_s = np.hypot(focal_px * _image_flow_hz(place, over_ground), growth_px_s)
    shift_px = flow_px_s * np.minimum(seen_for_s, MOTION_WINDOW_S)
    is_moving = np.linalg.norm(over_ground, axis=1) > LEAST_SPEED_M_S
    hits = truth.encounters[truth.encounters.is_collision.astype(bool)].set_index("object_id").t_contact_s
    until_s = rows.object_id.map(hits).to_numpy(float) - rows.t_s.to_numpy(float)
    is_reaching_us = (until_s > 0.0) & (until_s < REACHES_US_S)
    is_seen_moving = is_moving & (shift_px > MOTION_SIGMAS * sigma_px)
    return np.asarray(rows.is_counted.to_numpy(bool) & (is_seen_moving | is_reaching_us))


def size_px(rows: pd.DataFrame) -> Floats:
    """Geometric mean ``(N,)`` of the sides of the true box."""
    x0, y0, x1, y1 = columns_of(rows, BOX).T
    return np.asarray(np.sqrt(np.maximum(x1 - x0, 0.0) * np.maximum(y1 - y0, 0.0)))


def is_on_course(rows: pd.DataFrame, focal_px: float) -> Bools:
    """Which rows ``(N,)`` of ``Evaluation.joined`` have an object that touches us if both of us keep our velocities.

    The object is as wide and as high as its box, with the middle of its nearest surface in the middle, and has no
    depth. It counts however late it touches us.
    """
    place, velocity = columns_of(rows, POSITION), columns_of(rows, VELOCITY)
    until_s = -np.sum(place * velocity, axis=1) / np.maximum(np.sum(velocity**2, axis=1), _LEAST_SPEED2)
    nearest = np.abs(place + until_s[:, None] * velocity)
    x0, y0, x1, y1 = columns_of(rows, BOX).T
    half_m = np.column_stack([x1 - x0, y1 - y0, np.zeros(len(rows))]) * (0.5 * place[:, 2:] / focal_px)
    apart_m = np.linalg.norm(np.maximum(nearest - half_m, 0.0), axis=1)
    return np.asarray((until_s > 0.0) & (apart_m < _OWN_RADIUS_M))


def on_course_since_s(rows: pd.DataFrame, focal_px: float) -> pd.Series:
    """The time from which on all rows of an object are on course, by ``object_id``; none where the last one is not."""
    if not len(rows):
        return pd.Series(dtype=float)
    is_on = pd.Series(is_on_course(rows, focal_px), index=rows.index)
    # Where it is beside us already, its closest approach lies behind.
    later = rows[(rows[POSITION[2]] > _OWN_RADIUS_M) | is_on].sort_values("t_s", ascending=False)
    lasts = is_on.reindex(later.index).groupby(later.object_id).cummin().astype(bool)
    return later[lasts].groupby("object_id").t_s.min()


def n_averted(evaluation: Evaluation, events: pd.DataFrame, hit: list[int], focal_px: float) -> int:
    """How many warnings are of an object that was on course when they began, but is none of those ``hit``."""
    rows, event_object = evaluation.joined, evaluation.event_object
    if not len(rows):
        return 0
    on_course = rows[is_on_course(rows, focal_px) & ~rows.object_id.isin(hit).to_numpy()]
    began = set(zip(on_course.object_id.astype(int), on_course.frame.astype(int), strict=True))
    return sum(one in began for one in zip(event_object.tolist(), events.start_frame.tolist(), strict=True))


def own_velocity_m_s(frames: pd.DataFrame) -> pd.DataFrame:
    """Own velocity at each frame, by its number: the middle of the mean ones before and after it."""
    before = frames.set_index("frame")[VELOCITY]
    after = before.shift(-1)
    return (0.5 * (before.fillna(after) + after.fillna(before))).fillna(0.0)


def _image_flow_hz(place: Floats, velocity: Floats) -> Floats:
    """Speed ``(N,)`` in the picture plane at focal length 1 of points ``(N, 3)`` that move by ``velocity (N, 3)``."""
    depth = np.maximum(place[:, 2], _LEAST_DEPTH_M)
    across = velocity[:, :2] - velocity[:, 2:] * place[:, :2] / depth[:, None]
    return np.asarray(np.linalg.norm(across, axis=1) / depth)


def judged_rows(rows: pd.DataFrame, is_wanted: Bools) -> pd.DataFrame:
    """The object-frames of a scene, as ``SceneScore`` has them."""
    sides_px = size_px(rows)
    columns: dict[str, Any] = {
        "frame": rows.frame,
        "object_id": rows.object_id,
        "is_wanted": is_wanted,
        "is_due": is_wanted & (sides_px > LEAST_SIZE_PX),
        "is_found": rows.is_found.astype(bool),
        "size_px": sides_px,
        "distance_m": np.linalg.norm(columns_of(rows, POSITION), axis=1),
        "direction_deg": angle_deg(
            columns_of(rows, DIRECTION), columns_of(rows, [f"{axis}_found" for axis in DIRECTION])
        ),
    }
    for name in TIMES:
        true_s, value_s, lo_s, hi_s = (
            rows[column].to_numpy(float)
            for column in (f"{name}_s", f"{name}_s_found", f"{name}_lo_s_found", f"{name}_hi_s_found")
        )
        in_range = (np.abs(true_s) >= TIME_RANGE_S[0]) & (np.abs(true_s) <= TIME_RANGE_S[1])
        is_judged = in_range & np.isfinite(value_s)
        columns[f"{name}_error"] = np.where(is_judged, relative_error_of_eta(true_s, value_s), np.nan)
        columns[f"{name}_within"] = is_judged & is_within(name, true_s, lo_s, hi_s)
    return pd.DataFrame(columns).reset_index(drop=True)


def _sums(evaluation: Evaluation, truth: Truth, tables: RunTables, focal_px: float) -> dict[str, Any]:
    """Counts of a scene that are no rows: labels of tracks, outliers, warnings."""
    metrics = evaluation.metrics
    n_tracks, n_outliers = metrics["tracks.n"] or 0.0, 0.0
    if truth.track_points is not None:
        points = truth.track_points[truth.track_points.is_outlier.astype(bool)]
        n_outliers = float(np.sum(rows_of(points, tables.collision_times, OBSERVATION) >= 0))
    assert truth.encounters is not None
    hits = truth.encounters[truth.encounters.is_collision.astype(bool)].set_index("object_id").t_contact_s
    large = evaluation.joined[size_px(evaluation.joined) > LEAST_SIZE_PX] if len(evaluation.joined) else pd.DataFrame()
    large_since_s = large.groupby("object_id").t_s.min() if len(large) else pd.Series(dtype=float)
    large_for_s = (hits - large_since_s.reindex(hits.index)).fillna(0.0)
    before = large[large.t_s < large.object_id.map(hits)] if len(large) else large
    on_course_for_s = (hits - on_course_since_s(before, focal_px).reindex(hits.index)).fillna(0.0)
    warnings = [
        {
            "verdict": judged.warning,
            "lead_s": judged.lead_s,
            "large_for_s": float(large_for_s[judged.object_id]),
            "on_course_for_s": float(on_course_for_s[judged.object_id]),
        }
        for judged in evaluation.objects
        if judged.object_id in hits.index
    ]
    return {
        "n_labels": n_tracks,
        "n_labels_wrong": n_tracks * (1.0 - (metrics["tracks.right"] or 0.0)),
        "n_outliers": n_outliers,
        "n_outliers_in": n_outliers * (metrics["tracks.outliers_in"] or 0.0),
        "analysed_s": metrics["clip.duration_s"],
        "false_warnings": metrics["events.false"] or 0.0,
        "averted_warnings": float(n_averted(evaluation, tables.events, list(hits.index), focal_px)),
        "false_ids": metrics["objects.false"] or 0.0,
        "warnings": warnings,
        "n_objects_told": int(tables.clusters[tables.clusters.role == "object"].cluster_id.nunique()),
    }
