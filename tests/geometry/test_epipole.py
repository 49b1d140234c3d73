"""The epipole of flow lines in the picture and of one flow with the horizon, exact without noise, honest with it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_points import jitter, moving_points, views

from ttcvid.geometry.paper.epipole import epipole_from_flow_lines
from ttcvid.geometry.paper.planar import planar_epipole
from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.model import Status

FOCAL_PX = 720.0
UP = np.array([0.0, 1.0, 0.0])


def pixels(rays):
    return FOCAL_PX * rays[..., :2] / rays[..., 2:]


def shared_motion(n, seed, velocity):
    rng = np.random.default_rng(seed)
    position = np.column_stack([rng.uniform(-15, 15, n), rng.uniform(-5, 5, n), rng.uniform(10, 60, n)])
    return views(position, np.asarray(velocity, dtype=float), [-0.2, 0.0])


def test_flow_lines_in_the_picture_meet_in_the_epipole():
    q, p = shared_motion(20, 15, (2, 1, -8))
    epipole_px, status = epipole_from_flow_lines(pixels(q), pixels(p))
    np.testing.assert_allclose(epipole_px, pixels(np.array([2.0, 1, -8])), rtol=1e-9)
    assert status == Status.ok


@pytest.mark.parametrize(
    ("flow", "n", "expected"),
    [
        ([3.0, 1.0], 4, Status.epipole_at_infinity),
        ([0.0, 0.0], 4, Status.no_epipole),
        ([np.nan, 0.0], 4, Status.no_epipole),
        ([3.0, 1.0], 1, Status.no_epipole),
    ],
)
def test_parallel_or_missing_lines_in_the_picture(flow, n, expected):
    first = np.random.default_rng(16).uniform(0, 500, (n, 2))
    epipole_px, status = epipole_from_flow_lines(first, first + flow)
    assert status == expected
    assert np.isnan(epipole_px).all()


@given(moving_points(planar=True), st.sampled_from([1.0, -1.0]))
def test_planar_motion_is_exact_without_noise(scene, side):
    position, velocity = scene
    q, p = views(position, velocity, [-0.5, 0.0])
    direction, cov, status = planar_epipole(q, p, side * UP, np.full(len(q), 1e-9), 1e-18 * np.eye(3))
    assert np.isin(status, [Status.ok, Status.epipole_at_infinity]).all()
    np.testing.assert_allclose(direction, normalize(velocity), atol=1e-9)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", cov, direction), 0, atol=1e-18)


def test_planar_covariance_is_that_of_noisy_draws():
    rng = np.random.default_rng(17)
    position, velocity = np.array([8.0, 3.0, 25.0]), np.array([-3.0, 0.0, -6.0])
    n, sigma, horizon_sigma = 4000, 2e-4, 2e-3
    horizon_cov = horizon_sigma**2 * np.eye(3)
    q, p = jitter(np.repeat(views(position[None], velocity, [-1.0, 0.0]), n, axis=1), sigma, rng)
    horizons = jitter(np.repeat(UP[None], n, axis=0), horizon_sigma, rng)
    draws = np.array(
        [planar_epipole(q[[i]], p[[i]], horizons[i], np.array([sigma]), horizon_cov)[0][0] for i in range(n)]
    )
    _, cov, status = planar_epipole(*views(position[None], velocity, [-1.0, 0.0]), UP, np.array([sigma]), horizon_cov)
    assert status[0] == Status.ok
    np.testing.assert_allclose(np.cov(draws.T), cov[0], atol=0.06 * np.trace(cov[0]))


def test_planar_epipole_says_why_there_is_none():
    turn = rotation_from_vector(np.array([0.0, 0.1, 0.0]))
    level, low = np.array([0.1, 0.0, 1.0]), normalize(np.array([0.1, 0.2, 1.0]))
    q = np.array([normalize(level), low, [np.nan, 0, 1], low])
    p = np.array([turn @ normalize(level), low, low, normalize(low + np.array([0.05, 0, 0]))])
    direction, cov, status = planar_epipole(q, p, UP, np.full(4, 1e-4), 1e-6 * np.eye(3))
    assert status.tolist() == [
        Status.parallel_to_horizon,
        Status.no_parallax,
        Status.short_track,
        Status.epipole_at_infinity,
    ]
    assert np.isnan(direction[:3]).all()
    assert np.isnan(cov[:3]).all()
    np.testing.assert_allclose(direction[3], [1, 0, 0], atol=1e-12)
