"""Medians and quantiles of short arrays, for which numpy has too much overhead."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.model import Floats, Ints


def median(values: Floats) -> float:
    """Median of finite numbers ``(N,)``; NaN without any.

    >>> median(np.array([3.0, 1.0, 2.0, 5.0]))
    2.5
    """
    return float(_median(np.ascontiguousarray(values))) if len(values) else np.nan


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
    return float(_quantile(np.ascontiguousarray(values), part))


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


@compiled_for("(f8[::1],)")
def _median(values: Floats) -> float:
    middle: float = np.median(values)
    return middle


@compiled_for("(f8[::1], f8)")
def _quantile(values: Floats, part: float) -> float:
    ordered, place = np.sort(values), part * (len(values) - 1)
    below = min(int(place), len(values) - 2) if len(values) > 1 else 0
    above = ordered[min(below + 1, len(values) - 1)]
    between: float = ordered[below] + (place - below) * (above - ordered[below])
    return between


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
        found[number] = np.median(by_group[start[number] : start[number + 1]]) if is_any else np.nan
