"""Division that answers a zero denominator with NaN instead of a warning."""

from __future__ import annotations

import numpy as np

from ttcvid.model import Floats


def quotient(numerator: Floats | float, denominator: Floats | float) -> Floats:
    """``numerator / denominator``, broadcast; NaN where the denominator is zero or NaN.

    >>> quotient(np.array([1.0, 1.0]), np.array([4.0, 0.0]))
    array([0.25,  nan])
    """
    denominator = np.asarray(denominator, dtype=np.float64)
    return np.asarray(numerator / np.where(denominator == 0.0, np.nan, denominator))
