"""Tracks so close that their windows see the same pixels: their noise is correlated."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.model import Bools, Floats, Ints

# Side of what is looked at around a track, px: the window of the tracker in the pictures.
_WINDOW_PX = 9.0


def overlap_factors(xy_px: Floats, set_of: Ints, is_asked: Bools) -> Floats:
    """Factor on the variance of a mean over each group of tracks, relative to independent noise: ``(K,)``.

    The correlation of two tracks is the overlap of their windows. A mean over n tracks has n times less variance than a
    track, times the mean number of tracks that a track of the group shares its window with, itself included.

    Parameters
    ----------
    xy_px, set_of
        ``(N, 2)``, ``(N,)`` positions, and the group of each track, negative for none.
    is_asked
        ``(K,)``; the others have 1.
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
