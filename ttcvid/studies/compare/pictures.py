"""Frames of two results joined by what their pictures show: the places of tracks."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ttcvid.model import Floats, Ints
from ttcvid.studies.compare.tracks import Placed

MAX_SHIFT = 3
"""Frames that can be lost or doubled beyond what the numbers of frames tell."""
SAME_PLACE_PX = 0.3
"""Corners of the same picture, also of one that was encoded again, are within this distance; of another one they are
so by chance only, or because nothing moves there."""
MAX_TRACKS = 200
"""Tracks of a frame that are looked for."""
N_LOOKED_AT = 20
SHIFT_COST = 0.25
"""A change of the shift has to bring more than this in shares of tracks, summed over the frames after it."""
LEAST_GAIN, LEAST_SIGMAS = 0.05, 5.0
"""Frames are joined again only if they agree better by this share of tracks, and by so many standard deviations of
such a share: pictures at rest are all alike."""


def times_fit(first: Ints, second: Ints, frames: tuple[Ints, Ints], placed: tuple[Placed, Placed]) -> bool:
    """Whether no frame some places off fits better than that of the same time, at the end and on the way there.

    ``first`` and ``second`` (N,) are frames of the same time, ``frames`` all frames of baseline and run.
    """
    shown = np.flatnonzero(np.isin(frames[0], list(placed[0])))
    if len(first) == 0 or len(shown) == 0:
        return True
    rows = shown[np.unique(np.linspace(0, len(shown) - 1, min(len(shown), N_LOOKED_AT)).astype(int))]
    # A frame without a partner would follow that of the frame before.
    pair = np.clip(np.searchsorted(first, frames[0][rows], side="right") - 1, 0, None)
    start = np.searchsorted(frames[1], second[pair]) + rows - np.searchsorted(frames[0], first[pair])
    shares = _shares(frames[0][rows], start, np.arange(-MAX_SHIFT, MAX_SHIFT + 1), frames[1], placed)
    own = np.where(first[pair] == frames[0][rows], shares[:, MAX_SHIFT], 0.0)
    return bool((shares.max(axis=1) - own < LEAST_GAIN).all())


def join_by_picture(
    first: Ints, second: Ints, frames: tuple[Ints, Ints], placed: tuple[Placed, Placed]
) -> tuple[Ints, Ints] | None:
    """Frames that show the same, one beside the other; None where that is no better than joining by time.

    The shift between both rows of frames may change on the way; its course is the one with the largest sum of shares of
    tracks at the same place, less a cost for each change (Viterbi's algorithm).
    """
    if len(first) == 0:
        return None
    n, m = len(frames[0]), len(frames[1])
    begin = int(np.searchsorted(frames[1], second[0]) - np.searchsorted(frames[0], first[0]))
    reach = MAX_SHIFT + abs(n - m) if abs(n - m) <= MAX_SHIFT else MAX_SHIFT
    shifts = np.arange(-reach, reach + 1)
    shares = _shares(frames[0], np.arange(n) + begin, shifts, frames[1], placed)
    course = _best_course(shares)
    place = np.arange(n) + begin + shifts[course]
    own = shares[np.arange(n), course]
    rows = _one_claim_each(place, own, m)
    former = _columns_by_time(first, second, frames, begin - reach)
    n_tracks = np.array([min(len(placed[0].get(frame, ())), MAX_TRACKS) for frame in frames[0].tolist()])
    is_known = (former >= 0) & (former < len(shifts))
    before = np.where(is_known, shares[np.arange(n), np.where(is_known, former, 0)], 0.0)
    changed = rows[(former[rows] != course[rows]) & (n_tracks[rows] > 0)]
    if not _is_gain(before[changed], own[changed], n_tracks[changed]):
        return None
    return frames[0][rows], frames[1][place[rows]]


def _shares(frames: Ints, start: Ints, shifts: Ints, others: Ints, placed: tuple[Placed, Placed]) -> Floats:
    """Share (N, S) of each frame's tracks that are at the same place in the run's frame ``shifts`` (S,) places off.

    ``start`` (N,) is the place in ``others``, the run's frames, from which shifts count. 0 where there is nothing.
    """
    shares = np.zeros((len(frames), len(shifts)))
    trees: dict[int, cKDTree] = {}
    for row, frame in enumerate(frames.tolist()):
        before = placed[0].get(frame)
        if before is None:
            continue
        before = before[:: -(-len(before) // MAX_TRACKS)]
        for column, place in enumerate((start[row] + shifts).tolist()):
            now = placed[1].get(int(others[place])) if 0 <= place < len(others) else None
            if now is not None:
                tree = trees.setdefault(place, cKDTree(now)) if place not in trees else trees[place]
                distance, _ = tree.query(before, distance_upper_bound=SAME_PLACE_PX)
                shares[row, column] = np.mean(np.isfinite(distance))
    return shares


def _best_course(shares: Floats) -> Ints:
    """The column of each row, with the largest sum of shares less the cost of changes between columns."""
    n, m = shares.shape
    cost = SHIFT_COST * np.abs(np.subtract.outer(np.arange(m), np.arange(m)))
    # In doubt without a shift, and at first.
    total = shares[0] - cost[m // 2]
    came_from = np.zeros((n, m), np.int64)
    for row in range(1, n):
        candidates = total[None, :] - cost
        came_from[row] = candidates.argmax(axis=1)
        total = candidates.max(axis=1) + shares[row]
    course = np.empty(n, np.int64)
    course[-1] = int(total.argmax())
    for row in range(n - 1, 0, -1):
        course[row - 1] = came_from[row, course[row]]
    return course


def _one_claim_each(place: Ints, share: Floats, n_places: int) -> Ints:
    """Rows that keep their place: of several at one place, the one that shows it best (the first, where alike)."""
    order = np.lexsort((np.arange(len(place)), -share))
    _, best = np.unique(place[order], return_index=True)
    rows = np.sort(order[best])
    rows = rows[(place[rows] >= 0) & (place[rows] < n_places)]
    # Places ascend: what is still out of order is a frame that only its place was given to.
    latest = np.maximum.accumulate(place[rows]) if len(rows) else place[rows]
    return np.asarray(rows[place[rows] == latest])


def _columns_by_time(first: Ints, second: Ints, frames: tuple[Ints, Ints], lowest_shift: int) -> Ints:
    """The shift (N,) of each of the baseline's frames to that of the same time, counted from the lowest; -1: none."""
    columns = np.full(len(frames[0]), -1)
    rows = np.searchsorted(frames[0], first)
    columns[rows] = np.searchsorted(frames[1], second) - rows - lowest_shift
    return columns


def _is_gain(before: Floats, now: Floats, n_tracks: Ints) -> bool:
    """Whether shares (N,) of ``n_tracks`` are larger than others, beyond what chance does."""
    if len(now) == 0:
        return False
    least = 0.5 / n_tracks
    share = np.clip((before + now) / 2, least, 1 - least)
    sigma = np.sqrt(np.sum(2 * share * (1 - share) / n_tracks))
    gain = np.sum(now - before)
    return bool(gain >= LEAST_SIGMAS * sigma and gain >= LEAST_GAIN * len(now))
