"""The chi-square distribution against the one of scipy.stats."""

import numpy as np
import pytest
from scipy.stats import chi2

from ttcvid.geometry.chi_square import chi2_quantile


@pytest.mark.parametrize("probability", [1e-6, 0.5, 0.95, 0.99, 1 - 1e-9])
def test_quantiles_are_those_of_scipy_to_the_last_bit(probability):
    freedom = np.array([1, 2, 3, 5, 40])
    np.testing.assert_array_equal(chi2_quantile(probability, freedom), chi2.ppf(probability, freedom))


@pytest.mark.parametrize("freedom", [1, 2, 5])
def test_quantiles_undo_the_probabilities_of_scipy(freedom):
    assert chi2.cdf(float(chi2_quantile(0.99, freedom)), freedom) == pytest.approx(0.99, rel=1e-12)
