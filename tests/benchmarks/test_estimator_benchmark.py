"""The benchmark of the estimator can fail: its bound is the known one, and a worse estimate is seen."""

from dataclasses import replace

import numpy as np
import pytest
from estimator import CASES, Tracks, bound_of_eta, coverage, draw, estimate


@pytest.mark.parametrize(("n_frames", "percent"), [(3, 224.0), (10, 9.0), (20, 1.8)])
def test_the_bound_is_the_known_one_of_a_point_at_a_hundred_metres(n_frames, percent):
    place, rate = np.array([[0.5, 0.0, 1.0]]), np.array([[0.0, 0.0, -50.0 / 3.6 / 100.0]])
    tracks = Tracks(place, rate, -np.arange(n_frames) / 12.0, np.empty(0), np.array([0.2 / 1720.0]))
    assert 100.0 * bound_of_eta("general", tracks)[0] / -rate[0, 2] == pytest.approx(percent, rel=0.15)


@pytest.mark.parametrize("case", CASES)
def test_the_estimate_keeps_its_bars_and_one_that_is_told_half_of_the_noise_does_not(case):
    tracks = draw(case, 40, 20, 0.2, 1500, np.random.default_rng(7))
    found, bound = estimate(case, tracks), bound_of_eta(case, tracks)
    chosen = bound < -0.3 * tracks.rate[:, 2]
    ratio = np.sqrt(np.mean(((found.eta_hz + tracks.rate[:, 2])[chosen] / bound[chosen]) ** 2))
    assert 0.9 < ratio < 1.1
    assert 0.87 <= coverage(tracks, found, chosen)[0] <= 0.93
    told_half = estimate(case, replace(tracks, sigma_norm=0.5 * tracks.sigma_norm))
    assert coverage(tracks, told_half, chosen)[0] < 0.85
