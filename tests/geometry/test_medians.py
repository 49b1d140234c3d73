"""Medians are those of numpy, of groups group by group."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ttcvid.geometry.medians import median, medians


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 40), n_groups=st.integers(1, 6))
def test_the_median_of_each_group_is_that_of_numpy(seed, n, n_groups):
    rng = np.random.default_rng(seed)
    values, group = rng.integers(0, 9, n) / 7.0, rng.integers(0, n_groups, n)
    values[rng.random(n) < 0.2] = np.nan
    found = medians(values, group, n_groups)
    for number in range(n_groups):
        own = values[(group == number) & ~np.isnan(values)]
        np.testing.assert_equal(found[number], np.median(own) if len(own) else np.nan)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 40))
def test_the_median_is_that_of_numpy(seed, n):
    values = np.random.default_rng(seed).integers(0, 9, 2 * n)[::2] / 7.0
    assert median(values) == np.median(values)


def test_nothing_has_no_median():
    assert np.isnan(median(np.empty(0)))
