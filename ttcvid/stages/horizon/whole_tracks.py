"""Whole tracks of a clip, collected frame by frame; static ones are dropped once they have ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ttcvid.model import NO_POINTS, Bools, Floats, Ints, PointSet

# An ended track that stays within this of its start, px, is of no use.
_STAYS_PX = 3.0
# Enough for the number of a frame.
_FRAME_BITS = 32


@dataclass(frozen=True)
class Observations:
    """Rows sorted by (track, frame): ``track_id, frame (N,)``, ``t_s (N,)``, ``xy_px (N, 2)`` source pixels."""

    track_id: Ints
    frame: Ints
    t_s: Floats
    xy_px: Floats

    @property
    def starts(self) -> Ints:
        """First row of each track: (M,)."""
        return np.flatnonzero(np.diff(self.track_id, prepend=-1))

    @property
    def lengths(self) -> Ints:
        """Number of rows of each track: (M,)."""
        return np.diff(np.append(self.starts, len(self.frame)))

    def take(self, rows: Bools | Ints) -> Observations:
        """The rows of a mask ``(N,)``, or of their numbers."""
        return Observations(self.track_id[rows], self.frame[rows], self.t_s[rows], self.xy_px[rows])

    def take_tracks(self, tracks: Bools) -> Observations:
        """All rows of the tracks of a mask ``(M,)``."""
        return self.take(np.repeat(tracks, self.lengths))


def usual_step_s(t_s: Sequence[float] | Floats) -> float:
    """Median step between ascending times; 0 with a single one."""
    return float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0


def observations_of(points: PointSet, frame: int, t_s: float) -> Observations:
    """The points of one frame."""
    n = len(points.track_id)
    return Observations(points.track_id, np.full(n, frame), np.full(n, t_s), points.xy_px)


def joined(parts: list[Observations]) -> Observations:
    """All rows of several parts of one clip, sorted."""
    columns = [
        (part.track_id, part.frame, part.t_s, part.xy_px) for part in [observations_of(NO_POINTS, 0, 0.0), *parts]
    ]
    rows = Observations(*map(np.concatenate, zip(*columns, strict=True)))
    return rows.take(np.lexsort((rows.frame, rows.track_id)))


def recentred(rows: Observations, centres: Observations) -> Observations:
    """Move tracks to where the content of their windows lies; a track whose content was never located is left out.

    A track follows the same content all its life, so one offset holds for all of it: the median of those found.
    ``centres`` are where the content lay for some of the observations, NaN where it was not located.
    """
    centres = joined([centres.take(np.isfinite(centres.xy_px[:, 0]))])
    _, in_rows, in_centres = np.intersect1d(_key(rows), _key(centres), assume_unique=True, return_indices=True)
    shift_px = centres.xy_px[in_centres] - rows.xy_px[in_rows]
    track, first = np.unique(rows.track_id[in_rows], return_index=True)
    medians = [np.median(part, axis=0) for part in np.split(shift_px, first[1:])] if len(track) else []
    kept = rows.take(np.isin(rows.track_id, track))
    moved = np.repeat(np.reshape(medians, (-1, 2)), kept.lengths, axis=0)
    return Observations(kept.track_id, kept.frame, kept.t_s, kept.xy_px + moved)


def _key(rows: Observations) -> Ints:
    """One number for each (track, frame), ascending as the rows are."""
    return np.asarray((rows.track_id << _FRAME_BITS) + rows.frame)


def without_ended_at_rest(rows: Observations, frame: int) -> Observations:
    """Leave out tracks that ended before ``frame`` and never moved."""
    starts = rows.starts
    low, high = np.minimum.reduceat(rows.xy_px, starts), np.maximum.reduceat(rows.xy_px, starts)
    last = rows.frame[starts + rows.lengths - 1]
    return rows.take_tracks((last >= frame) | (np.max(high - low, axis=1) > _STAYS_PX))
