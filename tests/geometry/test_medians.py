"""Medians are those of numpy, of groups group by group."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ttcvid.geometry.kernels.medians import median as median_in_place
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


@given(st.lists(st.sampled_from([0.0, 1.0, 2.0, np.inf, -np.inf]), min_size=1, max_size=12))
def test_infinite_values_are_the_farthest_out(values):
    ordered, n = np.sort(values), len(values)
    if n % 2 == 1 or np.isfinite(ordered[n // 2 - 1 : n // 2 + 1]).all():
        assert median_in_place(np.array(values)) == 0.5 * (ordered[(n - 1) // 2] + ordered[n // 2])


@given(st.lists(st.sampled_from([0.0, 1.0, np.inf, np.nan]), min_size=1, max_size=12))
def test_what_is_no_number_does_not_keep_the_search_going(values):
    found = median_in_place(np.array(values))
    assert np.isnan(found) or found in (0.0, 0.5, 1.0, np.inf)
