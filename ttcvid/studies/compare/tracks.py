"""Which tracks of two results are the same points."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from ttcvid.model import Floats, Ints

Placed = dict[int, Floats]
"""Track positions ``(N, 2)`` in px, by frame."""


def positions_by_frame(tracks: pd.DataFrame) -> Placed:
    """Where the tracks are, from the table ``collision_times``, which is sorted by frame."""
    frame, xy_px = tracks.frame.to_numpy(), tracks[["x_px", "y_px"]].to_numpy(float)
    frames, first = np.unique(frame, return_index=True)
    parts = np.split(xy_px, first[1:]) if len(frames) else []
    return {int(index): part for index, part in zip(frames, parts, strict=True)}


def join_tracks(baseline: pd.DataFrame, run: pd.DataFrame, max_distance_px: float) -> tuple[Ints, Ints]:
    """Rows of two tables ``collision_times`` that are the same point: in the same frame, nearest to each other.

    ``frame`` of both is the baseline's. Rows that also share the number of the track need no search.
    """
    first, second = _rows_of_same_number(baseline, run, max_distance_px)
    left, right = _all_but(first, len(baseline)), _all_but(second, len(run))
    more = _nearest_rows(baseline.iloc[left], run.iloc[right], max_distance_px)
    return np.concatenate([first, left[more[0]]]), np.concatenate([second, right[more[1]]])


def _rows_of_same_number(baseline: pd.DataFrame, run: pd.DataFrame, max_distance_px: float) -> tuple[Ints, Ints]:
    first, second = _row_key(baseline), _row_key(run)
    _, rows, others = np.intersect1d(first, second, assume_unique=True, return_indices=True)
    before, now = (table[["x_px", "y_px"]].to_numpy(float) for table in (baseline, run))
    is_near = np.linalg.norm(now[others] - before[rows], axis=1) <= max_distance_px
    return rows[is_near], others[is_near]


def _all_but(rows: Ints, n: int) -> Ints:
    is_left = np.ones(n, bool)
    is_left[rows] = False
    return np.flatnonzero(is_left)


def _row_key(tracks: pd.DataFrame) -> Ints:
    return np.asarray((tracks.frame.to_numpy(np.int64) << 40) + tracks.track_id.to_numpy(np.int64))


def _nearest_rows(baseline: pd.DataFrame, run: pd.DataFrame, max_distance_px: float) -> tuple[Ints, Ints]:
    """Rows of each frame that are nearest to each other, one-to-one."""
    rows, others, distances = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty(0)]
    placed, starts = positions_by_frame(run), _first_rows(run)
    first_row = _first_rows(baseline)
    for frame, before in positions_by_frame(baseline).items():
        now = placed.get(frame)
        if now is None:
            continue
        distance, nearest = cKDTree(now).query(before, distance_upper_bound=max_distance_px)
        near = np.flatnonzero(np.isfinite(distance))
        rows.append(first_row[frame] + near)
        others.append(starts[frame] + nearest[near])
        distances.append(distance[near])
    row, other, distance = np.concatenate(rows), np.concatenate(others), np.concatenate(distances)
    order = np.argsort(distance, kind="stable")
    _, once = np.unique(other[order], return_index=True)
    chosen = np.sort(order[once])
    return row[chosen], other[chosen]


def _first_rows(tracks: pd.DataFrame) -> dict[int, int]:
    frames, first = np.unique(tracks.frame.to_numpy(), return_index=True)
    return dict(zip(frames.tolist(), first.tolist(), strict=True))
