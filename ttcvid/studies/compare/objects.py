"""Which objects and warnings of two results are the same ones, and which are missing or additional."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from ttcvid.config import BodiesConfig, EventsConfig
from ttcvid.errors import counted
from ttcvid.model import APPROACHING, SCENE_CLUSTER, Bools, Floats, Ints
from ttcvid.studies.compare.tolerance import EventTolerance, ObjectTolerance
from ttcvid.studies.evaluation.matching import Matches, match_objects

LEAST_ROWS = 4
"""Rows of an object in a thinned baseline from which on a share of them says something."""
PERSISTENCE_S, LEAST_TRACKS = EventsConfig().persistence_s, BodiesConfig().min_tracks
"""For so long, s, and with so many tracks an object has to approach for sure before its time says how near it is."""
_ROUNDING_S = 1e-9
OTHER_OBJECT = 1_000_000
"""Added to the number of an object of the run that is none of the baseline: equal to no number there."""


@dataclass(frozen=True)
class JoinedObjects:
    """Objects of two results, matched frame by frame.

    ``pairs`` has the columns ``frame, baseline_id, run_id, baseline_row, run_row``: rows in the tables of objects that
    were given. ``counted`` and ``counted_run`` are the numbers of the objects that count by themselves. ``complaints``
    names those of them that are missing, additional or have another number for a while, and says where too many of the
    others come or go.
    """

    pairs: pd.DataFrame
    complaints: tuple[str, ...]
    n_baseline: int
    n_run: int
    counted: tuple[int, ...]
    counted_run: tuple[int, ...]
    n_found: int


def join_objects(
    baseline: pd.DataFrame,
    run: pd.DataFrame,
    tolerance: ObjectTolerance,
    frames_per_row: float = 1.0,
    warned: tuple[Collection[int], Collection[int]] = ((), ()),
) -> JoinedObjects:
    """Match the objects of two tables ``clusters`` (objects only, frames joined) by overlap in each frame.

    ``frames_per_row`` is how many frames of the clip one frame of the tables stands for: more than 1 for a baseline
    that holds some frames only. ``warned`` are the numbers of the objects of both that carry a warning.
    """
    matches = match_objects(baseline.assign(object_id=baseline.cluster_id), run)
    pairs = _pairs(matches)
    is_thinned = frames_per_row > 1
    least_rows = tolerance.min_frames / frames_per_row
    if is_thinned:
        least_rows = max(least_rows, LEAST_ROWS)
    lives = _lives(baseline, pairs.baseline_row, least_rows, warned[0], tolerance)
    others = _lives(run, pairs.run_row, least_rows, warned[1], tolerance)
    judged, judged_run = lives[lives.counts], others[others.counts]
    complaints = [_complaint(life, "missing", tolerance) for life in judged.itertuples()]
    complaints += [_complaint(life, "additional", tolerance) for life in judged_run.itertuples()]
    complaints += [_renamed(pairs, int(number), tolerance) for number in judged.cluster_id]
    if not is_thinned:
        complaints.append(_all_gone(lives, others, tolerance) or _rate_complaint(lives, others, tolerance))
    return JoinedObjects(
        pairs,
        tuple(c for c in complaints if c),
        len(lives),
        len(others),
        tuple(judged.cluster_id),
        tuple(judged_run.cluster_id),
        int((judged.found_share >= tolerance.min_found).sum()),
    )


def objects_that_count(
    objects: pd.DataFrame, least_rows: float, warned: Collection[int], tolerance: ObjectTolerance
) -> list[int]:
    """Numbers of the objects that count by themselves, of a table ``clusters`` with objects only."""
    lives = _lives(objects, pd.Series(dtype=np.int64), least_rows, warned, tolerance)
    return [int(number) for number in lives.cluster_id[lives.counts]]


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
    known = set(pairs.baseline_id)
    for i, j in zip(first, second, strict=True):
        one, other = baseline.iloc[i], run.iloc[j]
        if one.cluster_id in known and (one.cluster_id, other.cluster_id) not in objects:
            complaints.append(f"{_event_name(one)} is of object {other.cluster_id} in the run, which is another one")
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
    objects: pd.DataFrame,
    matched_rows: pd.Series,
    least_rows: float,
    warned: Collection[int],
    tolerance: ObjectTolerance,
) -> pd.DataFrame:
    """A row for each object: where and when it is, in which share of its frames it was matched, whether it counts."""
    table = objects.assign(
        is_matched=np.isin(np.arange(len(objects)), matched_rows),
        x_px=(objects.x0_px + objects.x1_px) / 2,
        y_px=(objects.y0_px + objects.y1_px) / 2,
        is_near=_are_near(objects, tolerance.warn_s),
    )
    lives = table.groupby("cluster_id").agg(
        first=("frame", "min"),
        last=("frame", "max"),
        n_rows=("frame", "size"),
        n_tracks=("n_tracks", "median"),
        x_px=("x_px", "median"),
        y_px=("y_px", "median"),
        is_near=("is_near", "any"),
        n_matched=("is_matched", "sum"),
        found_share=("is_matched", "mean"),
    )
    is_large = (lives.n_rows >= least_rows) & (lives.n_tracks >= tolerance.min_tracks)
    lives["is_warned"] = lives.index.isin(list(warned))
    lives["counts"] = is_large | lives.is_near | lives.is_warned
    return lives.reset_index()


def _are_near(objects: pd.DataFrame, warn_s: float) -> Bools:
    """Whether an object is certainly nearer in time than ``warn_s`` in a row, as ``frames.min_ttc_z_s`` says."""
    rows = objects.reset_index(drop=True).sort_values(["cluster_id", "frame"], kind="stable")
    is_sure = (
        rows.state.isin([state.value for state in APPROACHING])
        & (rows.ttc_z_lo_s > 0)
        & (rows.ttc_z_lo_s <= rows.ttc_z_s)
        & (rows.ttc_z_s <= rows.ttc_z_hi_s)
    )
    # A new stretch begins with each doubt, and with each object.
    stretch = (~is_sure).cumsum()
    since_s = rows.t_s.where(is_sure).groupby([rows.cluster_id, stretch]).transform("min")
    is_told = (rows.t_s - since_s >= PERSISTENCE_S - _ROUNDING_S) & (rows.n_tracks >= LEAST_TRACKS)
    is_near = is_sure & is_told & (rows.ttc_z_s < warn_s)
    return np.asarray(is_near.sort_index().to_numpy(bool))


def _complaint(life: Any, what: str, tolerance: ObjectTolerance) -> str:
    if life.found_share >= tolerance.min_found:
        return ""
    share = f"in {100 * (1 - life.found_share):.0f} % of its frames " if life.found_share > 0 else ""
    where = f"around x {life.x_px:.0f} y {life.y_px:.0f} px, " if np.isfinite(life.x_px) else ""
    why = ", with a warning" if life.is_warned else f", nearer than {tolerance.warn_s:g} s" if life.is_near else ""
    return (
        f"object {life.cluster_id} (frames {life.first}-{life.last}, {where}{life.n_tracks:.0f} tracks{why}) "
        f"is {share}{what}"
    )


def _all_gone(lives: pd.DataFrame, others: pd.DataFrame, tolerance: ObjectTolerance) -> str:
    """What to say where one side has objects, and the other none at all."""
    for one, other, what in ((lives, others, "missing"), (others, lives, "additional")):
        n_frames = int(one.n_rows.sum())
        if len(other) == 0 and n_frames >= tolerance.min_frames:
            return f"all {counted(len(one), 'object')} ({n_frames} object-frames) are {what}"
    return ""


def _rate_complaint(lives: pd.DataFrame, others: pd.DataFrame, tolerance: ObjectTolerance) -> str:
    """What to say where objects that do not count by themselves come or go by more than they do by chance.

    What is gone of one object is gone together, so that the variance of the number of object-frames is the sum of the
    squares of those of each object.
    """
    (lost, lost_var), (new, new_var) = (_unmatched(table) for table in (lives, others))
    n_before, n_now = (int(table.n_rows[~table.counts].sum()) for table in (lives, others))
    if abs(new - lost) <= tolerance.rate_sigmas * np.sqrt(lost_var + new_var):
        return ""
    return (
        f"small or uncertain objects: {n_before} object-frames became {n_now} ({lost} are gone, {new} are new), more "
        f"than {tolerance.rate_sigmas:g} standard deviations"
    )


def _unmatched(lives: pd.DataFrame) -> tuple[int, float]:
    """Frames without a match of the objects that do not count by themselves, and the variance of their number."""
    n = (lives.n_rows - lives.n_matched)[~lives.counts].to_numpy(float)
    return int(n.sum()), float(n @ n)


def _renamed(pairs: pd.DataFrame, number: int, tolerance: ObjectTolerance) -> str:
    """What to say of an object of the baseline that has several numbers in the run."""
    partners = pairs.loc[pairs.baseline_id == number, ["frame", "run_id"]]
    counts = partners.run_id.value_counts()
    if len(counts) < 2 or counts.iloc[0] >= tolerance.min_one_number * len(partners):
        return ""
    spans = partners.groupby("run_id").frame.agg(["min", "max"]).sort_values("min")
    names = ", ".join(f"{run_id} in frames {low}-{high}" for run_id, low, high in spans.itertuples())
    return f"object {number} does not keep one number in the run: it is {names}"


def _pairs(matches: Matches) -> pd.DataFrame:
    names = {"object_id": "baseline_id", "cluster_id": "run_id", "truth_row": "baseline_row", "found_row": "run_row"}
    return matches.pairs.rename(columns=names)
