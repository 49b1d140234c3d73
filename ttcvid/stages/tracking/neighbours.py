"""Which tracks are neighbours in the picture, and which are connected."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled_for
from ttcvid.model import Bools, Floats, Ints

# Tracks farther apart than so many times the distance to the nth nearest one of either have a gap between them.
_GAP, _NTH = 2.0, 3
# A pair at just the distance that is looked for is one.
_ROUNDING = 1e-9


def nearest_neighbours(xy_px: Floats, count: int, radius_px: float, is_asked: Bools, kind: Ints) -> Ints:
    """For each point asked its nearest others of its ``kind (N,)`` within the radius, unsorted: (N, count).

    The point itself stands in for missing ones. ``xy_px (N, 2)``, ``is_asked (N,)``.
    """
    neighbours = np.repeat(np.arange(len(xy_px))[:, None], count, axis=1)
    if count:
        order = np.argsort(xy_px[:, 0])
        _fill_nearest(np.ascontiguousarray(xy_px), order, radius_px, is_asked, kind, neighbours)
    return neighbours


@compiled_for("(f8[:, ::1], i8[::1], f8, b1[::1], i8[::1], i8[:, ::1])")
def _fill_nearest(xy_px: Floats, order: Ints, radius_px: float, is_asked: Bools, kind: Ints, neighbours: Ints) -> None:
    """Fill ``neighbours (N, count)``, itself of each point, of `nearest_neighbours`: a tree takes ten times as long.

    From each point a sweep to the right and one to the left, by the ``order (N,)`` of x, end at the farthest neighbour.
    """
    count, n = neighbours.shape[1], len(order)
    squares = np.empty(count)
    for place in range(n):
        i = order[place]
        if not is_asked[i]:
            continue
        found, farthest, worst = 0, radius_px * radius_px, 0
        for step, end in ((1, n), (-1, -1)):
            for other in range(place + step, end, step):
                j = order[other]
                across, down = xy_px[j, 0] - xy_px[i, 0], xy_px[j, 1] - xy_px[i, 1]
                if not across * across < farthest:
                    break
                square = across * across + down * down
                if not square < farthest or kind[j] != kind[i]:
                    continue
                # Once there are enough, each replaces the farthest one.
                at = found if found < count else worst
                squares[at], neighbours[i, at], found = square, j, min(found + 1, count)
                if found == count:
                    worst = int(np.argmax(squares))
                    farthest = squares[worst]


def linked_pairs(xy_px: Floats, radius_px: float) -> Ints:
    """All pairs of points ``(N, 2)`` closer than a radius: (M, 2), the smaller index first."""
    return _near_pairs(np.ascontiguousarray(xy_px), np.argsort(xy_px[:, 0]), radius_px)


def without_gaps(pairs: Ints, xy_px: Floats, radius_px: float) -> Ints:
    """Those of the ``pairs (M, 2)`` of near points, within a radius, without a gap; a point of few pairs has none."""
    apart_px = np.hypot(*(xy_px[pairs[:, 0]] - xy_px[pairs[:, 1]]).T)
    end, length_px = pairs.ravel(), np.repeat(apart_px, 2)
    count, spacing_px = np.bincount(end, minlength=len(xy_px)), np.full(len(xy_px), radius_px)
    has_nth, nth = count >= _NTH, np.cumsum(count) - count + _NTH - 1
    # By point, and the pairs of each by their length: one sort takes a fifth of the time of two.
    by_length = np.argsort(end + 0.5 * length_px / radius_px)
    spacing_px[has_nth] = length_px[by_length[nth[has_nth]]]
    farthest_px = _GAP * np.maximum(*spacing_px[pairs.T])
    return pairs.take(np.flatnonzero(apart_px <= farthest_px), axis=0)


def pairs_without_gaps(xy_px: Floats, radius_px: float) -> Ints:
    """`without_gaps` of all pairs of points ``(N, 2)`` within a radius; few of these are as near as that."""
    n = len(xy_px)
    nearest = nearest_neighbours(xy_px, _NTH, radius_px, np.ones(n, dtype=bool), np.zeros(n, dtype=np.int64))
    off_px = xy_px[nearest] - xy_px[:, None]
    has_nth = (nearest != np.arange(n)[:, None]).all(axis=1)
    spacing_px = np.where(has_nth, np.hypot(off_px[..., 0], off_px[..., 1]).max(axis=1), radius_px)
    pairs = linked_pairs(xy_px, min(radius_px, (1.0 + _ROUNDING) * _GAP * spacing_px.max(initial=_ROUNDING)))
    return without_gaps(pairs, xy_px, radius_px)


@compiled_for("(f8[:, ::1], i8[::1], f8)")
def _near_pairs(xy_px: Floats, order: Ints, radius_px: float) -> Ints:
    """`linked_pairs`, by a sweep from left to right, the ``order (N,)``: a tree takes five times as long."""
    by_x, n_pairs, pairs = xy_px[order], 0, np.empty((0, 2), dtype=np.int64)
    for is_counted in (False, True):
        if is_counted:
            pairs = np.empty((n_pairs, 2), dtype=np.int64)
        n_pairs = 0
        for i in range(len(order)):
            for j in range(i + 1, len(order)):
                across, down = by_x[j, 0] - by_x[i, 0], by_x[j, 1] - by_x[i, 1]
                if not across < radius_px:
                    break
                is_near = across * across + down * down < radius_px * radius_px
                if is_near and is_counted:
                    pairs[n_pairs, 0], pairs[n_pairs, 1] = min(order[i], order[j]), max(order[i], order[j])
                n_pairs += is_near
    return pairs


def connected_parts(is_in: Bools, pairs: Ints) -> Ints:
    """Number of the part that each of the tracks ``is_in (N,)`` belongs to, joined by ``pairs (M, 2)`` of tracks: (N,).

    The others have numbers of their own. Parts are numbered by their first track.
    """
    first = np.arange(len(is_in))
    _join(pairs.take(np.flatnonzero(is_in[pairs[:, 0]] & is_in[pairs[:, 1]]), axis=0), first)
    return np.asarray(np.cumsum(first == np.arange(len(is_in)))[first] - 1)


@compiled_for("(i8[:, ::1], i8[::1])")
def _join(pairs: Ints, first: Ints) -> None:
    """Bring ``first (N,)``, itself of each track, to the first track of its part, by union-find.

    Compiled: what scipy's connected components take to be called is a tenth of the time of a frame.
    """
    for m in range(len(pairs)):
        one, other = pairs[m, 0], pairs[m, 1]
        while first[one] != one:
            first[one] = first[first[one]]
            one = first[one]
        while first[other] != other:
            first[other] = first[first[other]]
            other = first[other]
        first[max(one, other)] = min(one, other)
    for i in range(len(first)):
        # What comes before it is done.
        first[i] = first[first[i]]
