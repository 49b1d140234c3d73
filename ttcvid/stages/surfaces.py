"""The nearest well-supported surface of an object: what is hit first."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from ttcvid.model import Floats, Ints
from ttcvid.stages.connected import largest_connected

# A surface is borne by this part of an object's tracks, and by at least so many (or all there are).
_LEAST_PART, _LEAST_TRACKS = 0.1, 5
# Tracks within so many of their standard deviations of the surface's rate belong to it.
_SURFACE_SIGMAS = 2.0
# After a start without support the next one lies this much lower, in sigmas.
_NEXT_START_SIGMAS = 0.5
# The mean-shift from the first support settles within so many steps.
_MAX_STEPS = 20


def nearest_surface(rate_hz: Floats, sigma_hz: Floats, xy_px: Floats, link_px: float) -> Ints:
    """Tracks that bear the nearest well-supported surface: indices, empty where nothing is supported.

    The largest rate with enough connected tracks inside 2 sigma is where the search starts; it then
    moves to the weighted mean of those tracks until it stays. Without that last step the largest of N noisy rates of
    one plane would be taken for a surface of its own, two sigmas too near.

    Parameters
    ----------
    rate_hz, sigma_hz : (N,) rates, speed over depth, and their standard deviations, 1/s.
    xy_px : (N, 2) places, px; tracks closer than ``link_px`` are connected.
    """
    n = len(rate_hz)
    needed = min(n, max(_LEAST_TRACKS, int(np.ceil(_LEAST_PART * n))))
    if needed == 0:
        return np.empty(0, dtype=np.int64)
    pairs = KDTree(xy_px).query_pairs(link_px, output_type="ndarray")
    near_counts = np.count_nonzero(np.abs(rate_hz[:, None] - rate_hz) < _SURFACE_SIGMAS * sigma_hz, axis=1)
    below_hz = np.inf
    for start in np.argsort(-rate_hz, kind="stable"):
        if near_counts[start] < needed or rate_hz[start] > below_hz:
            continue
        surface = _settled(rate_hz, sigma_hz, float(rate_hz[start]), pairs)
        if len(surface) >= needed:
            return surface
        below_hz = rate_hz[start] - _NEXT_START_SIGMAS * sigma_hz[start]
    return np.empty(0, dtype=np.int64)


def weighted_mean(values: Floats, sigma: Floats) -> float:
    """Mean with weights 1 / sigma^2."""
    weight = 1.0 / sigma**2
    return float(np.sum(weight * values) / np.sum(weight))


def _settled(rate_hz: Floats, sigma_hz: Floats, centre_hz: float, pairs: Ints) -> Ints:
    """Mean-shift from a first rate to where it stays; then the largest connected set of the tracks near it."""
    support = np.empty(0, dtype=np.int64)
    for _ in range(_MAX_STEPS):
        again = np.flatnonzero(np.abs(rate_hz - centre_hz) < _SURFACE_SIGMAS * sigma_hz)
        if len(again) < len(support) or np.array_equal(again, support):
            break
        support = again
        centre_hz = weighted_mean(rate_hz[support], sigma_hz[support])
    is_in = np.zeros(len(rate_hz), dtype=bool)
    is_in[support] = True
    return largest_connected(is_in, pairs)
