"""Division that answers a zero denominator with NaN instead of a warning."""

from __future__ import annotations

import numpy as np

from ttcvid.model import Floats


def quotient(numerator: Floats | float, denominator: Floats | float) -> Floats:
    """``numerator / denominator``, broadcast; NaN where the denominator is zero or NaN.

    >>> quotient(np.array([1.0, 1.0]), np.array([4.0, 0.0]))
    array([0.25,  nan])
    """
    numerator, denominator = np.broadcast_arrays(np.asarray(numerator, dtype=np.float64), denominator)
    result: Floats = np.divide(numerator, denominator, out=np.full(numerator.shape, np.nan), where=denominator != 0.0)
    return result
