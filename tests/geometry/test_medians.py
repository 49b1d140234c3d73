"""Medians of groups are those of numpy, group by group."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ttcvid.geometry.medians import medians


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 40), n_groups=st.integers(1, 6))
def test_the_median_of_each_group_is_that_of_numpy(seed, n, n_groups):
    rng = np.random.default_rng(seed)
    values, group = rng.integers(0, 9, n) / 7.0, rng.integers(0, n_groups, n)
    found = medians(values, group, n_groups)
    for number in range(n_groups):
        own = values[group == number]
        np.testing.assert_equal(found[number], np.median(own) if len(own) else np.nan)
