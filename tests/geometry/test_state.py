"""State from two views and a direction: exact without noise, with the covariance of noisy draws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_points import moving_points, views

from ttcvid.geometry.paper.two_view_state import state_from_direction
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Status

POSITION, VELOCITY, GAP_S = np.array([6.0, 2.0, 25.0]), np.array([-1.0, 0.5, -8.0]), 0.4


def noisy_xy(rays, sigma, rng):
    rays = rays / rays[..., 2:]
    rays[..., :2] += sigma * rng.normal(size=rays[..., :2].shape)
    return rays


@given(moving_points(), st.floats(0.1, 1.0))
def test_state_is_exact_without_noise(scene, gap_s):
    position, velocity = scene
    q, p = views(position, velocity, [-gap_s, 0.0])
    state, _, status = state_from_direction(q, p, normalize(velocity), gap_s, np.full(len(q), 1e-9))
    expected = np.concatenate([position[:, :2], velocity], axis=1) / position[:, 2:]
    assert np.isin(status, [Status.ok, Status.epipole_at_infinity]).all()
    np.testing.assert_allclose(state, expected, rtol=1e-9, atol=1e-10)


@given(moving_points(), st.floats(0.1, 10))
def test_scaling_time_and_mirroring(scene, factor):
    position, velocity = scene
    q, p = views(position, velocity, [-0.5, 0.0])
    e, sigma, mirror = normalize(velocity), np.full(len(q), 1e-6), np.array([-1.0, 1, 1])
    state, _, _ = state_from_direction(q, p, e, 0.5, sigma)
    slower, _, _ = state_from_direction(q, p, e, 0.5 * factor, sigma)
    mirrored, _, _ = state_from_direction(q * mirror, p * mirror, e * mirror, 0.5, sigma)
    np.testing.assert_allclose(slower[:, 2:], state[:, 2:] / factor, rtol=1e-9)
    np.testing.assert_allclose(mirrored, state * [-1, 1, -1, 1, 1], rtol=1e-9)


def test_covariance_is_that_of_noisy_draws():
    rng = np.random.default_rng(1)
    n, sigma = 40000, 3e-4
    e = normalize(VELOCITY)
    spread = tangent_basis(e) @ np.array([[4e-3, 0.0], [1e-3, 2e-3]])
    q, p = noisy_xy(np.repeat(views(POSITION[None], VELOCITY, [-GAP_S, 0.0]), n, axis=1), sigma, rng)
    directions = normalize(e + rng.normal(size=(n, 2)) @ spread.T)
    draws, _, _ = state_from_direction(q, p, directions, GAP_S, np.full(n, sigma))
    exact = views(POSITION[None], VELOCITY, [-GAP_S, 0.0])
    _, cov, status = state_from_direction(*exact, e, GAP_S, np.array([sigma]), spread @ spread.T)
    assert status[0] == Status.ok
    scale = np.sqrt(np.outer(np.diag(cov[0]), np.diag(cov[0])))
    np.testing.assert_allclose(np.cov(draws.T) / scale, cov[0] / scale, atol=0.04)


def test_derivatives_are_those_of_finite_differences():
    q, p = (v / v[..., 2:] for v in views(POSITION[None], VELOCITY, [-GAP_S, 0.0]))
    e, sigma, step = normalize(VELOCITY), np.array([1e-4]), 1e-6
    q, p = (
        q + np.array([1e-3, -2e-3, 0]),
        p + np.array([-1e-3, 1e-3, 0]),
    )  # off the exact line: all terms of the derivative count

    def abc(dq, dp, de):
        return state_from_direction(q + dq, p + dp, e + de, GAP_S, sigma)[0][0]

    columns = []
    for which in range(3):
        for axis in range(3 if which == 2 else 2):
            shift = [np.zeros(3), np.zeros(3), np.zeros(3)]
            shift[which][axis] = step
            columns.append((abc(*shift) - abc(*(-s for s in shift))) / (2 * step))
    jacobian = np.array(columns).T
    direction_cov = 1e-6 * (np.eye(3) - np.outer(e, e))
    _, cov, _ = state_from_direction(q, p, e, GAP_S, sigma, direction_cov)
    inputs = np.zeros((7, 7))
    inputs[:4, :4], inputs[4:, 4:] = 1e-8 * np.eye(4), direction_cov
    expected = jacobian @ inputs @ jacobian.T
    np.testing.assert_allclose(cov[0], expected, atol=1e-6 * np.abs(expected).max())


def test_degenerate_points_say_why():
    e = normalize(np.array([0.5, 0.0, -5.0]))
    position = np.array([[5.0, 1, 20]] * 4 + [-60 * e])
    position[4] = 40 * -e
    velocity = np.array([5 * e, [0, 0, 0], -5 * e, 5 * e, 5 * e])
    q, p = views(position, velocity, [-0.5, 0.0])
    q[3, 0] = np.nan
    state, cov, status = state_from_direction(q, p, e, 0.5, np.full(5, 2e-4))
    expected = [Status.ok, Status.no_parallax, Status.not_rigid, Status.short_track, Status.at_epipole]
    assert status.tolist() == expected
    assert np.isnan(state).any(axis=1).tolist() == [False, False, False, True, True]
    assert np.isnan(cov).any(axis=(1, 2)).tolist() == [False, False, False, True, True]


@pytest.mark.parametrize(
    ("direction", "gap_s", "sigma", "expected"),
    [
        (np.full(3, np.nan), 0.5, 1e-4, Status.no_epipole),
        (np.array([0, 0, -1.0]), 0.0, 1e-4, Status.short_track),
        (np.array([0, 0, -1.0]), np.nan, 1e-4, Status.short_track),
        (np.array([0, 0, -1.0]), 0.5, 0.0, Status.short_track),
    ],
)
def test_missing_inputs_say_why(direction, gap_s, sigma, expected):
    q, p = views(POSITION[None], VELOCITY, [-GAP_S, 0.0])
    state, _, status = state_from_direction(q, p, direction, gap_s, np.array([sigma]))
    assert status[0] == expected
    assert np.isnan(state).all()


def test_points_behind_the_camera_are_no_points():
    q, p = views(POSITION[None] * [1, 1, -1], VELOCITY, [-GAP_S, 0.0])
    assert state_from_direction(q, p, normalize(VELOCITY), GAP_S, np.array([1e-4]))[2][0] == Status.short_track
