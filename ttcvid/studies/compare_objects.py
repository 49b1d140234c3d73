"""Which objects and warnings of two results are the same ones, and which are missing or additional."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from ttcvid.model import SCENE_CLUSTER, Floats, Ints
from ttcvid.studies.compare_tolerance import EventTolerance, ObjectTolerance
from ttcvid.studies.matching import Matches, match_objects

LEAST_ROWS = 4
"""Rows of an object in a thinned baseline from which on a share of them says something."""
OTHER_OBJECT = 1_000_000
"""Added to the number of an object of the run that is none of the baseline: equal to no number there."""


@dataclass(frozen=True)
class JoinedObjects:
    """Objects of two results, matched frame by frame.

    ``pairs`` has the columns ``frame, baseline_id, run_id, baseline_row, run_row``: rows in the tables of objects that
    were given. ``complaints`` names counted objects that are missing, additional or have another number for a while.
    """

    pairs: pd.DataFrame
    complaints: tuple[str, ...]
    n_baseline: int
    n_run: int
    n_joined: int


def join_objects(
    baseline: pd.DataFrame, run: pd.DataFrame, tolerance: ObjectTolerance, frames_per_row: float = 1.0
) -> JoinedObjects:
    """Match the objects of two tables ``clusters`` (objects only, frames joined) by overlap in each frame.

    ``frames_per_row`` is how many frames of the clip one frame of the tables stands for: more than 1 for a baseline
    that holds some frames only.
    """
    matches = match_objects(baseline.assign(object_id=baseline.cluster_id), run)
    pairs = _pairs(matches)
    least_rows = tolerance.min_frames / frames_per_row
    if frames_per_row > 1:
        least_rows = max(least_rows, LEAST_ROWS)
    lives = _lives(baseline, pairs.baseline_row, least_rows, tolerance)
    others = _lives(run, pairs.run_row, least_rows, tolerance)
    complaints = [_complaint(life, "missing", tolerance) for life in lives.itertuples()]
    complaints += [_complaint(life, "additional", tolerance) for life in others.itertuples()]
    complaints += [_renamed(pairs, int(number), tolerance) for number in lives.cluster_id]
    found = int((lives.found_share >= tolerance.min_found).sum())
    return JoinedObjects(pairs, tuple(c for c in complaints if c), len(lives), len(others), found)


def baseline_numbers(tracks: pd.DataFrame, pairs: pd.DataFrame) -> Ints:
    """``cluster_id`` of each row of the run's ``collision_times`` in the baseline's numbers."""
    numbers = tracks.cluster_id.to_numpy(np.int64).copy()
    on_objects = np.flatnonzero(numbers > SCENE_CLUSTER)
    rows = pd.DataFrame({"frame": tracks.frame.to_numpy()[on_objects], "run_id": numbers[on_objects]})
    known = rows.merge(pairs[["frame", "run_id", "baseline_id"]], on=["frame", "run_id"], how="left").baseline_id
    numbers[on_objects] = known.fillna(rows.run_id + OTHER_OBJECT).to_numpy(np.int64)
    return numbers


def join_events(
    baseline: pd.DataFrame, run: pd.DataFrame, pairs: pd.DataFrame, tolerance: EventTolerance
) -> tuple[Ints, Ints, tuple[str, ...]]:
    """Rows of two tables ``events`` that are one warning, and the names of those that are on one side only.

    Warnings are one where they overlap in time (or miss each other by less than the shortest that counts); of several,
    the one of the same object is taken before others.
    """
    score = _event_overlap(baseline, run, tolerance.min_duration_s)
    objects = set(zip(pairs.baseline_id, pairs.run_id, strict=True))
    is_one_object = [[(i, j) in objects for j in run.cluster_id] for i in baseline.cluster_id]
    score *= 1.0 + np.array(is_one_object, float).reshape(score.shape)
    first, second = linear_sum_assignment(score, maximize=True)
    is_match = score[first, second] > 0
    first, second = first[is_match], second[is_match]
    complaints = [
        f"{_event_name(event)} is {what}"
        for table, joined, what in ((baseline, first, "missing"), (run, second, "additional"))
        for _, event in table.drop(index=table.index[joined]).iterrows()
        if event.end_s - event.start_s >= tolerance.min_duration_s
    ]
    return first, second, tuple(complaints)


def _event_overlap(baseline: pd.DataFrame, run: pd.DataFrame, margin_s: float) -> Floats:
    """Seconds ``(N, M)`` that two warnings have in common, and ``margin_s``; 0 where they have not even that."""
    start = np.maximum.outer(baseline.start_s.to_numpy(float), run.start_s.to_numpy(float))
    end = np.minimum.outer(baseline.end_s.to_numpy(float), run.end_s.to_numpy(float))
    return np.asarray(np.clip(end - start + margin_s, 0.0, None))


def _event_name(event: pd.Series) -> str:
    return (
        f"warning {event.kind} of object {event.cluster_id} (frames {event.start_frame}-{event.end_frame}, "
        f"{event.start_s:.3f}-{event.end_s:.3f} s)"
    )


def _lives(
    objects: pd.DataFrame, matched_rows: pd.Series, least_rows: float, tolerance: ObjectTolerance
) -> pd.DataFrame:
    """A row for each object that counts: where and when it is, and in which share of its frames it was matched."""
    table = objects.assign(is_matched=np.isin(np.arange(len(objects)), matched_rows))
    lives = table.groupby("cluster_id").agg(
        first=("frame", "min"),
        last=("frame", "max"),
        n_rows=("frame", "size"),
        n_tracks=("n_tracks", "median"),
        x_px=("ref_x_px", "median"),
        y_px=("ref_y_px", "median"),
        found_share=("is_matched", "mean"),
    )
    return lives[(lives.n_rows >= least_rows) & (lives.n_tracks >= tolerance.min_tracks)].reset_index()


def _complaint(life: Any, what: str, tolerance: ObjectTolerance) -> str:
    if life.found_share >= tolerance.min_found:
        return ""
    share = f"in {100 * (1 - life.found_share):.0f} % of its frames " if life.found_share > 0 else ""
    return (
        f"object {life.cluster_id} (frames {life.first}-{life.last}, around x {life.x_px:.0f} y {life.y_px:.0f} px, "
        f"{life.n_tracks:.0f} tracks) is {share}{what}"
    )


def _renamed(pairs: pd.DataFrame, number: int, tolerance: ObjectTolerance) -> str:
    """What to say of an object of the baseline that has several numbers in the run."""
    partners = pairs.loc[pairs.baseline_id == number, ["frame", "run_id"]]
    counts = partners.run_id.value_counts()
    if len(counts) < 2 or counts.iloc[0] >= tolerance.min_found * len(partners):
        return ""
    spans = partners.groupby("run_id").frame.agg(["min", "max"]).sort_values("min")
    names = ", ".join(f"{run_id} in frames {low}-{high}" for run_id, low, high in spans.itertuples())
    return f"object {number} does not keep one number in the run: it is {names}"


def _pairs(matches: Matches) -> pd.DataFrame:
    names = {"object_id": "baseline_id", "cluster_id": "run_id", "truth_row": "baseline_row", "found_row": "run_row"}
    return matches.pairs.rename(columns=names)
