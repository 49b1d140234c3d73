"""Medians of few numbers."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled, compiled_for, compiled_in_place
from ttcvid.model import Floats, Ints


@compiled
def median(values: Floats) -> float:
    """The median of ``values (N,)``, which are put into another order; NaN without any."""
    n = len(values)
    if n == 0:
        return np.nan
    # The upper middle one comes to its place: no smaller ones behind it, no larger ones before it.
    low, high, place = 0, n - 1, n // 2
    while low < high:
        one, other, third = values[low], values[place], values[high]
        pivot = max(min(one, other), min(max(one, other), third))
        first = _smaller_to_front(values, low, high, pivot)
        if first == low:
            # Nothing is smaller: those that are as small come first.
            first = _smaller_to_front(values, low, high, np.nextafter(pivot, np.inf))
            # Infinite ones are above all, and NaN is above nothing: either is where it belongs.
            if place < first or first == low:
                break
        if place < first:
            high = first - 1
        else:
            low = first
    if n % 2 == 1:
        return float(values[place])
    lower = values[0]
    for i in range(1, place):
        lower = max(lower, values[i])
    middle: float = 0.5 * (lower + values[place])
    return middle


@compiled_in_place
def _smaller_to_front(values: Floats, low: int, high: int, pivot: float) -> int:
    """Bring those of ``low ... high`` below the pivot to the front, without a branch; return where the others begin."""
    first = low
    for j in range(low, high + 1):
        value = values[j]
        values[j], values[first] = values[first], value
        first += 1 if value < pivot else 0
    return first


@compiled_for("(f8[::1], i8[::1], f8[::1])")
def fill_medians(values: Floats, group: Ints, found: Floats) -> None:
    """Fill ``found (K,)``, the medians of `geometry.medians.medians`."""
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
        found[number] = median(by_group[start[number] : start[number + 1]]) if is_any else np.nan
