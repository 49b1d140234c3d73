"""Medians and quantiles of short arrays, for which numpy has too much overhead."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.kernels.medians import median as median_of
from ttcvid.model import Bools, Floats, Ints


def median(values: Floats) -> float:
    """Median of finite numbers ``(N,)``; NaN without any.

    >>> median(np.array([3.0, 1.0, 2.0, 5.0]))
    2.5
    """
    return float(_median(values.astype(np.float64))) if len(values) else np.nan


def quantile(values: Floats, part: float) -> float:
    """Quantile of finite numbers, linearly interpolated.

    Parameters
    ----------
    values
        ``(N,)``, N > 0.
    part
        In [0, 1].

    >>> quantile(np.array([3.0, 1.0, 2.0, 5.0]), 0.25)
    1.75
    """
    ordered, place = np.sort(values), part * (len(values) - 1)
    below = max(min(int(place), len(values) - 2), 0)
    above = ordered[min(below + 1, len(values) - 1)]
    return float(ordered[below] + (place - below) * (above - ordered[below]))


def medians(values: Floats, group: Ints, n_groups: int) -> Floats:
    """Median of the values of each group.

    Parameters
    ----------
    values
        ``(N,)``; NaN is left out.
    group
        ``(N,)`` group of each value, from 0.
    n_groups
        Number K of groups.

    Returns
    -------
    ``(K,)``; NaN for a group without values.

    >>> medians(np.array([5.0, 1.0, 2.0, 4.0]), np.array([0, 0, 2, 0]), 3)
    array([ 4., nan,  2.])
    """
    found = np.empty(n_groups)
    _fill(np.ascontiguousarray(values), np.ascontiguousarray(group), found)
    return found


def row_medians(values: Floats, is_known: Bools) -> Floats:
    """Median of the known ones of each row of ``values (L, M)``: (L,), NaN without any.

    >>> row_medians(np.array([[5.0, 1.0, 2.0, 4.0]]), np.array([[True, True, False, True]]))
    array([4.])
    """
    if not values.shape[1]:
        return np.full(len(values), np.nan)
    ordered = np.sort(np.where(is_known, values, np.inf), axis=1)
    n = np.sum(is_known, axis=1)
    middle = np.stack([np.maximum(n - 1, 0) // 2, np.minimum(n // 2, values.shape[1] - 1)], axis=1)
    return np.where(n > 0, np.mean(np.take_along_axis(ordered, middle, axis=1), axis=1), np.nan)


@compiled_for("(f8[::1],)")
def _median(values: Floats) -> float:
    return median_of(values)


@compiled_for("(f8[::1], i8[::1], f8[::1])")
def _fill(values: Floats, group: Ints, found: Floats) -> None:
    """Fill ``found (K,)``."""
    start = np.zeros(len(found) + 1, dtype=np.int64)
    for i in range(len(values)):
        start[group[i] + 1] += 0 if np.isnan(values[i]) else 1
    for number in range(len(found)):
        start[number + 1] += start[number]
    by_group, end = np.empty(len(values)), start.copy()
    for i in range(len(values)):
        if not np.isnan(values[i]):
            by_group[end[group[i]]] = values[i]
            end[group[i]] += 1
    for number in range(len(found)):
        is_any = start[number + 1] > start[number]
        found[number] = median_of(by_group[start[number] : start[number + 1]]) if is_any else np.nan
