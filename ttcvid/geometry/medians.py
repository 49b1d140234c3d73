"""Medians of short arrays, for which numpy has too much overhead."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.kernels.medians import fill_medians
from ttcvid.model import Bools, Floats, Ints

MEDIAN_NORMAL = 0.6745
"""Median of the absolute value of a standard normal variable."""
MEDIAN_RAYLEIGH = 1.1774
"""Median of the length of two of them."""


def median(values: Floats) -> float:
    """Median of finite numbers ``(N,)``; NaN without any.

    >>> median(np.array([3.0, 1.0, 2.0, 5.0]))
    2.5
    """
    ordered, n = np.sort(values), len(values)
    return 0.5 * float(ordered[(n - 1) // 2] + ordered[n // 2]) if n else np.nan


def medians(values: Floats, group: Ints, n_groups: int) -> Floats:
    """Medians ``(K,)`` of the ``values (N,)`` that belong to each of K groups: ``group (N,)`` from 0.

    Values that are NaN are left out; NaN for a group without any.

    >>> medians(np.array([5.0, 1.0, 2.0, 4.0]), np.array([0, 0, 2, 0]), 3)
    array([ 4., nan,  2.])
    """
    found = np.empty(n_groups)
    fill_medians(np.ascontiguousarray(values), np.ascontiguousarray(group), found)
    return found


def row_medians(values: Floats, is_known: Bools) -> Floats:
    """Median of the known ones of each row of ``values (L, M)``: (L,), NaN without any.

    >>> row_medians(np.array([[5.0, 1.0, 2.0, 4.0]]), np.array([[True, True, False, True]]))
    array([4.])
    """
    row = np.repeat(np.arange(len(values)), values.shape[1])
    return medians(np.where(is_known, values, np.nan).ravel(), row, len(values))
