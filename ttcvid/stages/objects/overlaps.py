"""Tracks that stand so close that they look at the same pixels: their noise is not each one's own."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.model import Bools, Floats, Ints

# Side of what is looked at around a track, px: the window of the tracker in the pictures.
_WINDOW_PX = 9.0


def overlap_factors(xy_px: Floats, set_of: Ints, is_asked: Bools) -> Floats:
    """By how much the variance of a mean over each set of tracks is larger than if all had noise of their own: (K,).

    Of two tracks, the part of a window that both look at is what of their noise is common. With that as correlation,
    the mean over a set has n times less variance than a track, and as many times more as a track shares windows with
    all of its set, itself among them.

    Parameters
    ----------
    xy_px, set_of : (N, 2), (N,) places, and the set of each track, negative for none.
    is_asked : (K,) the others have 1.
    """
    factor = np.ones(len(is_asked))
    if is_asked.any():
        _fill(np.ascontiguousarray(xy_px), set_of, is_asked, factor)
    return factor


@compiled_for("(f8[:, ::1], i8[::1], b1[::1], f8[::1])")
def _fill(xy: Floats, set_of: Ints, is_asked: Bools, factor: Floats) -> None:
    """Fills ``factor (K,)``."""
    # Places in order of the sets: those of set k are ``x[first[k] : first[k + 1]]`` and likewise ``y``.
    first, x, y = np.zeros(len(factor) + 1, dtype=np.int64), np.empty(len(set_of)), np.empty(len(set_of))
    for i in range(len(set_of)):
        if set_of[i] >= 0:
            first[set_of[i] + 1] += 1
    for k in range(len(factor)):
        first[k + 1] += first[k]
    end = first.copy()
    for i in range(len(set_of)):
        if set_of[i] >= 0:
            x[end[set_of[i]]], y[end[set_of[i]]] = xy[i, 0], xy[i, 1]
            end[set_of[i]] += 1
    for k in range(len(factor)):
        if not is_asked[k] or first[k] == first[k + 1]:
            continue
        common = 0.0
        for a in range(first[k], first[k + 1]):
            # Without a branch, and by an index without a sign: then several are compared at a time.
            for b in range(np.uint64(first[k]), np.uint64(a)):
                dx, dy = abs(x[b] - x[a]), abs(y[b] - y[a])
                common += max(1.0 - dx / _WINDOW_PX, 0.0) * max(1.0 - dy / _WINDOW_PX, 0.0)
        factor[k] = 1.0 + 2.0 * common / (first[k + 1] - first[k])
