"""The nearest well-supported surfaces of objects: what is hit first."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled, compiled_for
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.tracking.groups import TrackSets

# A surface needs this part of an object's tracks, and at least so many: with fewer, the depth of a nearly lost mover
# is not reliable enough for a warning.
_LEAST_PART, LEAST_TRACKS = 0.1, 5
# Tracks within so many of their standard deviations of the surface's rate belong to it.
_SURFACE_SIGMAS = 2.0
# After a start without support the next one lies this much lower, in sigmas.
_NEXT_START_SIGMAS = 0.5
# The mean-shift from the first support settles within so many steps.
_MAX_STEPS = 20


def in_nearest_surface(
    rate_hz: Floats, sigma_hz: Floats, xy_px: Floats, sets: TrackSets, needed: Ints, link_px: float
) -> Bools:
    """Which tracks ``(M,)`` of each group support its nearest surface; none where nothing is supported.

    The search starts at the largest rate with enough connected tracks inside 2 sigma, and then moves to the weighted
    mean of those tracks until it stays. Without that last step the largest of N noisy rates of one plane would be taken
    for a surface of its own, two sigmas too near.

    Parameters
    ----------
    rate_hz, sigma_hz, xy_px : ``(M,), (M,), (M, 2)`` rates, speed over depth, and their standard deviations, 1/s, and
        positions, in the order of the groups.
    needed : ``(K,)`` tracks that a surface needs, see `tracks_needed`.
    link_px : Tracks closer than this are connected.
    """
    is_in = np.zeros(len(rate_hz), dtype=bool)
    _find_each(rate_hz, sigma_hz, np.ascontiguousarray(xy_px), link_px, sets.lengths, needed, is_in)
    return is_in


def tracks_needed(n_tracks: Ints) -> Ints:
    """Tracks ``(K,)`` that a surface of objects of ``n_tracks (K,)`` needs; those without a rate count as well."""
    of_many = np.maximum(LEAST_TRACKS, np.ceil(_LEAST_PART * n_tracks).astype(np.int64))
    # All of one track fewer agree by chance less often than the least number of many do. (So an aircraft or a car far
    # off has a time one second earlier; three that agree are what is left behind a post.)
    return np.asarray(np.where(n_tracks == LEAST_TRACKS - 1, n_tracks, of_many))


@compiled_for("(f8[::1], f8[::1], f8[:, ::1], f8, i8[::1], i8[::1], b1[::1])")
def _find_each(rate: Floats, sigma: Floats, xy: Floats, link: float, lengths: Ints, needed: Ints, is_in: Bools) -> None:
    """Fills ``is_in (M,)``, set by set, with the surface that the largest rate with enough support leads to."""
    high, part = 0, np.empty(len(rate), dtype=np.int64)
    for k in range(len(lengths)):
        low, high = high, high + lengths[k]
        own, last, below, is_found = is_in[low:high], -1, np.inf, False
        while not is_found:
            # The next lower rate, in the order of rates and then of places. The first few lead to a surface: to sort
            # all would take longer.
            start = -1
            for i in range(low, high):
                is_next = last < 0 or rate[i] < rate[last] or (rate[i] == rate[last] and i > last)
                if is_next and rate[i] <= below and (start < 0 or rate[i] > rate[start]):
                    start = i
            if start < 0:
                own[:] = False
                break
            last = start
            if _settle(rate[low:high], sigma[low:high], rate[start], needed[k], own):
                is_found = _keep_largest_part(xy[low:high], link, own, part) >= needed[k]
                below = rate[start] - _NEXT_START_SIGMAS * sigma[start]


@compiled
def _settle(rate: Floats, sigma: Floats, centre: float, needed: int, is_in: Bools) -> bool:
    """Mean-shift from a first rate to where it stays: ``is_in`` is the support there. False with too few at first."""
    again, count = np.empty(len(rate), dtype=np.bool_), 0
    for step in range(_MAX_STEPS):
        found, is_same = 0, step > 0
        for i in range(len(rate)):
            again[i] = abs(rate[i] - centre) < _SURFACE_SIGMAS * sigma[i]
            found += again[i]
            is_same &= again[i] == is_in[i]
        if step == 0 and found < needed:
            return False
        if found < count or is_same:
            break
        count, total, weights = found, 0.0, 0.0
        for i in range(len(rate)):
            is_in[i] = again[i]
            if is_in[i]:
                weight = 1.0 / (sigma[i] * sigma[i])
                total += weight * rate[i]
                weights += weight
        centre = total / weights
    return True


@compiled
def _keep_largest_part(xy: Floats, link: float, is_in: Bools, part: Ints) -> int:
    """Leaves in ``is_in`` its largest part that hangs together; how many tracks that has.

    ``part (N,)`` is scratch: the tracks in order of the parts, each part grown from its first track by all that are
    near to one of it.
    """
    count = 0
    for i in range(len(is_in)):
        if is_in[i]:
            part[count] = i
            count += 1
    best_first, best_stop, first = 0, 0, 0
    while first < count:
        next_, stop = first, first + 1
        while next_ < stop:
            x, y = xy[part[next_], 0], xy[part[next_], 1]
            for place in range(stop, count):
                i = part[place]
                if (xy[i, 0] - x) ** 2 + (xy[i, 1] - y) ** 2 < link * link:
                    part[place], part[stop] = part[stop], i
                    stop += 1
            next_ += 1
        if stop - first > best_stop - best_first:
            best_first, best_stop = first, stop
        first = stop
    is_in[:] = False
    for place in range(best_first, best_stop):
        is_in[part[place]] = True
    return best_stop - best_first
