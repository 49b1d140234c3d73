"""Medians of groups."""

from __future__ import annotations

import numpy as np

from ttcvid.model import Floats, Ints


def medians(values: Floats, group: Ints, n_groups: int) -> Floats:
    """Median of the values of each group: (K,), NaN of an empty one.

    Parameters
    ----------
    values, group : (N,) finite numbers, and which of the ``n_groups`` K each belongs to.

    >>> medians(np.array([5.0, 1.0, 2.0, 4.0]), np.array([0, 0, 2, 0]), 3)
    array([ 4., nan,  2.])
    """
    ordered = values[np.lexsort((values, group))]
    count = np.bincount(group, minlength=n_groups)
    first = np.cumsum(count) - count
    found = np.full(n_groups, np.nan)
    has_any = count > 0
    first, count = first[has_any], count[has_any]
    found[has_any] = 0.5 * (ordered[first + (count - 1) // 2] + ordered[first + count // 2])
    return found
