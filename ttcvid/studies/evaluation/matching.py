"""Which object found is which true object: frame by frame, and over the whole clip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from ttcvid.model import Floats, Ints
from ttcvid.studies.evaluation.truth import BOX, UNKNOWN_OBJECT, columns_of, row_codes

MIN_OVERLAP = 0.3
"""Intersection over union, of boxes or of sets of tracks, from which on two are taken for the same object."""
MIN_INSIDE = 0.5
"""Share of a box, or of its tracks, on a true object from which on it is another piece of that object."""


@dataclass(frozen=True)
class Matches:
    """What is what.

    ``pairs`` has a row for each match: ``frame, object_id, cluster_id`` and the row numbers ``truth_row, found_row``
    in the truth's objects and the found ones. ``verdict`` says of each found row ``match``, ``double`` (another piece
    of a true object), ``at_rest`` (on nothing true, and said to move with the scene) or ``false``; ``owner`` is the
    true object of a match or double, ``UNKNOWN_OBJECT`` otherwise.
    """

    pairs: pd.DataFrame
    verdict: np.ndarray
    owner: Ints


def match_objects(truth: pd.DataFrame, found: pd.DataFrame, on_tracks: pd.DataFrame | None = None) -> Matches:
    """Match true objects to found ones one-to-one in each frame, so that the sum of overlaps is largest.

    Parameters
    ----------
    truth : ``frame, object_id`` and a box, a row per frame and object.
    found : ``frame, cluster_id, motion_id`` and a box.
    on_tracks : ``frame, cluster_id, object_id, n`` as from `count_tracks`; None where the tracks' objects are unknown.
    """
    truth_row, found_row = _rows_of_same_frame(truth.frame.to_numpy(), found.frame.to_numpy())
    boxes = columns_of(truth, BOX)[truth_row], columns_of(found, BOX)[found_row]
    near = pd.DataFrame(
        {
            "frame": truth.frame.to_numpy()[truth_row],
            "object_id": truth.object_id.to_numpy()[truth_row],
            "cluster_id": found.cluster_id.to_numpy()[found_row],
            "truth_row": truth_row,
            "found_row": found_row,
            "overlap": intersection_over_union(*boxes),
            "inside": share_inside(*boxes),
        }
    )
    if on_tracks is not None:
        overlap, inside = _track_overlap(near, on_tracks)
        near["overlap"] = np.fmax(near.overlap, overlap)
        near["inside"] = np.fmax(near.inside, inside)
    pairs = _one_to_one(near[near.overlap >= MIN_OVERLAP])
    owner, verdict = np.full(len(found), UNKNOWN_OBJECT), np.full(len(found), "false", dtype=object)
    verdict[found.motion_id.to_numpy() == 0] = "at_rest"
    pieces = near[near.inside >= MIN_INSIDE].sort_values("inside")
    for name, rows in (("double", pieces), ("match", pairs)):
        owner[rows.found_row], verdict[rows.found_row] = rows.object_id, name
    return Matches(pairs.drop(columns=["overlap", "inside"]), verdict, owner)


def _rows_of_same_frame(first: Ints, second: Ints) -> tuple[Ints, Ints]:
    """All pairs of a row of ``first (N,)`` and one of ``second (M,)`` that are of the same frame, in that order."""
    order = np.argsort(second, kind="stable")
    start, end = (np.searchsorted(second, first, side, sorter=order) for side in ("left", "right"))
    n = end - start
    within = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
    return np.repeat(np.arange(len(first)), n), order[np.repeat(start, n) + within]


def count_tracks(frame: Ints, cluster_id: Ints, track_object: Ints) -> pd.DataFrame:
    """Tracks per frame, cluster and true object: ``frame, cluster_id, object_id, n``; unknown ones are left out."""
    rows = np.column_stack([frame, cluster_id, track_object])[track_object != UNKNOWN_OBJECT]
    _, first, n = np.unique(row_codes(rows), return_index=True, return_counts=True)
    return pd.DataFrame(rows[first], columns=["frame", "cluster_id", "object_id"]).assign(n=n)


def best_one_to_one(first: Ints, second: Ints, weight: Ints | None = None) -> dict[int, int]:
    """The one-to-one assignment of ``first (N,)`` to ``second (N,)`` numbers that the most rows agree with.

    >>> best_one_to_one(np.array([1, 1, 1, 2, 2]), np.array([7, 7, 8, 7, 8]))
    {1: 7, 2: 8}
    """
    if len(first) == 0:
        return {}
    names, rows = np.unique(first, return_inverse=True)
    others, columns = np.unique(second, return_inverse=True)
    agreement = np.zeros((len(names), len(others)))
    np.add.at(agreement, (rows, columns), 1 if weight is None else weight)
    assigned = zip(*linear_sum_assignment(agreement, maximize=True), strict=True)
    return {int(names[i]): int(others[j]) for i, j in assigned if agreement[i, j] > 0}


def intersection_over_union(first: Floats, second: Floats) -> Floats:
    """Intersection over union ``(N,)`` of boxes ``(N, 4)``: x0, y0, x1, y1; 1 for the same box, that of a point too.

    >>> intersection_over_union(np.array([[0.0, 0, 2, 2]]), np.array([[1.0, 0, 3, 2]])).round(3).tolist()
    [0.333]
    """
    common = _common_area(first, second)
    union = _area(first) + _area(second) - common
    overlap = common / np.maximum(union, np.finfo(float).tiny)
    return np.where(np.all(first == second, axis=1), 1.0, overlap)


def share_inside(outer: Floats, inner: Floats) -> Floats:
    """The share ``(N,)`` of boxes ``inner (N, 4)`` that lies in ``outer (N, 4)``."""
    return _common_area(outer, inner) / np.maximum(_area(inner), np.finfo(float).tiny)


def _one_to_one(pairs: pd.DataFrame) -> pd.DataFrame:
    """Those pairs that the best assignment within each frame takes; most have no rival and need none."""
    has_rival = pairs.duplicated("truth_row", keep=False) | pairs.duplicated("found_row", keep=False)
    rivals = pairs[pairs.frame.isin(pairs.frame[has_rival])]
    chosen = [pairs.drop(index=rivals.index), *(_best_of_frame(of_frame) for _, of_frame in rivals.groupby("frame"))]
    return pd.concat(chosen).sort_index().reset_index(drop=True)


def _best_of_frame(pairs: pd.DataFrame) -> pd.DataFrame:
    truth_rows, i = np.unique(pairs.truth_row, return_inverse=True)
    found_rows, j = np.unique(pairs.found_row, return_inverse=True)
    overlap, position = np.zeros((len(truth_rows), len(found_rows))), np.full((len(truth_rows), len(found_rows)), -1)
    overlap[i, j], position[i, j] = pairs.overlap, np.arange(len(pairs))
    chosen = position[linear_sum_assignment(overlap, maximize=True)]
    best: pd.DataFrame = pairs.iloc[chosen[chosen >= 0]]
    return best


def _track_overlap(near: pd.DataFrame, on_tracks: pd.DataFrame) -> tuple[Floats, Floats]:
    """Of each pair: tracks in both over tracks in either, and the share of the cluster's tracks on the object."""
    n_common = _totals(near, on_tracks, ["frame", "cluster_id", "object_id"])
    n_cluster = _totals(near, on_tracks, ["frame", "cluster_id"])
    n_object = _totals(near, on_tracks, ["frame", "object_id"])
    either = np.maximum(n_cluster + n_object - n_common, 1.0)
    return n_common / either, n_common / np.maximum(n_cluster, 1.0)


def _totals(near: pd.DataFrame, on_tracks: pd.DataFrame, names: list[str]) -> Floats:
    """How many of the tracks agree with each pair in some numbers."""
    numbers = [np.column_stack([table[name].to_numpy(np.int64) for name in names]) for table in (near, on_tracks)]
    _, row = np.unique(row_codes(np.vstack(numbers)), return_inverse=True)
    totals = np.bincount(row[len(near) :], on_tracks.n.to_numpy(float), int(row.max(initial=-1)) + 1)
    return np.asarray(totals[row[: len(near)]])


def _common_area(first: Floats, second: Floats) -> Floats:
    low, high = np.maximum(first[:, :2], second[:, :2]), np.minimum(first[:, 2:], second[:, 2:])
    return np.asarray(np.prod(np.clip(high - low, 0, None), axis=1))


def _area(box: Floats) -> Floats:
    return np.asarray(np.prod(box[:, 2:] - box[:, :2], axis=1))
