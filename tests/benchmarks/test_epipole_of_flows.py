"""The epipole of many flows by maximum likelihood: exact without noise, unbiased with it; and the sign of a flow."""

import numpy as np
import pytest
from epipole_of_flows import epipole_maximum_likelihood, moves_towards
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_points import jitter, moving_points, views

from ttcvid.geometry.paper.epipole import epipole_from_flow_lines
from ttcvid.geometry.rotation import normalize
from ttcvid.model import Status

FOCAL_PX = 720.0


def pixels(rays):
    return FOCAL_PX * rays[..., :2] / rays[..., 2:]


def one_sided_scene(rng, n=80):
    """Lines all on the right of an epipole straight ahead: points 200 to 350 px from it, k of 50 frames or so."""
    xy = np.column_stack([rng.uniform(200, 350, n), rng.uniform(-100, 100, n)]) / FOCAL_PX
    depth = rng.uniform(30, 60, n)
    return np.column_stack([xy, np.ones(n)]) * depth[:, None], np.array([0.0, 0.0, -1.0])


def shared_motion(n, seed, velocity):
    rng = np.random.default_rng(seed)
    position = np.column_stack([rng.uniform(-15, 15, n), rng.uniform(-5, 5, n), rng.uniform(10, 60, n)])
    return views(position, np.asarray(velocity, dtype=float), [-0.2, 0.0])


VELOCITIES = [(0, 0, -10), (0, 0, 10), (3, 1, -8), (-6, 0, 0.5), (0, 5, -5), (0, -4, 0.1)]


@pytest.mark.parametrize("velocity", VELOCITIES)
@pytest.mark.parametrize("n", [2, 3, 50])
def test_maximum_likelihood_is_exact_without_noise(velocity, n):
    q, p = shared_motion(n, 5, velocity)
    direction, cov, chi2, status = epipole_maximum_likelihood(q, p, np.full(n, 1e-5))
    np.testing.assert_allclose(direction, normalize(np.array(velocity, dtype=float)), atol=1e-9)
    assert status == Status.ok
    assert chi2.max() < 1e-6
    np.testing.assert_allclose(cov @ direction, 0, atol=1e-12)


def test_an_epipole_at_infinity_is_a_note_beside_the_value():
    q, p = shared_motion(30, 6, (5, 0, 0))
    direction, _, _, status = epipole_maximum_likelihood(q, p, np.full(30, 1e-5))
    np.testing.assert_allclose(direction, [1, 0, 0], atol=1e-9)
    assert status == Status.epipole_at_infinity


def test_maximum_likelihood_is_unbiased_where_unit_normals_are_not():
    rng = np.random.default_rng(7)
    sigma = 0.3 / FOCAL_PX
    likely, least_squares, predicted = [], [], []
    for _ in range(60):
        position, velocity = one_sided_scene(rng)
        q, p = jitter(views(position, velocity, [-1.0, 0.0]), sigma, rng)
        direction, cov, _, status = epipole_maximum_likelihood(q, p, np.full(len(q), sigma))
        assert status == Status.ok
        likely.append(pixels(direction))
        predicted.append(np.diag(cov)[:2])
        least_squares.append(epipole_from_flow_lines(pixels(q), pixels(p))[0])
    likely, least_squares = np.array(likely), np.array(least_squares)
    bound_px = FOCAL_PX * np.sqrt(np.mean(predicted, axis=0))
    rmse_px = np.sqrt(np.mean(likely**2, axis=0))
    assert least_squares.mean(axis=0)[0] > 25
    assert np.abs(likely.mean(axis=0)).max() < 3 * bound_px.max() / np.sqrt(60)
    assert (rmse_px < 1.3 * bound_px).all()
    assert (rmse_px > 0.7 * bound_px).all()


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.sampled_from(VELOCITIES))
def test_order_of_tracks_and_mirroring(seed, velocity):
    rng = np.random.default_rng(seed)
    q, p = jitter(shared_motion(20, seed, velocity), 1e-4, rng)
    sigma = np.full(20, 1e-4)
    direction, _, _, status = epipole_maximum_likelihood(q, p, sigma)
    order, mirror = rng.permutation(20), np.array([-1.0, 1, 1])
    shuffled, _, _, _ = epipole_maximum_likelihood(q[order], p[order], sigma)
    mirrored, _, _, same = epipole_maximum_likelihood(q * mirror, p * mirror, sigma)
    np.testing.assert_allclose(shuffled, direction, atol=1e-6)
    np.testing.assert_allclose(mirrored, direction * mirror, atol=1e-6)
    assert status == same


def test_missing_rays_are_left_out():
    q, p = shared_motion(10, 11, (1, 0, -8))
    q = q.copy()
    q[0] = np.nan
    direction, _, chi2, status = epipole_maximum_likelihood(q, p, np.full(10, 1e-5))
    np.testing.assert_allclose(direction, normalize(np.array([1.0, 0, -8])), atol=1e-9)
    assert np.isnan(chi2).tolist() == [True] + [False] * 9
    assert status == Status.ok


def test_too_little_for_an_epipole_says_why():
    still = normalize(np.random.default_rng(12).normal(size=(30, 3)) + np.array([0, 0, 5]))
    noisy = jitter(np.stack([still, still]), 1e-4, np.random.default_rng(13))
    q, p = shared_motion(1, 14, (0, 1, -5))
    same = np.repeat(q, 5, axis=0), np.repeat(p, 5, axis=0)
    for flows, expected in [
        (noisy, Status.no_parallax),
        ((still, still), Status.no_parallax),
        ((q, p), Status.no_epipole),
        (same, Status.no_epipole),
        ((q[:0], p[:0]), Status.no_epipole),
        ((np.full((4, 3), np.nan), np.full((4, 3), np.nan)), Status.no_epipole),
    ]:
        direction, cov, _, status = epipole_maximum_likelihood(*flows, np.full(len(flows[0]), 1e-4))
        assert status == expected
        assert np.isnan(direction).all()
        assert np.isnan(cov).all()


@given(moving_points())
def test_points_move_towards_their_own_direction_and_away_from_the_opposite_one(scene):
    position, velocity = scene
    q, p = views(position, velocity, [-0.3, 0.0])
    own, sigma = normalize(velocity), np.full(len(q), 1e-4)
    assert (np.diagonal(moves_towards(own, q, p, sigma)) > 0).all()
    np.testing.assert_allclose(moves_towards(-own, q, p, sigma), -moves_towards(own, q, p, sigma))


def test_sign_significance_is_the_flow_in_sigmas_of_a_difference():
    angle = np.array([0.3, 0.31])
    q, p = np.column_stack([np.sin(angle), np.zeros(2), np.cos(angle)])[:, None]
    significance = moves_towards(np.array([1.0, 0, 0]), q, p, np.array([1e-3]))
    assert significance[0] == pytest.approx(0.01 / (np.sqrt(2) * 1e-3), rel=1e-4)


def test_a_point_on_the_direction_has_no_side_and_a_missing_one_stays_missing():
    e = np.array([[0.0, 0.0, 1.0]])
    assert moves_towards(e[0], e, e, np.array([1e-4]))[0] == 0
    q = np.array([[np.nan, 0, 1], [0, 0, 1], [0, 0, 1.0]])
    p = normalize(np.array([[0.1, 0, 1], [np.nan, 0, 1], [0.1, 0, 1]]))
    assert np.isnan(moves_towards(np.array([1.0, 0, 0]), q, p, np.array([1e-4, 1e-4, 0.0]))).all()
