"""Tracks that stand so close that they look at the same pixels: their noise is not each one's own."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled
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
    order = np.argsort(set_of, kind="stable")
    first = np.searchsorted(set_of[order], np.arange(len(is_asked) + 1))
    _fill(np.ascontiguousarray(xy_px), order, first, is_asked, factor)
    return factor


@compiled
def _fill(xy: Floats, order: Ints, first: Ints, is_asked: Bools, factor: Floats) -> None:
    """Fills ``factor (K,)``; the tracks of set k are ``order[first[k] : first[k + 1]]``."""
    for k in range(len(factor)):
        if not is_asked[k] or first[k] == first[k + 1]:
            continue
        common = 0.0
        for a in range(first[k], first[k + 1]):
            x, y = xy[order[a], 0], xy[order[a], 1]
            for b in range(first[k], a):
                dx, dy = abs(xy[order[b], 0] - x), abs(xy[order[b], 1] - y)
                if dx < _WINDOW_PX and dy < _WINDOW_PX:
                    common += (1.0 - dx / _WINDOW_PX) * (1.0 - dy / _WINDOW_PX)
        factor[k] = 1.0 + 2.0 * common / (first[k + 1] - first[k])
