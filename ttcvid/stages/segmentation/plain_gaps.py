"""Gaps in the picture between tracks of things: whether anything else is seen in them."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.model import Bools, Floats, Ints

# A plain part between two others is as long as this part of the larger one at the most: a thing shows more of itself
# than it hides. Across wider gaps what stands far apart became one.
_WIDEST = 0.75


def across_plain_gaps(
    xy_px: Floats, thing: Ints, is_told: Bools, part: Ints, one: Ints, other: Ints, least_px: float = 0.0
) -> Bools:
    """Which pairs of parts have nothing else between them, a gap no wider than three quarters of the larger one.

    A plain coat gives no tracks, so that somebody's head and legs do not hang together by them. Asked is what is seen
    in the circle over the middle half of the gap: beside somebody's neck there is the street.

    Parameters
    ----------
    xy_px : (N, 2) tracks, px.
    thing : (N,) what each track belongs to; those of the things of both parts are nothing else.
    is_told : (N,) tracks that have been seen for long enough to belong anywhere.
    part : (N,) number of the part that each track is in, -1 for none.
    one, other : (P,) pairs of parts, which have tracks.
    least_px : parts that are nearer than this have no gap between them: False.
    """
    is_plain = np.zeros(len(one), dtype=bool)
    if len(one):
        _look_between(np.ascontiguousarray(xy_px), thing, is_told, part, one, other, least_px, is_plain)
    return is_plain


@compiled_for("(f8[:, ::1], i8[::1], b1[::1], i8[::1], i8[::1], i8[::1], f8, b1[::1])")
def _look_between(
    xy: Floats, thing: Ints, is_told: Bools, part: Ints, one: Ints, other: Ints, least_px: float, is_plain: Bools
) -> None:
    """Fill ``is_plain (P,)``."""
    for p in range(len(one)):
        first, second = np.flatnonzero(part == one[p]), np.flatnonzero(part == other[p])
        a, b, square = _closest(xy, first, second)
        widest = _WIDEST * max(_length(xy, first), _length(xy, second))
        if not least_px**2 <= square < widest**2:
            continue
        x, y, is_plain[p] = 0.5 * (xy[a, 0] + xy[b, 0]), 0.5 * (xy[a, 1] + xy[b, 1]), True
        for i in range(len(xy)):
            if is_told[i] and thing[i] != thing[a] and thing[i] != thing[b]:
                off2 = (xy[i, 0] - x) ** 2 + (xy[i, 1] - y) ** 2
                # Half of the gap is the diameter.
                is_plain[p] &= off2 > square / 16.0


@compiled
def _closest(xy: Floats, first: Ints, second: Ints) -> tuple[int, int, float]:
    """The nearest two of some points and some others, and their squared distance."""
    a, b, least = 0, 0, np.inf
    for m in range(len(first)):
        for n in range(len(second)):
            i, j = first[m], second[n]
            square = (xy[i, 0] - xy[j, 0]) ** 2 + (xy[i, 1] - xy[j, 1]) ** 2
            if square < least:
                a, b, least = i, j, square
    return a, b, least


@compiled
def _length(xy: Floats, members: Ints) -> float:
    """The longer side of the box around some points."""
    longest = 0.0
    for axis in range(2):
        low, high = np.inf, -np.inf
        for m in range(len(members)):
            low, high = min(low, xy[members[m], axis]), max(high, xy[members[m], axis])
        longest = max(longest, high - low)
    return longest
