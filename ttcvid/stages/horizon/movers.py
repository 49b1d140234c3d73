"""Groups long tracks into movers: neighbours with the same motion for as long as both are seen."""

from __future__ import annotations

import numpy as np

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.horizon.whole_tracks import Observations, usual_step_s
from ttcvid.stages.tracking.neighbours import connected_parts, linked_pairs

# Each quarter of a track advances by more than the first share of its way, and deviates aside by less than the second.
_LEAST_QUARTER, _MOST_ASIDE = 0.06, 0.2
# Motions are compared over this time, s.
_STEP_S = 0.4
# Two neighbours move alike if their steps differ by less than this share of the longer one plus this many px.
_ALIKE_PART, _ALIKE_PX = 0.2, 0.7
# They are one mover if they moved alike in this share of the time in which both were observed near each other.
_ALIKE_SHARE = 0.75


def moving_tracks(rows: Observations, config: HorizonCalibrationConfig) -> Bools:
    """Long tracks with a net motion at a steady pace and without detours: ``(M,)``.

    A background point that a pedestrian passes drifts for a moment, and rests before and after; an arm swings to and
    fro. So each quarter of the track has to advance.
    """
    starts, lengths = rows.starts, rows.lengths
    ends = starts + lengths - 1
    way = rows.xy_px[ends] - rows.xy_px[starts]
    moved_px = np.linalg.norm(way, axis=1)
    seen_s = rows.t_s[ends] - rows.t_s[starts]
    quarters = starts[:, None] + np.rint((lengths - 1)[:, None] * np.linspace(0.0, 1.0, 5)).astype(np.int64)
    steps = np.diff(rows.xy_px[quarters], axis=1)
    square = np.maximum(moved_px, 1e-9)[:, None] ** 2
    onward = np.einsum("mqi,mi->mq", steps, way) / square
    aside = np.abs(steps[:, :, 0] * way[:, None, 1] - steps[:, :, 1] * way[:, None, 0]) / square
    is_steady = (onward.min(axis=1) > _LEAST_QUARTER) & (aside.max(axis=1) < _MOST_ASIDE)
    is_long = (lengths >= 4) & (seen_s >= config.min_track_s) & (moved_px >= config.min_path_px)
    return np.asarray(is_long & is_steady)


def group_movers(rows: Observations, link_px: float) -> Ints:
    """Number of the mover of each of the tracks that move: ``(M,)``, from 0. Neighbours are nearer than ``link_px``."""
    n_tracks = len(rows.starts)
    number = np.repeat(np.arange(n_tracks), rows.lengths)
    frames, first = np.unique(rows.frame, return_index=True)
    order = np.argsort(rows.frame, kind="stable")
    at_frame = np.split(order, np.searchsorted(rows.frame[order], frames)[1:])
    pairs = [
        _neighbours(rows, number, at_frame[now], at_frame[later], link_px) for now, later in _compared(rows.t_s[first])
    ]
    one, other, is_alike = np.concatenate([np.empty((0, 3), dtype=np.int64), *pairs]).T
    key, place, times_near = np.unique(one * n_tracks + other, return_inverse=True, return_counts=True)
    times_alike = np.bincount(place, is_alike, minlength=len(key))
    linked = key[times_alike >= _ALIKE_SHARE * times_near]
    return connected_parts(np.ones(n_tracks, dtype=bool), np.column_stack(np.divmod(linked, n_tracks)))


def _compared(t_s: Floats) -> list[tuple[int, int]]:
    """Which two frames of times ``(T,)`` are compared: twice a step, one with that nearest in time to a step later.

    Times may be uneven, and frames missing: a pair that is off by more than half a step is not compared, unless the
    usual interval is longer.
    """
    median_s = usual_step_s(t_s)
    compared, next_s = list[tuple[int, int]](), -np.inf
    for now in range(len(t_s) - 1):
        if t_s[now] < next_s:
            continue
        next_s = t_s[now] + 0.5 * (_STEP_S - median_s)
        late_s = np.abs(t_s[now + 1 :] - t_s[now] - _STEP_S)
        nearest = int(np.argmin(late_s))
        if late_s[nearest] <= max(0.5 * _STEP_S, median_s):
            compared.append((now, now + 1 + nearest))
    return compared


def _neighbours(rows: Observations, number: Ints, now: Ints, later: Ints, link_px: float) -> Ints:
    """Pairs of tracks that are near each other between two frames, and whether they move alike: (P, 3)."""
    track, in_now, in_later = np.intersect1d(number[now], number[later], return_indices=True)
    here, there = rows.xy_px[now][in_now], rows.xy_px[later][in_later]
    flow: Floats = there - here
    length = np.linalg.norm(flow, axis=1)
    one, other = linked_pairs(0.5 * (here + there), link_px).T
    longer = np.maximum(length[one], length[other])
    differ = np.linalg.norm(flow[one] - flow[other], axis=1)
    seen = longer > 2.0 * _ALIKE_PX
    is_alike = differ < _ALIKE_PART * longer + _ALIKE_PX
    return np.asarray(np.column_stack([track[one], track[other], is_alike])[seen])
