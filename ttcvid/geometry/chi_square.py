"""Quantiles of the chi-square distribution.

Equal to those of scipy.stats to the last bit, but from scipy.special: importing scipy.stats takes 0.4 s and 35 MB, and
each call of it 0.1 ms.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from ttcvid.model import Floats, Ints


def chi2_quantile(probability: float, freedom: int | Ints) -> Floats:
    """Quantile at a ``probability`` in (0, 1), in the shape of ``freedom``, the degrees of freedom.

    >>> chi2_quantile(0.95, np.array([1, 2])).round(3)
    array([3.841, 5.991])
    """
    return np.asarray(2.0 * gammaincinv(np.asarray(freedom) / 2, probability))
