"""The velocity of a small thing by how it moves and grows: exact without noise, as sure as it says with it."""

import numpy as np
import pytest

from ttcvid.geometry.estimation.growth import growth_sums

SINCE_S = -0.05 * np.arange(20.0)[::-1]
CENTRE_M, N_POINTS, SIGMA = np.array([60.0, -5.0, 240.0]), 4, 0.1 / 880.0
VELOCITY_M_S = np.array([-20.0, 2.0, -75.0])


def seen(rng, velocity_m_s=VELOCITY_M_S, n=N_POINTS, sigma=0.0, size_m=(11.0, 3.0, 0.0)):
    """Places (L, M, 2) of points of a thing that moves past a camera which does not turn."""
    where = CENTRE_M + rng.uniform(-0.5, 0.5, (n, 3)) * size_m
    moved = where + SINCE_S[:, None, None] * np.asarray(velocity_m_s)
    return moved[:, :, :2] / moved[:, :, 2:] + sigma * rng.normal(size=(len(SINCE_S), n, 2))


def fitted(xy, members=None):
    sums = growth_sums(xy, SINCE_S, np.full(xy.shape[1], SIGMA))
    return sums, *sums.unknowns(np.ones(xy.shape[1], dtype=bool) if members is None else members)


@pytest.mark.parametrize("velocity_m_s", [VELOCITY_M_S, (0.0, 0.0, -75.0), (30.0, 0.0, 0.0), (3.0, 1.0, 20.0)])
def test_the_velocity_over_the_depth_is_exact_without_noise(velocity_m_s):
    sums, unknowns, _ = fitted(seen(np.random.default_rng(1), velocity_m_s))
    np.testing.assert_allclose(unknowns, np.asarray(velocity_m_s) / CENTRE_M[2], rtol=1e-9, atol=1e-12)
    assert sums.redchi_of(unknowns).max() < 1e-6


def test_views_that_are_missing_change_nothing():
    xy = seen(np.random.default_rng(2))
    xy[:7, 0], xy[3, 2], xy[12, 3] = np.nan, np.nan, np.nan
    _, unknowns, _ = fitted(xy)
    np.testing.assert_allclose(unknowns, VELOCITY_M_S / CENTRE_M[2], rtol=1e-9)


def test_a_velocity_is_as_sure_as_it_says_and_its_tracks_fit_it():
    """Of what has hardly come nearer while it was seen: of what has, older views would have to count less."""
    velocity_m_s = VELOCITY_M_S / 5.0
    chi2, redchi_of = [], []
    for seed in range(400):
        sums, unknowns, cov = fitted(seen(np.random.default_rng(seed), velocity_m_s, sigma=SIGMA))
        off = unknowns - velocity_m_s / CENTRE_M[2]
        chi2.append(off @ np.linalg.solve(cov, off))
        redchi_of.append(sums.redchi_of(unknowns))
    # Three degrees of freedom; those of the places are taken out, those of the velocity are shared.
    assert 2.4 < np.mean(chi2) < 3.8
    assert np.mean(np.array(chi2) < 11.3) > 0.97
    assert 0.85 < np.mean(redchi_of) < 1.05


def test_each_set_has_its_own_velocity_and_a_track_of_another_thing_does_not_fit_it():
    rng = np.random.default_rng(3)
    other_m_s = np.array([10.0, 0.0, -30.0])
    xy = np.concatenate([seen(rng), seen(rng, other_m_s)], axis=1)
    is_first = np.arange(2 * N_POINTS) < N_POINTS
    for members, velocity_m_s in ((is_first, VELOCITY_M_S), (~is_first, other_m_s)):
        sums, unknowns, _ = fitted(xy, members)
        np.testing.assert_allclose(unknowns * CENTRE_M[2], velocity_m_s, rtol=1e-9, atol=1e-9)
        redchi_of = sums.redchi_of(unknowns)
        assert redchi_of[members].max() < 1e-6
        assert redchi_of[~members].min() > 50.0


def test_the_tracks_of_the_first_are_found_among_those_of_another_thing():
    rng = np.random.default_rng(4)
    xy = np.concatenate([seen(rng, sigma=SIGMA), seen(rng, (10.0, 0.0, -30.0), sigma=SIGMA)], axis=1)
    sums = growth_sums(xy, SINCE_S, np.full(xy.shape[1], SIGMA))
    fits = sums.sharing_a_velocity(np.full(xy.shape[1], 100.0), gate=10.0, least_tracks=N_POINTS)
    np.testing.assert_array_equal(fits, np.arange(2 * N_POINTS) < N_POINTS)
    assert sums.sharing_a_velocity(np.full(xy.shape[1], 100.0), gate=10.0, least_tracks=N_POINTS + 1) is None
    # What the scene explains as well is no thing of its own.
    assert sums.sharing_a_velocity(np.zeros(xy.shape[1]), gate=10.0, least_tracks=1) is None


def test_tracks_that_are_seen_once_tell_nothing():
    xy = np.full((len(SINCE_S), 3, 2), np.nan)
    xy[-1] = 0.1
    _, unknowns, cov = fitted(xy)
    assert np.isnan(unknowns).all()
    assert np.isnan(cov).all()
