"""Which frames and tracks of two results are the same ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from ttcvid.model import Floats, Ints
from ttcvid.studies.compare_tolerance import FrameTolerance

MAX_SHIFT_FRAMES = 3
"""Frames that can be lost or doubled in one place and still be followed."""
GOOD_SHARE = 0.5
"""Two frames show the same picture if at least this share of tracks is at the same place in both."""
MAX_PICTURES_COMPARED = 60
"""Times are believed unless more of these pictures agree when frames are joined by what they show."""

Placed = dict[int, Floats]
"""Track positions ``(N, 2)`` in px, by frame."""


@dataclass(frozen=True)
class JoinedFrames:
    """Frames that are the same in both results, and those that have no counterpart.

    ``baseline`` and ``run`` (N,) are frame numbers, ascending, one beside the other; ``missing`` is in the baseline
    only, ``additional`` in the run only. ``is_by_picture`` says that the times of the frames did not tell.
    """

    baseline: Ints
    run: Ints
    missing: Ints
    additional: Ints
    is_by_picture: bool = False

    def of(self, frames: Ints) -> JoinedFrames:
        """The joined pairs of some frames of the baseline."""
        is_meant = np.isin(self.baseline, frames)
        return replace(self, baseline=self.baseline[is_meant], run=self.run[is_meant])


def join_frames(
    baseline: pd.DataFrame,
    run: pd.DataFrame,
    placed: tuple[Placed, Placed],
    tolerance: FrameTolerance,
) -> JoinedFrames:
    """Join the frames of two results by time, or where their tracks say otherwise, by what the pictures show.

    A clip that was encoded anew without one of its frames has the same times as before, but one picture less: from
    there on every picture is early, which only its content tells.

    Parameters
    ----------
    baseline, run
        ``frame`` and ``t_s`` of all frames.
    placed
        Where the tracks of the baseline and of the run are, by frame; for the baseline, some frames are enough.
    """
    joined, is_by_picture = _by_time(baseline, run, tolerance), False
    # A lost picture shifts all that follow: the last ones tell, and some on the way for clips that end in the dark.
    shown = np.array(sorted(placed[0]), np.int64)
    some = shown[np.unique(np.linspace(0, len(shown) - 1, min(len(shown), MAX_PICTURES_COMPARED)).astype(int))]
    n_good = _n_good(joined, some, placed, tolerance)
    if n_good < len(some):
        by_picture = _by_picture(baseline.frame.to_numpy(), run.frame.to_numpy(), placed, tolerance.max_distance_px)
        is_by_picture = _n_good(by_picture, some, placed, tolerance) > n_good
        joined = by_picture if is_by_picture else joined
    first, second = joined
    additional = np.setdiff1d(run.frame.to_numpy(), second)
    missing = np.setdiff1d(baseline.frame.to_numpy(), first)
    return JoinedFrames(first, second, missing, additional, is_by_picture)


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


def _by_time(baseline: pd.DataFrame, run: pd.DataFrame, tolerance: FrameTolerance) -> tuple[Ints, Ints]:
    before, now = baseline.t_s.to_numpy(float), run.t_s.to_numpy(float)
    if len(before) == 0 or len(now) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    longer = now if len(now) >= len(before) else before
    step_s = float(np.median(np.diff(longer))) if len(longer) > 1 else np.inf
    right = np.clip(np.searchsorted(now, before), 1, max(len(now) - 1, 1))
    nearest = np.where(np.abs(now[right - 1] - before) <= np.abs(now[right % len(now)] - before), right - 1, right)
    nearest %= len(now)
    is_same = np.abs(now[nearest] - before) <= tolerance.max_dt * step_s
    # Two frames at one time (duplicated packets) have one partner between them: the first.
    _, once = np.unique(nearest[is_same], return_index=True)
    rows = np.flatnonzero(is_same)[once]
    return baseline.frame.to_numpy()[rows], run.frame.to_numpy()[nearest[rows]]


def _by_picture(baseline: Ints, run: Ints, placed: tuple[Placed, Placed], max_distance_px: float) -> tuple[Ints, Ints]:
    """Walk through the baseline's frames; where the run's picture is another, look for it some frames off."""
    step = int(np.median(np.diff(run))) if len(run) > 1 else 1
    known, shift = set(run.tolist()), 0
    partner_of: dict[int, int] = {}
    shifts = sorted(range(-MAX_SHIFT_FRAMES, MAX_SHIFT_FRAMES + 1), key=abs)[1:]
    for frame in baseline.tolist():
        if frame not in placed[0]:
            # Nothing is known of what it shows: it follows the frame before.
            partner_of.setdefault(frame + shift, frame)
            continue
        share = _share_there(placed, frame, frame + shift, max_distance_px)
        if share < GOOD_SHARE:
            others = {s: _share_there(placed, frame, frame + shift + s * step, max_distance_px) for s in shifts}
            best = max(others, key=lambda s: others[s])
            if others[best] >= GOOD_SHARE:
                shift, share = shift + best * step, others[best]
        if share >= GOOD_SHARE or frame + shift not in partner_of:
            # A picture that shows this frame is taken from one before that only had its place.
            partner_of[frame + shift] = frame
    pairs = sorted((frame, other) for other, frame in partner_of.items() if other in known)
    joined = np.array(pairs, np.int64).reshape(-1, 2)
    return joined[:, 0], joined[:, 1]


def _n_good(joined: tuple[Ints, Ints], frames: Ints, placed: tuple[Placed, Placed], tolerance: FrameTolerance) -> int:
    """How many of some frames of the baseline show the same picture as the frame of the run that they are joined to."""
    partner_of = dict(zip(joined[0].tolist(), joined[1].tolist(), strict=True))
    pairs = [(frame, partner_of[frame]) for frame in frames.tolist() if frame in partner_of]
    return sum(_share_there(placed, *pair, tolerance.max_distance_px) >= GOOD_SHARE for pair in pairs)


def _share_there(placed: tuple[Placed, Placed], frame: int, other: int, max_distance_px: float) -> float:
    before, now = placed[0].get(frame), placed[1].get(other)
    if before is None or now is None:
        return 0.0
    distance, _ = cKDTree(now).query(before, distance_upper_bound=max_distance_px)
    return float(np.mean(np.isfinite(distance)))


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
