"""A body on a circle before a moving camera: exact tracks give its motion exactly, noisy ones within what they say."""

import numpy as np
import pytest

from ttcvid.geometry.estimation import turning_body
from ttcvid.geometry.estimation.shared_trajectory import turned_back
from ttcvid.geometry.estimation.track_on_trajectory import fit_rates_on_paths
from ttcvid.geometry.estimation.turning_body import TURN_SIGMA_RAD_S, fit_turning_body
from ttcvid.geometry.rotation import rotation_from_vector

T_S = 0.05 * np.arange(-19.0, 1.0)
OWN_M_S = np.array([0.0, 0.0, 5.0])
WIDE_M, LONG_M = np.array([1.2, 1.2, 5.0]), np.array([0.9, 0.7, 2.1])
SIGMA = 0.1 / 500.0
BEND_HZ = 0.36


def circling(middle_m, speed_m_s, heading_rad, turn_rad_s, half_m, noise=0.0, n=40, seed=1):
    """Views (L, N, 2) of points of a body on a circle (y is down), its V (3,) and places (N, 3) now."""
    rng = np.random.default_rng(seed)
    heading = np.array([np.sin(heading_rad), 0.0, np.cos(heading_rad)])
    along = rotation_from_vector(np.array([0.0, heading_rad, 0.0]))
    offset = rng.uniform(-1.0, 1.0, (n, 3)) * half_m @ along.T
    turn = np.array([0.0, turn_rad_s, 0.0])
    rotation = rotation_from_vector(T_S[:, None] * turn)
    # omega x (M - O) is the velocity: the circle's middle O lies beside the body.
    to_middle = speed_m_s / turn_rad_s * np.cross(heading, [0.0, 1.0, 0.0])
    circle = middle_m - to_middle
    place = circle + (rotation @ to_middle)[:, None] + np.einsum("lij,nj->lni", rotation, offset)
    place -= T_S[:, None, None] * OWN_M_S
    xy = place[..., :2] / place[..., 2:] + noise * rng.standard_normal((len(T_S), n, 2))
    return xy, speed_m_s * heading - OWN_M_S, place[-1]


BUS = (np.array([3.0, 0.3, 15.0]), 6.3, -2.0, -0.45, WIDE_M)
CAR = (np.array([4.0, 0.2, 12.0]), 5.0, -1.2, 0.35, LONG_M)


@pytest.mark.parametrize("body", [BUS, CAR])
def test_exact_views_of_a_body_on_a_circle_give_its_turn(body):
    xy, *_ = circling(*body)
    # The beliefs of the fit pull a little: with so little noise they do not count.
    found = fit_turning_body(xy, T_S, np.full(40, 1e-8), BEND_HZ, TURN_SIGMA_RAD_S)
    np.testing.assert_allclose(found.turn_rad_s, [0.0, body[3], 0.0], atol=1e-5)
    assert found.median_chi2 < 1e-3


@pytest.mark.parametrize("body", [BUS, CAR])
def test_each_point_has_its_own_velocity_on_the_path_turned_back(body):
    xy, velocity, place = circling(*body)
    found = fit_turning_body(xy, T_S, np.full(40, 1e-8), BEND_HZ, TURN_SIGMA_RAD_S)
    path_of = np.zeros(40, dtype=np.int64)
    views = turned_back(xy, T_S, found.turn_rad_s[None], path_of)
    rates = fit_rates_on_paths(views, T_S, np.full(40, 1e-5), found.path_turned_back(T_S)[None], path_of)
    turn = np.array([0.0, body[3], 0.0])
    said = rates.rate_hz[:, None] * found.start + np.cross(turn, place / place[:, 2:])
    true = (velocity + np.cross(turn, place - body[0])) / place[:, 2:]
    np.testing.assert_allclose(said, true, atol=1e-4)


@pytest.mark.parametrize("body", [BUS, CAR])
def test_a_turn_is_as_sure_as_it_says(body):
    errors = []
    for seed in range(24):
        xy, *_ = circling(*body, noise=SIGMA, seed=seed)
        found = fit_turning_body(xy, T_S, np.full(40, SIGMA), BEND_HZ, TURN_SIGMA_RAD_S)
        errors.append((found.turn_rad_s[1] - body[3]) / np.sqrt(found.cov[7, 7]))
    assert 0.6 < np.std(errors) < 1.4
    assert np.mean(np.abs(errors) < 1.645) >= 0.8


def test_what_does_not_turn_is_not_said_to():
    rng = np.random.default_rng(5)
    place = np.array([2.0, 0.0, 20.0]) + rng.uniform(-1.0, 1.0, (30, 3)) * LONG_M
    views = place + T_S[:, None, None] * np.array([-3.0, 0.0, -6.0])
    xy = views[..., :2] / views[..., 2:] + SIGMA * rng.standard_normal((len(T_S), 30, 2))
    found = fit_turning_body(xy, T_S, np.full(30, SIGMA), BEND_HZ, TURN_SIGMA_RAD_S)
    assert np.all(np.abs(found.turn_rad_s) < 3.5 * np.sqrt(np.diag(found.cov)[6:]))


def test_a_few_points_far_away_do_not_claim_to_know_the_turn():
    errors, sigmas = [], []
    for seed in range(24):
        xy, *_ = circling(np.array([5.0, 0.2, 40.0]), 6.0, -1.0, 0.3, LONG_M, SIGMA, n=6, seed=seed)
        found = fit_turning_body(xy, T_S, np.full(6, SIGMA), BEND_HZ, TURN_SIGMA_RAD_S)
        errors.append(found.turn_rad_s[1] - 0.3)
        sigmas.append(np.sqrt(found.cov[7, 7]))
    assert np.mean(np.abs(errors) < 1.645 * np.array(sigmas)) >= 0.8


def test_a_body_that_is_of_no_use_is_not_looked_for_on_the_other_side(monkeypatch):
    searches, search = [], turning_body._fitted
    monkeypatch.setattr(turning_body, "_fitted", lambda *given: searches.append(given[2]) or search(*given))
    xy, *_ = circling(*BUS, noise=SIGMA)
    sigma = np.full(40, SIGMA)
    best = fit_turning_body(xy, T_S, sigma, BEND_HZ, TURN_SIGMA_RAD_S)
    again = fit_turning_body(xy, T_S, sigma, BEND_HZ, TURN_SIGMA_RAD_S, lambda _: True)
    np.testing.assert_array_equal(again.shared, best.shared)
    searches.clear()
    of_no_use = fit_turning_body(xy, T_S, sigma, BEND_HZ, TURN_SIGMA_RAD_S, lambda _: False)
    assert len(searches) == 1
    assert not searches[0][6:].any()
    assert of_no_use.squares >= best.squares


def test_points_that_say_nothing_are_said_to():
    # One place, seen ever again: no size, so no distance, and neither a turn nor a way towards us.
    xy = np.full((len(T_S), 8, 2), 0.1)
    found = fit_turning_body(xy, T_S, np.full(8, SIGMA), BEND_HZ, TURN_SIGMA_RAD_S)
    assert np.all(np.isfinite(found.cov))
    assert np.sqrt(found.cov[2, 2]) > 1.0


def test_noise_that_is_taken_for_too_small_is_left_to_who_asks():
    """``usual`` says by how much; who weighs by it must not find it in the covariance already."""
    xy, *_ = circling(*BUS, noise=SIGMA)
    right, small = (fit_turning_body(xy, T_S, np.full(40, s), BEND_HZ, TURN_SIGMA_RAD_S) for s in (SIGMA, 0.5 * SIGMA))
    assert small.median_chi2 == pytest.approx(4.0 * right.median_chi2, rel=0.1)
    assert np.sqrt(small.cov[7, 7] / right.cov[7, 7]) == pytest.approx(0.5, rel=0.15)


def test_a_start_that_brings_a_point_too_near_is_none():
    rng, t_s = np.random.default_rng(0), np.linspace(-4.0, 0.0, 20)
    place = rng.uniform(-2.0, 2.0, (12, 2))
    xy = place + 1e-3 * rng.standard_normal((20, 12, 2))
    found = fit_turning_body(xy, t_s, np.full(12, 1e-3), BEND_HZ, TURN_SIGMA_RAD_S)
    assert np.isfinite(found.squares)
    assert np.isfinite(found.cov).all()
    again = fit_turning_body(xy, t_s, np.full(12, 1e-3), BEND_HZ, TURN_SIGMA_RAD_S)
    np.testing.assert_array_equal(found.cov, again.cov)
