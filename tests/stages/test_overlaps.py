"""Tracks whose windows overlap do not know more than the pixels that they share."""

import numpy as np
from scipy.ndimage import uniform_filter

from ttcvid.stages.objects.overlaps import overlap_factors

EVERYTHING = np.array([True])


def factor(xy_px):
    return overlap_factors(xy_px, np.zeros(len(xy_px), dtype=np.int64), EVERYTHING)[0]


def test_tracks_apart_have_noise_of_their_own():
    assert factor(np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 20.0]])) == 1.0


def test_tracks_on_one_place_are_one():
    assert factor(np.zeros((7, 2))) == 7.0


def test_the_factor_is_that_of_means_of_windows_over_noisy_pixels():
    rng = np.random.default_rng(1)
    xy = rng.integers(10, 40, (12, 2))
    windows = np.array([uniform_filter(rng.standard_normal((50, 50)), 9)[xy[:, 1], xy[:, 0]] for _ in range(4000)])
    true_factor = windows.mean(axis=1).var() / (windows.var(axis=0).mean() / 12)
    assert abs(factor(xy.astype(float)) / true_factor - 1.0) < 0.1


def test_each_set_is_counted_by_itself_and_those_without_one_not_at_all():
    xy = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [3.0, 0.0], [0.0, 0.0]])
    set_of = np.array([0, 1, 0, -1, 2])
    np.testing.assert_allclose(overlap_factors(xy, set_of, np.array([True, True, False])), [2.0, 1.0, 1.0])
