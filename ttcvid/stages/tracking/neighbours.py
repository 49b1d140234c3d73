"""Which tracks are neighbours in the picture, and which are connected."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.model import Bools, Floats, Ints

# The search for the nearest goes outwards by so many rings of cells.
_N_RINGS = 3
# Bits of a key that hold the index of a point: a million of them.
_INDEX = (1 << 20) - 1
# So many of those that come next are asked first whether a point hangs together with them.
_FEW = 4
# A grid along one axis has at most so many cells: more than a picture has, of points far outside it.
_MOST_CELLS = 1000


def nearest_neighbours(xy_px: Floats, count: int, radius_px: float, is_asked: Bools, is_beside: Bools) -> Ints:
    """Points' nearest others within a radius: (N, count), the point itself standing in for missing ones.

    Parameters
    ----------
    xy_px : (N, 2). Nearer ones first; of equally near ones the one with the smaller index.
    is_asked, is_beside : (N,) points whose neighbours are asked for, and points to which others are: what neither is
        asked for nor has one of these within the radius may get no neighbours.
    """
    neighbours = np.empty((len(xy_px), count), dtype=np.int64)
    if len(xy_px):
        xy_px = np.ascontiguousarray(xy_px)
        grid = _on_grid(xy_px, radius_px / _N_RINGS, _N_RINGS)
        _nearest(xy_px, grid, radius_px, is_asked, is_beside, neighbours)
    return neighbours


def linked_pairs(xy_px: Floats, radius_px: float) -> Ints:
    """All pairs of points ``(N, 2)`` closer than a radius: (M, 2), the smaller index first."""
    if len(xy_px) < 2:
        return np.empty((0, 2), dtype=np.int64)
    xy_px = np.ascontiguousarray(xy_px)
    return _pairs(xy_px, _on_grid(xy_px, radius_px, 1), radius_px)


def connected_parts(is_in: Bools, pairs: Ints) -> Ints:
    """Number of the part that each of the tracks ``is_in (N,)`` belongs to, joined by ``pairs (M, 2)`` of tracks: (N,).

    The others have numbers of their own. Parts are numbered by their first track.
    """
    label = np.empty(len(is_in), dtype=np.int64)
    _join(is_in, np.ascontiguousarray(pairs), label)
    return label


def linked_parts(xy_px: Floats, radius_px: float, group: Ints, value: Floats, tolerance: Floats) -> Ints:
    """Number of the part that each point belongs to, (N,), numbered by their first point.

    Two points are connected when they lie closer than a radius, are of one group, and their values differ by less than
    the sum of their tolerances.

    Parameters
    ----------
    xy_px : (N, 2); ``group, value, tolerance (N,)``.
    """
    label = np.zeros(len(xy_px), dtype=np.int64)
    if len(xy_px) > 1:
        xy_px = np.ascontiguousarray(xy_px)
        _link(xy_px, _on_grid(xy_px, radius_px, 1), radius_px, group, value, tolerance, label)
    return label


def _on_grid(xy_px: Floats, side_px: float, border: int) -> Ints:
    """Column and row of each point on a grid: (2, N). Where that has gaps, they are no wider than the border needs."""
    column_row = np.empty((2, len(xy_px)), dtype=np.int64)
    if _place_on_grid(xy_px, side_px, column_row) > _MOST_CELLS:
        for axis in range(2):
            if column_row[axis].max() > _MOST_CELLS:
                column_row[axis] = _without_wide_gaps(column_row[axis], border)
    return column_row


def _without_wide_gaps(number: Ints, border: int) -> Ints:
    """Columns or rows ``(N,)`` drawn together where nothing lies between: what is farther than the border stays so.

    One point far outside the picture would otherwise ask for all the cells on the way to it.
    """
    distinct, place = np.unique(number, return_inverse=True)
    steps = np.minimum(np.diff(distinct, prepend=distinct[0]), border + 1)
    return np.asarray(np.cumsum(steps)[place])


@compiled_for("(f8[:, ::1], f8, i8[:, ::1])")
def _place_on_grid(xy: Floats, side: float, column_row: Ints) -> int:
    """Fill ``column_row (2, N)`` of points ``(N, 2)``, counted from the first of each; returns the largest."""
    most = 0
    for axis in range(2):
        first = xy[0, axis]
        for i in range(len(xy)):
            first = min(first, xy[i, axis])
        for i in range(len(xy)):
            number = int(np.floor((xy[i, axis] - first) / side))
            column_row[axis, i], most = number, max(most, number)
    return most


@compiled
def _sorted_by_cell(column_row: Ints, border: int) -> tuple[Ints, Ints, Ints, int]:
    """A grid with a border of empty cells: cell of each point, points in order of cells, where each starts, width."""
    n = column_row.shape[1]
    width, height = np.max(column_row[0]) + 2 * border + 1, np.max(column_row[1]) + 2 * border + 1
    cell, order, start = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(width * height + 1, np.int64)
    for i in range(n):
        cell[i] = (column_row[1, i] + border) * width + column_row[0, i] + border
        start[cell[i] + 1] += 1
    for number in range(1, len(start)):
        start[number] += start[number - 1]
    free = start.copy()
    for i in range(n):
        order[free[cell[i]]] = i
        free[cell[i]] += 1
    return cell, order, start, width


@compiled_for("(f8[:, ::1], i8[:, ::1], f8, b1[::1], b1[::1], i8[:, ::1])")
def _nearest(
    xy_px: Floats, column_row: Ints, radius: float, is_asked: Bools, is_beside: Bools, neighbours: Ints
) -> None:
    """Fill ``neighbours (N, K)``, ring of cells by ring of cells.

    What lies beyond ring r is farther away than r cells. A candidate is one number, its squared distance with the index
    in place of the last bits: it sinks through the sorted ones before it without a branch.
    """
    cell, order, start, width = _sorted_by_cell(column_row, _N_RINGS)
    xy = xy_px[order]
    count, side, none = neighbours.shape[1], radius / _N_RINGS, _as_key(radius * radius, 0)
    nearest, n_before = np.empty(count, dtype=np.int64), np.zeros(len(xy) + 1, dtype=np.int64)
    for here in range(len(xy)):
        n_before[here + 1] = n_before[here] + is_beside[order[here]]
    for here in range(len(xy)):
        x, y, own = xy[here, 0], xy[here, 1], order[here]
        is_wanted = is_asked[own]
        for dy in range(-_N_RINGS, _N_RINGS + 1):
            at = cell[own] + dy * width
            is_wanted |= n_before[start[at + _N_RINGS + 1]] > n_before[start[at - _N_RINGS]]
        if not is_wanted:
            neighbours[own] = own
            continue
        nearest[:] = none
        for ring in range(1, _N_RINGS + 1):
            for dy in range(-ring, ring + 1):
                # Whole rows at the top and the bottom of a ring, its two ends between; the first has the middle too.
                reach = ring if abs(dy) == ring or ring == 1 else 0
                for middle in range(-ring + reach, ring - reach + 1, max(2 * ring, 1)):
                    at = cell[own] + dy * width + middle
                    for place in range(start[at - reach], start[at + reach + 1]):
                        if place != here:
                            key = _as_key((xy[place, 0] - x) ** 2 + (xy[place, 1] - y) ** 2, order[place])
                            if key < nearest[count - 1]:
                                for k in range(count):
                                    nearest[k], key = min(nearest[k], key), max(nearest[k], key)
            if nearest[count - 1] < _as_key((ring * side) ** 2, 0):
                break
        for k in range(count):
            neighbours[own, k] = nearest[k] & _INDEX if nearest[k] < none else own


@compiled
def _as_key(square: float, index: int) -> int:
    """The bits of a positive number, which are in order of its size, the last of them replaced by an index."""
    return (int(np.float64(square).view(np.int64)) & ~_INDEX) | index


@compiled_for("(f8[:, ::1], i8[:, ::1], f8)")
def _pairs(xy: Floats, column_row: Ints, radius: float) -> Ints:
    """All pairs of `linked_pairs`."""
    cell, order, start, width = _sorted_by_cell(column_row, 1)
    pairs, count = np.empty((8 * len(xy), 2), dtype=np.int64), 0
    for i in range(len(xy)):
        for dy in range(-1, 2):
            first = cell[i] + dy * width - 1
            for place in range(start[first], start[first + 3]):
                j = order[place]
                if j > i and (xy[j, 0] - xy[i, 0]) ** 2 + (xy[j, 1] - xy[i, 1]) ** 2 < radius * radius:
                    if count == len(pairs):
                        pairs = np.concatenate((pairs, np.empty_like(pairs)))
                    pairs[count, 0], pairs[count, 1] = i, j
                    count += 1
    return pairs[:count]


@compiled_for("(f8[:, ::1], i8[:, ::1], f8, i8[::1], f8[::1], f8[::1], i8[::1])")
def _link(
    xy_px: Floats, column_row: Ints, radius: float, of_group: Ints, of_value: Floats, slack: Floats, label: Ints
) -> None:
    """Fill ``label (N,)`` of `linked_parts`.

    First each point with a few that come next in the order of cells: that joins nearly all that are connected. Then
    what is not in the largest part of its group, with all around it; of two points of that nothing is left to ask.
    """
    cell, order, start, width = _sorted_by_cell(column_row, 1)
    root, xy, group, value, tolerance = (
        np.arange(len(cell)),
        xy_px[order],
        of_group[order],
        of_value[order],
        slack[order],
    )
    for here in range(len(xy)):
        at = cell[order[here]]
        _unite_with(
            root, here, here + 1, min(here + 1 + _FEW, start[at + 2]), order, xy, radius, group, value, tolerance
        )
        first = start[at + width]
        _unite_with(
            root, here, first, min(first + _FEW, start[at + width + 2]), order, xy, radius, group, value, tolerance
        )
    _number(root, label)
    size, largest = np.zeros(len(xy), dtype=np.int64), np.full(np.max(group) + 1, -1)
    for number in label:
        size[number] += 1
    for i in range(len(label)):
        if largest[of_group[i]] < 0 or size[label[i]] > size[largest[of_group[i]]]:
            largest[of_group[i]] = label[i]
    for here in range(len(xy)):
        if label[order[here]] != largest[group[here]]:
            for dy in range(-1, 2):
                at = cell[order[here]] + dy * width
                _unite_with(root, here, start[at - 1], start[at + 2], order, xy, radius, group, value, tolerance)
    _number(root, label)


@compiled
def _unite_with(
    root: Ints,
    here: int,
    first: int,
    stop: int,
    order: Ints,
    xy: Floats,
    radius: float,
    group: Ints,
    value: Floats,
    tolerance: Floats,
) -> None:
    """Unite a point with those of the places from ``first`` up to ``stop`` that it hangs together with."""
    for place in range(first, stop):
        square = (xy[place, 0] - xy[here, 0]) ** 2 + (xy[place, 1] - xy[here, 1]) ** 2
        differs = abs(value[place] - value[here]) - tolerance[place] - tolerance[here]
        # One branch, that seldom goes another way than the last time: most are known to be connected.
        is_one = (square < radius * radius) & (differs < 0.0) & (group[place] == group[here])
        if is_one & (root[order[here]] != root[order[place]]):
            _unite(root, order[here], order[place])


@compiled_for("(b1[::1], i8[:, ::1], i8[::1])")
def _join(is_in: Bools, pairs: Ints, label: Ints) -> None:
    """Fill ``label (N,)`` of `connected_parts`."""
    root = np.arange(len(is_in))
    for m in range(len(pairs)):
        if is_in[pairs[m, 0]] and is_in[pairs[m, 1]]:
            _unite(root, pairs[m, 0], pairs[m, 1])
    _number(root, label)


@compiled
def _unite(root: Ints, one: int, other: int) -> None:
    """Union-find: hang the tree with the larger root on the other one, and what is passed on the way up higher."""
    while root[one] != one:
        root[one] = root[root[one]]
        one = root[one]
    while root[other] != other:
        root[other] = root[root[other]]
        other = root[other]
    root[max(one, other)] = min(one, other)


@compiled
def _number(root: Ints, label: Ints) -> None:
    """Fill ``label (N,)``: the top of each tree of ``root (N,)``, its smallest index, has the next number, from 0."""
    count = 0
    for i in range(len(root)):
        # The smaller indices are done, and a root is never larger.
        if root[i] == i:
            label[i] = count
            count += 1
        else:
            label[i] = label[root[i]]
