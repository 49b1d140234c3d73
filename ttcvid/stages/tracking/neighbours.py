"""Which tracks are neighbours in the picture, and which are connected."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from ttcvid.compiled import compiled_for
from ttcvid.model import Bools, Floats, Ints


def nearest_neighbours(xy_px: Floats, count: int, radius_px: float, is_asked: Bools, is_beside: Bools) -> Ints:
    """Points' nearest others closer than a radius: (N, count), the point itself standing in for missing ones.

    Parameters
    ----------
    xy_px : (N, 2). Nearer ones first.
    is_asked, is_beside : (N,) points whose neighbours are asked for, and points to which others are: what neither is
        asked for nor has one of these within the radius gets no neighbours.
    """
    neighbours = np.repeat(np.arange(len(xy_px))[:, None], count, axis=1)
    is_wanted, others = is_asked | is_beside, np.flatnonzero(~(is_asked | is_beside))
    if is_beside.any():
        near_px, _ = _tree(xy_px[is_beside]).query(xy_px[others], distance_upper_bound=radius_px)
        is_wanted[others] = np.isfinite(near_px)
    wanted = np.flatnonzero(is_wanted)
    if len(wanted):
        _, near = _tree(xy_px).query(xy_px[wanted], np.arange(1, count + 2), distance_upper_bound=radius_px)
        # Itself is the first of them; of points in one place another one may be, and takes its turn.
        near = np.where(near == wanted[:, None], near[:, :1], near)[:, 1:]
        neighbours[wanted] = np.where(near < len(xy_px), near, wanted[:, None])
    return neighbours


def linked_pairs(xy_px: Floats, radius_px: float) -> Ints:
    """All pairs of points ``(N, 2)`` closer than a radius: (M, 2), the smaller index first."""
    if not len(xy_px):
        return np.empty((0, 2), dtype=np.int64)
    # The tree's pairs may be as far apart as the radius.
    pairs = _tree(xy_px).query_pairs(np.nextafter(radius_px, 0.0), output_type="ndarray")
    return np.asarray(pairs, dtype=np.int64)


def connected_parts(is_in: Bools, pairs: Ints) -> Ints:
    """Number of the part that each of the tracks ``is_in (N,)`` belongs to, joined by ``pairs (M, 2)`` of tracks: (N,).

    The others have numbers of their own. Parts are numbered by their first track.
    """
    return _parts(len(is_in), pairs[is_in[pairs[:, 0]] & is_in[pairs[:, 1]]])


def linked_parts(xy_px: Floats, radius_px: float, group: Ints, value: Floats, tolerance: Floats) -> Ints:
    """Number of the part that each point belongs to, (N,), numbered by their first point.

    Two points are connected when they lie closer than a radius, are of one group, and their values differ by less than
    the sum of their tolerances.

    Parameters
    ----------
    xy_px : (N, 2); ``group, value, tolerance (N,)``.
    """
    pairs = linked_pairs(xy_px, radius_px)
    one, other = pairs.T
    is_one = (group[one] == group[other]) & (np.abs(value[one] - value[other]) < tolerance[one] + tolerance[other])
    return _parts(len(xy_px), pairs[is_one])


def _parts(n: int, pairs: Ints) -> Ints:
    """Number of the part that each of N tracks belongs to, joined by ``pairs (M, 2)``: (N,)."""
    first = np.arange(n)
    _join(pairs, first)
    return np.asarray(np.cumsum(first == np.arange(n))[first] - 1)


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


def _tree(xy_px: Floats) -> KDTree:
    """Of points (N, 2) that are asked about once: a balanced tree costs more than it saves."""
    return KDTree(xy_px, balanced_tree=False, compact_nodes=False)
