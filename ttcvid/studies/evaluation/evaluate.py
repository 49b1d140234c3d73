"""A run held against a truth: all numbers of an evaluation, and those of each object."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from ttcvid.model import SCENE_CLUSTER, Bools, Floats, Ints
from ttcvid.studies.evaluation.collision_warnings import WarningsJudged, judge_warnings, object_of_events
from ttcvid.studies.evaluation.directions import (
    angle_deg,
    judge_directions,
    rotation_errors_deg,
    summary_of,
    true_scene_directions,
)
from ttcvid.studies.evaluation.grouping import judge_grouping, share_in_bodies
from ttcvid.studies.evaluation.matching import Matches, best_one_to_one, count_tracks, match_objects
from ttcvid.studies.evaluation.metrics import METRICS, Value
from ttcvid.studies.evaluation.times import TIMES, Numbers, judge_times
from ttcvid.studies.evaluation.truth import (
    BOX,
    DIRECTION,
    OBSERVATION,
    POSITION,
    UNKNOWN_OBJECT,
    VELOCITY,
    RunTables,
    Truth,
    columns_of,
    rows_of,
)

FOUND_SHARE = 0.5
"""An object is found if it is matched in this share of the frames in which it counts."""
MINUTES_10_S = 600.0
_TIME_COLUMNS = [f"{name}{end}_s" for name in TIMES for end in ("", "_lo", "_hi")]


@dataclass(frozen=True)
class Sight:
    """How much there was to see of a true object in the frames in which it counts.

    ``longest_side_px`` of its box, and ``most_tracks`` on it in one frame, at their largest; ``scene_share`` of its
    track rows belong to the static scene (None: no track). None for what the truth does not tell.
    """

    longest_side_px: Value
    most_tracks: int | None
    scene_share: Value


@dataclass(frozen=True)
class ObjectJudged:
    """One true object: how often it was found, how good its times are, what became of the warning, what there was.

    ``lead_s`` is the time from the first warning to the contact; None without warning or without collision.
    """

    object_id: int
    name: str
    n_frames: int
    found_share: float
    ttc_z_median: Value
    warning: str
    lead_s: Value
    sight: Sight


@dataclass(frozen=True)
class Evaluation:
    """``metrics`` has a value, or None, for each of ``METRICS``; ``objects`` one entry per true object that counts.

    ``joined`` has a row per frame and true object: ``frame, t_s, object_id, name, is_counted``, its true box, times,
    direction, place and velocity and, as ``*_found``, times and direction of what was matched with it (NaN: nothing).
    ``by_frame`` has a row per frame of the run: ``frame, rotation_deg, epipole_deg`` (errors of own motion, NaN: not
    judged or not found), ``is_epipole_judged`` and ``n_false``, the rows over nothing true. ``event_object`` has the
    true object that each warning is of, ``UNKNOWN_OBJECT`` for none.
    """

    metrics: dict[str, Value]
    objects: tuple[ObjectJudged, ...]
    joined: pd.DataFrame
    by_frame: pd.DataFrame
    event_object: Ints


def judge_run(run: RunTables, truth: Truth) -> Evaluation:
    """Hold a run against a truth, over the frames that the run has. Definitions: ``evaluation.metrics``."""
    numbers: dict[str, Numbers] = {"clip": _clip(run)}
    event_object = np.full(len(run.events), UNKNOWN_OBJECT)
    objects: tuple[ObjectJudged, ...] = ()
    joined = pd.DataFrame()
    by_frame = run.frames[["frame"]].assign(rotation_deg=np.nan, epipole_deg=np.nan, is_epipole_judged=False, n_false=0)
    if truth.frames is not None:
        rotation = rotation_errors_deg(truth.frames, run.frames)
        by_frame = _own_motion_errors(run, truth.frames, rotation)
        numbers["rotation"] = summary_of(rotation.rotation_deg.to_numpy(float))
        numbers["epipole_scene"] = summary_of(by_frame.epipole_deg[by_frame.is_epipole_judged].to_numpy(float))
    # The true point of each track row, -1 where there is none.
    point = None if truth.track_points is None else rows_of(run.collision_times, truth.track_points, OBSERVATION)
    if truth.track_object is not None:
        numbers["tracks"] = _tracks(run, truth, _counted_only(run, truth, truth.track_object), point)
    if truth.track_points is not None and point is not None:
        numbers |= _track_times(run, truth.track_points, point)
    if truth.objects is not None:
        true_objects = truth.objects[truth.objects.frame.isin(run.frames.frame)].reset_index(drop=True)
        found = _objects_found(run)
        matches = match_objects(true_objects, found, _tracks_on_objects(run, truth))
        joined = _join(true_objects, found, matches)
        numbers |= _times_and_directions(joined)
        numbers["objects"] = _objects(true_objects, found, matches, truth.has_all_objects, len(run.frames))
        warnings: WarningsJudged | None = None
        if truth.encounters is not None:
            warnings = _warnings(run, found, matches, true_objects, truth.encounters)
            numbers["events"], event_object = warnings.numbers, warnings.event_object
        objects = _each_object(joined, warnings, _sights(true_objects, run, truth.track_object))
        if truth.has_all_objects:
            n_false = found.frame[matches.verdict == "false"].value_counts()
            by_frame["n_false"] = by_frame.frame.map(n_false).fillna(0).to_numpy(np.int64)
    flat = {f"{group}.{name}": value for group, values in numbers.items() for name, value in values.items()}
    return Evaluation({name: _finite(flat.get(name)) for name in METRICS}, objects, joined, by_frame, event_object)


def _clip(run: RunTables) -> Numbers:
    t_s = run.frames.t_s.to_numpy(float)
    step_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    return {"frames": float(len(t_s)), "duration_s": float(t_s[-1] - t_s[0] + step_s) if len(t_s) else 0.0}


def _objects_found(run: RunTables) -> pd.DataFrame:
    """The objects of a run with their directions."""
    objects = run.clusters[run.clusters.role == "object"]
    row = rows_of(objects, run.epipoles, ("frame", "cluster_id"))
    directions = _rows_or_nan(columns_of(run.epipoles, DIRECTION), row)
    return objects.reset_index(drop=True).assign(**dict(zip(DIRECTION, directions.T, strict=True)))


def _tracks_on_objects(run: RunTables, truth: Truth) -> pd.DataFrame | None:
    if truth.track_object is None:
        return None
    tracks = run.collision_times
    return count_tracks(tracks.frame.to_numpy(), tracks.cluster_id.to_numpy(), truth.track_object)


def _counted_only(run: RunTables, truth: Truth, track_object: Ints) -> Ints:
    """The object of each track, unknown where the object does not count in that frame."""
    if truth.objects is None:
        return track_object
    tracks = pd.DataFrame({"frame": run.collision_times.frame, "object_id": track_object})
    is_ignored = rows_of(tracks, truth.objects[~truth.objects.is_counted], ("frame", "object_id")) >= 0
    return np.where(is_ignored, UNKNOWN_OBJECT, track_object)


def _tracks(run: RunTables, truth: Truth, object_of_track: Ints, point: Ints | None) -> Numbers:
    """How tracks are grouped; a displaced observation lies on nothing, whatever its object."""
    cluster_id, points = run.collision_times.cluster_id.to_numpy(), truth.track_points
    if point is None or points is None or "is_outlier" not in points:
        return judge_grouping(object_of_track, cluster_id)
    is_displaced = np.append(points.is_outlier.to_numpy(bool), False)[point]
    grouping = judge_grouping(np.where(is_displaced, UNKNOWN_OBJECT, object_of_track), cluster_id)
    return grouping | {"outliers_in": share_in_bodies(cluster_id, is_displaced)}


def _join(truth: pd.DataFrame, found: pd.DataFrame, matches: Matches) -> pd.DataFrame:
    """Every row of the truth beside what was matched with it."""
    columns = ["cluster_id", *_TIME_COLUMNS, *DIRECTION]
    partner = np.full(len(truth), -1)
    partner[matches.pairs.truth_row] = matches.pairs.found_row
    beside = _rows_or_nan(columns_of(found, columns), partner)
    kept = ["frame", "t_s", "object_id", "name", "is_counted", *BOX, *(f"{name}_s" for name in TIMES), *DIRECTION]
    kept += [*POSITION, *VELOCITY]
    values: dict[str, Any] = {name: truth.get(name, np.nan) for name in kept}
    values |= {f"{name}_found": column for name, column in zip(columns, beside.T, strict=True)}
    return pd.DataFrame(values | {"is_found": partner >= 0}, index=truth.index)


def _rows_or_nan(values: Floats, row: Ints) -> Floats:
    """Rows ``row (N,)`` of ``values (M, K)``, NaN for -1."""
    return np.vstack([values, np.full(values.shape[1], np.nan)])[row]


def _times_and_directions(joined: pd.DataFrame) -> dict[str, Numbers]:
    is_counted = joined.is_counted.to_numpy(bool)
    found = _found_times(joined)
    numbers = {name: judge_times(name, joined[f"{name}_s"].to_numpy(float), found, is_counted) for name in TIMES}
    numbers["epipole_objects"] = judge_directions(
        columns_of(joined, DIRECTION),
        columns_of(joined, [f"{axis}_found" for axis in DIRECTION]),
        is_counted & joined.is_found.to_numpy(bool),
    )
    return numbers


def _found_times(joined: pd.DataFrame) -> dict[str, Floats]:
    return {name: joined[f"{name}_found"].to_numpy(float) for name in _TIME_COLUMNS}


def _track_times(run: RunTables, points: pd.DataFrame, point: Ints) -> dict[str, Numbers]:
    """The times of tracks against those of the true points ``point (N,)``, over all rows that have a truth."""
    is_true = point >= 0
    found = {name: run.collision_times[name].to_numpy(float)[is_true] for name in _TIME_COLUMNS}
    all_rows = np.ones(int(is_true.sum()), bool)
    return {
        f"track_{name}": judge_times(name, points[f"{name}_s"].to_numpy(float)[point[is_true]], found, all_rows)
        for name in TIMES
    }


def _own_motion_errors(run: RunTables, frames: pd.DataFrame, rotation: pd.DataFrame) -> pd.DataFrame:
    """Errors of rotation and direction of each frame of a run, as in ``Evaluation.by_frame``."""
    frame = run.frames.frame.to_numpy()
    true = true_scene_directions(frames, frame)
    scene = run.epipoles[run.epipoles.cluster_id == SCENE_CLUSTER]
    direction, found = (_at_frames(frame, one.frame.to_numpy(), columns_of(one, DIRECTION)) for one in (true, scene))
    return pd.DataFrame(
        {
            "frame": frame,
            "rotation_deg": _at_frames(frame, rotation.frame.to_numpy(), columns_of(rotation, ["rotation_deg"]))[:, 0],
            "epipole_deg": angle_deg(direction, found),
            "is_epipole_judged": np.isfinite(direction).all(axis=1),
            "n_false": 0,
        }
    )


def _at_frames(frame: Ints, own: Ints, values: Floats) -> Floats:
    """Values ``(M, K)`` of frames ``own (M,)`` at those of a run ``(N,)``: ``(N, K)``, NaN where there are none."""
    _, here, there = np.intersect1d(frame, own, return_indices=True)
    result = np.full((len(frame), values.shape[1]), np.nan)
    result[here] = values[there]
    return result


def _objects(
    truth: pd.DataFrame, found: pd.DataFrame, matches: Matches, has_all_objects: bool, n_frames: int
) -> Numbers:
    is_counted = truth.is_counted.to_numpy(bool)
    is_found = np.isin(np.arange(len(truth)), matches.pairs.truth_row)
    shares = pd.Series(is_found[is_counted]).groupby(truth.object_id[is_counted].to_numpy()).mean()
    pairs = matches.pairs[is_counted[matches.pairs.truth_row]]
    own = best_one_to_one(pairs.object_id.to_numpy(), pairs.cluster_id.to_numpy())
    has_own = [own.get(int(o)) == int(c) for o, c in zip(pairs.object_id, pairs.cluster_id, strict=True)]
    numbers = {
        "total": float(len(shares)),
        "found": float((shares >= FOUND_SHARE).sum()),
        "missed": float((shares < FOUND_SHARE).sum()),
        "share": _share(is_found[is_counted]),
        "one_id": _share(np.array(has_own, dtype=bool)),
        "doubles_per_frame": float((matches.verdict == "double").sum() / max(n_frames, 1)),
    }
    if has_all_objects:
        is_false = matches.verdict == "false"
        numbers["false"] = float((pd.Series(is_false).groupby(found.cluster_id.to_numpy()).mean() > 0.5).sum())
        numbers["false_per_frame"] = float(is_false.sum() / max(n_frames, 1))
    return numbers


def _warnings(
    run: RunTables, found: pd.DataFrame, matches: Matches, truth: pd.DataFrame, encounters: pd.DataFrame
) -> WarningsJudged:
    event_object = object_of_events(run.events, found, matches.owner)
    counted = truth[truth.is_counted.astype(bool)]
    first = counted.groupby("object_id").t_s.min()
    first_seen_s = dict(zip(first.index.astype(int), first.astype(float), strict=True))
    end_s = float(run.frames.t_s.max())
    judged = judge_warnings(run.events, event_object, encounters, first_seen_s, end_s)
    ten_minutes = _clip(run)["duration_s"] / MINUTES_10_S
    rates = {
        f"{name}_per_10min": judged.numbers[name] / ten_minutes if ten_minutes > 0 else math.nan
        for name in ("true", "missed", "false")
    }
    return replace(judged, numbers=judged.numbers | rates)


def _sights(objects: pd.DataFrame, run: RunTables, track_object: Ints | None) -> dict[int, Sight]:
    """What there was to see of each true object, in the frames in which it counts."""
    counted = objects[objects.is_counted.astype(bool)]
    number = counted.object_id.to_numpy()
    x0, y0, x1, y1 = columns_of(counted, BOX).T
    side_px = np.fmax(x1 - x0, y1 - y0)
    longest_px = {int(one): _finite(float(np.fmax.reduce(side_px[number == one]))) for one in np.unique(number)}
    if track_object is None:
        return {one: Sight(longest, None, None) for one, longest in longest_px.items()}
    tracks = pd.DataFrame({"frame": run.collision_times.frame, "object_id": track_object})
    on_object = np.where(rows_of(tracks, counted, ("frame", "object_id")) >= 0, track_object, UNKNOWN_OBJECT)
    frame, is_scene = tracks.frame.to_numpy(), run.collision_times.cluster_id.to_numpy() == SCENE_CLUSTER
    sights = {}
    for one, longest in longest_px.items():
        own = on_object == one
        most = int(np.unique(frame[own], return_counts=True)[1].max(initial=0))
        sights[one] = Sight(longest, most, _finite(_share(is_scene[own])))
    return sights


def _each_object(
    joined: pd.DataFrame, warnings: WarningsJudged | None, sights: dict[int, Sight]
) -> tuple[ObjectJudged, ...]:
    judged = []
    for object_id, rows in joined[joined.is_counted.astype(bool)].groupby("object_id"):
        times = judge_times("ttc_z", rows.ttc_z_s.to_numpy(float), _found_times(rows), np.ones(len(rows), bool))
        number = int(str(object_id))
        judged.append(
            ObjectJudged(
                object_id=number,
                name=str(rows["name"].iloc[0]),
                n_frames=len(rows),
                found_share=float(rows.is_found.mean()),
                ttc_z_median=_finite(times["median"]),
                warning="" if warnings is None else warnings.verdict.get(number, ""),
                lead_s=None if warnings is None else warnings.lead_s.get(number),
                sight=sights[number],
            )
        )
    return tuple(judged)


def _share(values: Bools) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def _finite(value: float | None) -> Value:
    return None if value is None or not math.isfinite(value) else value
