"""Two results of analyses, joined and held against each other: what is different, and in which rows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ttcvid.model import SCENE_CLUSTER, Ints
from ttcvid.studies.compare.columns import ColumnVerdict, JoinedRows, complaints_about_times, judge_columns
from ttcvid.studies.compare.frames import JoinedFrames, join_frames
from ttcvid.studies.compare.objects import JoinedObjects, baseline_numbers, join_events, join_objects
from ttcvid.studies.compare.tolerance import Tolerance
from ttcvid.studies.compare.tracks import join_tracks, positions_by_frame


@dataclass(frozen=True)
class Results:
    """One side of a comparison.

    ``tables`` have the columns of ``ttcvid.schema``, null as NaN, or ``NO_CLUSTER`` in ``cluster_id``; those of a
    baseline may lack columns. ``facts`` says how the result was made, by dotted names (``camera.fx_px``). ``clock``
    has ``frame, t_s`` of all frames. ``is_thinned``: the tables have only some of them, and few tracks of each.
    """

    name: str
    tables: Mapping[str, pd.DataFrame]
    facts: Mapping[str, object]
    clock: pd.DataFrame
    is_thinned: bool = False

    @property
    def focal_px(self) -> tuple[float, float] | None:
        """Focal lengths in x and y; None where the facts do not tell."""
        values = self.facts.get("camera.fx_px"), self.facts.get("camera.fy_px")
        return (float(str(values[0])), float(str(values[1]))) if None not in values else None


@dataclass(frozen=True)
class Change:
    """Something that the two results were made with differently; it does not make them different by itself."""

    name: str
    baseline: str
    run: str


@dataclass(frozen=True)
class PartSummary:
    """How many rows of a table's part each side has, how many are joined, and what is wrong beside the columns.

    Of objects, which are no rows, ``n_counted`` (of the baseline, of the run) count by themselves; those are joined.
    """

    part: str
    n_baseline: int
    n_run: int
    n_joined: int
    complaints: tuple[str, ...] = ()
    n_counted: tuple[int, int] | None = None


@dataclass(frozen=True)
class Comparison:
    """What two results have in common; ``is_same`` is the verdict."""

    baseline: str
    run: str
    changes: tuple[Change, ...]
    parts: tuple[PartSummary, ...]
    columns: tuple[ColumnVerdict, ...]
    notes: tuple[str, ...] = ()

    @property
    def is_same(self) -> bool:
        """True where every column is within its tolerances and nothing is missing or additional."""
        return all(column.is_same for column in self.columns) and not any(part.complaints for part in self.parts)


def compare_results(baseline: Results, run: Results, tolerance: Tolerance) -> Comparison:
    """Join frames, tracks, clusters and warnings of two results and judge every difference."""
    before, now = baseline.tables, run.tables
    placed = positions_by_frame(before["collision_times"]), positions_by_frame(now["collision_times"])
    frames = join_frames(baseline.clock, run.clock, placed, tolerance.frames)
    judged = frames.of(before["frames"].frame.to_numpy())
    old = {name: _only(before[name], judged.baseline) for name in _PER_FRAME}
    new = {name: _renumbered(now[name], judged) for name in _PER_FRAME}
    if baseline.is_thinned:
        # A baseline keeps objects only: what is to be said of the scene stands in the epipoles.
        new["clusters"] = _rows(new["clusters"], new["clusters"].cluster_id > SCENE_CLUSTER)
    frames_per_row = len(baseline.clock) / max(len(before["frames"]), 1)
    old_objects, new_objects = (
        _rows(side["clusters"], side["clusters"].cluster_id > SCENE_CLUSTER) for side in (old, new)
    )
    warned = tuple(frozenset(int(number) for number in side["events"].cluster_id) for side in (before, now))
    objects = join_objects(old_objects, new_objects, tolerance.objects, frames_per_row, (warned[0], warned[1]))
    tracks = join_tracks(old["collision_times"], new["collision_times"], tolerance.frames.max_distance_px)
    events = join_events(before["events"], now["events"], objects.pairs, tolerance.events)
    joined = [_frame_rows(old["frames"], new["frames"])]
    for name in _CLUSTERS:
        joined.append(_scene_rows(name, old[name], new[name]))
        joined.append(_object_rows(name, old[name], new[name], objects))
    joined.append(_track_rows(old["collision_times"], new["collision_times"], tracks, objects))
    joined.append(_event_rows(before["events"], now["events"], events[:2]))
    columns = [verdict for rows in joined for verdict in judge_columns(rows, tolerance, baseline.focal_px)]
    parts = [
        _frame_summary(baseline, run, frames),
        *(_cluster_summary(name, old[name], new[name]) for name in _CLUSTERS),
        _object_summary(objects, joined, columns, tolerance),
        _track_summary(baseline, old["collision_times"], new["collision_times"], tracks, tolerance),
        PartSummary("events", len(before["events"]), len(now["events"]), len(events[0]), events[2]),
    ]
    return Comparison(baseline.name, run.name, changes(baseline, run), tuple(parts), tuple(columns), _notes(frames))


SAME_FLOATS = 1e-12
"""Facts of a run that differ by less than this part are the same number, differently rounded."""
_PER_FRAME = ("frames", "epipoles", "clusters", "collision_times")
_CLUSTERS = ("epipoles", "clusters")


def changes(baseline: Results, run: Results) -> tuple[Change, ...]:
    """Facts that differ, a fact that one side lacks among them."""
    names = [*baseline.facts, *(name for name in run.facts if name not in baseline.facts)]
    both = [(name, baseline.facts.get(name, "none"), run.facts.get(name, "none")) for name in names]
    return tuple(
        Change(name, _shown(before), _shown(now) + _growth(before, now))
        for name, before, now in both
        if not _is_alike(before, now)
    )


def _is_alike(before: object, now: object) -> bool:
    """Whether two facts are the same; numbers that come out of a division may differ by their last digit."""
    if isinstance(before, float) and isinstance(now, float):
        return math.isclose(before, now, rel_tol=SAME_FLOATS)
    return before == now


def _shown(fact: object) -> str:
    return f"{fact:.8g}" if isinstance(fact, float) else str(fact)


def _growth(before: object, now: object) -> str:
    """By how much a positive number has changed; nothing for what is none."""
    if not (isinstance(before, float) and isinstance(now, float) and before > 0 and now > 0):
        return ""
    return f" ({now - before:+.5g}, {100 * (now / before - 1):+.3g} %)"


def _only(table: pd.DataFrame, frames: Ints) -> pd.DataFrame:
    """The rows of some frames."""
    is_meant = np.isin(table.frame.to_numpy(), frames)
    return table if is_meant.all() else table[is_meant].reset_index(drop=True)


def _renumbered(table: pd.DataFrame, frames: JoinedFrames) -> pd.DataFrame:
    """The run's rows of joined frames, ``frame`` being that of the baseline."""
    if np.array_equal(frames.baseline, frames.run):
        return _only(table, frames.run)
    rows = _only(table, frames.run)
    return rows.assign(frame=frames.baseline[np.searchsorted(frames.run, rows.frame.to_numpy())])


def _rows(table: pd.DataFrame, which: pd.Series) -> pd.DataFrame:
    return table[which].reset_index(drop=True)


def _frame_rows(old: pd.DataFrame, new: pd.DataFrame) -> JoinedRows:
    return JoinedRows("frames", old.frame.to_numpy(), old.t_s.to_numpy(), _nobody(old), old, new)


def _scene_rows(name: str, old: pd.DataFrame, new: pd.DataFrame) -> JoinedRows:
    before, now = _rows(old, old.cluster_id == SCENE_CLUSTER), _rows(new, new.cluster_id == SCENE_CLUSTER)
    _, rows, others = np.intersect1d(before.frame, now.frame, return_indices=True)
    return _beside(f"{name}.scene", before, now, rows, others, _nobody(rows))


def _object_rows(name: str, old: pd.DataFrame, new: pd.DataFrame, objects: JoinedObjects) -> JoinedRows:
    """Rows of matched objects; both tables have a row for each object of each frame."""
    pairs = objects.pairs[["frame", "baseline_id", "run_id"]]
    keys = (old, "baseline_id"), (new, "run_id")
    row, other = (_rows_of(table, pairs, number) for table, number in keys)
    is_there = (row >= 0) & (other >= 0)
    return _beside(
        f"{name}.objects", old, new, row[is_there], other[is_there], pairs.baseline_id[is_there].to_numpy(), "object "
    )


def _rows_of(table: pd.DataFrame, pairs: pd.DataFrame, number: str) -> Ints:
    rows = table[["frame", "cluster_id"]].assign(row=np.arange(len(table)))
    found = pairs.merge(rows, left_on=["frame", number], right_on=["frame", "cluster_id"], how="left").row
    return np.asarray(found.fillna(-1).to_numpy(np.int64))


def _track_rows(old: pd.DataFrame, new: pd.DataFrame, tracks: tuple[Ints, Ints], objects: JoinedObjects) -> JoinedRows:
    new = new.assign(cluster_id=baseline_numbers(new, objects.pairs))
    return _beside("collision_times", old, new, *tracks, old.track_id.to_numpy()[tracks[0]], "track ")


def _event_rows(old: pd.DataFrame, new: pd.DataFrame, events: tuple[Ints, Ints]) -> JoinedRows:
    who = np.array([f"warning {number}" for number in old.event_id.iloc[events[0]]], dtype=object)
    old, new = (table.assign(frame=table.start_frame, t_s=table.start_s) for table in (old, new))
    return _beside("events", old, new, *events, who)


def _beside(
    part: str, old: pd.DataFrame, new: pd.DataFrame, rows: Ints, others: Ints, who: np.ndarray, prefix: str = ""
) -> JoinedRows:
    before, now = _taken(old, rows), _taken(new, others)
    return JoinedRows(part, before.frame.to_numpy(), before.t_s.to_numpy(float), who, before, now, prefix)


def _taken(table: pd.DataFrame, rows: Ints) -> pd.DataFrame:
    return table if np.array_equal(rows, np.arange(len(table))) else table.iloc[rows].reset_index(drop=True)


def _nobody(rows: pd.DataFrame | Ints) -> np.ndarray:
    return np.full(len(rows), "", dtype=object)


def _frame_summary(baseline: Results, run: Results, frames: JoinedFrames) -> PartSummary:
    complaints = []
    place = ""
    if baseline.is_thinned and frames.is_by_picture:
        place = ", or one near it"
    elif baseline.is_thinned and len(frames.missing) and frames.missing[-1] == baseline.clock.frame.iloc[-1]:
        # The few tracks of a baseline do not always tell where a picture was lost.
        place = ", or an earlier one if the clip has new times"
    for numbers, side, what in ((frames.missing, baseline, "missing"), (frames.additional, run, "additional")):
        t_s = side.clock.set_index("frame").t_s
        for low, high in _spans(numbers, side.clock.frame.to_numpy()):
            complaints.append(
                f"frame {low} ({t_s[low]:.3f} s) is {what}{place}"
                if low == high
                else f"frames {low}-{high} ({t_s[low]:.3f}-{t_s[high]:.3f} s) are {what}{place}"
            )
    return PartSummary("frames", len(baseline.clock), len(run.clock), len(frames.baseline), tuple(complaints))


def _spans(numbers: Ints, all_numbers: Ints) -> list[tuple[int, int]]:
    """First and last of each row of numbers that follow each other in ``all_numbers``."""
    if len(numbers) == 0:
        return []
    place = np.searchsorted(all_numbers, numbers)
    starts = np.flatnonzero(np.diff(place, prepend=place[0] - 2) != 1)
    ends = np.append(starts[1:], len(numbers)) - 1
    return [(int(numbers[start]), int(numbers[end])) for start, end in zip(starts, ends, strict=True)]


def _cluster_summary(name: str, old: pd.DataFrame, new: pd.DataFrame) -> PartSummary:
    before, now = (table.frame[table.cluster_id == SCENE_CLUSTER].to_numpy() for table in (old, new))
    complaints = [
        f"the static scene is {what} in frames {low}-{high}"
        for one, other, what in ((before, now, "missing"), (now, before, "additional"))
        for low, high in _spans(np.setdiff1d(one, other), old.frame.unique())
    ]
    return PartSummary(f"{name}.scene", len(before), len(now), len(np.intersect1d(before, now)), tuple(complaints))


def _object_summary(
    objects: JoinedObjects, joined: list[JoinedRows], columns: list[ColumnVerdict], tolerance: Tolerance
) -> PartSummary:
    """What became of the objects; each that counts has to have its times again, where their columns are the same."""
    (rows,) = (rows for rows in joined if rows.part == "clusters.objects")
    same = {column.column for column in columns if column.part == rows.part and column.is_same}
    complaints = (*objects.complaints, *complaints_about_times(rows, objects.counted, same, tolerance))
    n_counted = len(objects.counted), len(objects.counted_run)
    return PartSummary(rows.part, objects.n_baseline, objects.n_run, objects.n_found, complaints, n_counted)


def _track_summary(
    baseline: Results, old: pd.DataFrame, new: pd.DataFrame, tracks: tuple[Ints, Ints], tolerance: Tolerance
) -> PartSummary:
    n_joined = len(tracks[0])
    totals = [(len(old), "of the baseline are missing")]
    totals += [] if baseline.is_thinned else [(len(new), "of the run are additional")]
    complaints = [
        f"{n - n_joined} of {n} track rows {what}: {n_joined} are at the same place"
        for n, what in totals
        if n_joined < tolerance.frames.min_joined * n
    ]
    return PartSummary("collision_times", len(old), len(new), n_joined, tuple(complaints))


def _notes(frames: JoinedFrames) -> tuple[str, ...]:
    if frames.is_by_picture:
        return ("frames are joined by what they show: their times do not fit",)
    return ()
