"""Rates of points on a known path: exact without noise also when the camera turns, with honest sensitivities."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_points import moving_points, views

from ttcvid.geometry.estimation.track_on_trajectory import NO_PATH, fit_rates_on_paths, straight_path
from ttcvid.geometry.rotation import normalize, rotation_from_vector, tangent_basis

SIGMA = 0.2 / 720.0
T_S = -0.1 * np.arange(12.0)[::-1]
SPEED_M_S = 8.0


def bent_path():
    """Relative path of static points seen from a car that turns: each step has a direction of its own."""
    steps = normalize(np.column_stack([0.4 * T_S + 0.05, 0.02 * T_S, -np.ones(len(T_S))]))
    path = np.zeros((len(T_S), 3))
    for j in range(len(T_S) - 2, -1, -1):
        path[j] = path[j + 1] - (T_S[j + 1] - T_S[j]) * steps[j + 1]
    return path


def street(n, rng):
    return np.column_stack([rng.uniform(-10, 10, n), rng.uniform(-3, 3, n), rng.uniform(10, 60, n)])


def seen(position, path):
    place = position + SPEED_M_S * path[:, None]
    return place[..., :2] / place[..., 2:]


@given(moving_points(), st.booleans())
def test_a_straight_path_gives_the_exact_rate_from_views_on_one_side_and_on_both(scene, both_sides):
    position, velocity = scene
    n, t_s = len(position), T_S - T_S[6] if both_sides else T_S
    rays = views(position, velocity, t_s)
    paths = np.stack([straight_path(e, t_s) for e in normalize(velocity)])
    found = fit_rates_on_paths(rays[..., :2] / rays[..., 2:], t_s, np.full(n, 1e-7), paths, np.arange(n))
    np.testing.assert_allclose(found.rate_hz, np.linalg.norm(velocity, axis=1) / position[:, 2], rtol=1e-9)
    np.testing.assert_allclose(found.state[:, :2], position[:, :2] / position[:, 2:], rtol=1e-9, atol=1e-12)
    assert (found.n_frames == len(t_s)).all()


def test_a_bent_path_gives_the_exact_rate():
    position, path = street(100, np.random.default_rng(1)), bent_path()
    found = fit_rates_on_paths(seen(position, path), T_S, np.full(100, 1e-7), path[None], np.zeros(100, np.int64))
    np.testing.assert_allclose(found.rate_hz, SPEED_M_S / position[:, 2], rtol=1e-9)
    assert (found.n_frames == len(T_S)).all()


def test_covariance_is_that_of_noisy_draws():
    rng, n, path = np.random.default_rng(2), 4000, bent_path()
    position = np.array([[5.0, -1.5, 25.0]])
    xy = np.repeat(seen(position, path), n, axis=1) + SIGMA * rng.normal(size=(len(T_S), n, 2))
    found = fit_rates_on_paths(xy, T_S, np.full(n, SIGMA), path[None], np.zeros(n, np.int64))
    error = np.column_stack([found.state[:, :2], found.rate_hz]) - [0.2, -0.06, SPEED_M_S / 25.0]
    scale = np.sqrt(np.diag(found.cov[0]))
    np.testing.assert_allclose(np.cov((error / scale).T), found.cov[0] / np.outer(scale, scale), atol=0.08)
    assert np.mean(found.chi2) == pytest.approx(found.dof[0], rel=0.04)


def test_sensitivities_are_those_of_finite_differences():
    rng, n, path, off = np.random.default_rng(3), 50, bent_path(), 1e-6
    position, number, sigma = street(n, rng), np.zeros(n, np.int64), np.full(n, 1e-4)
    place = position + SPEED_M_S * path[:, None]

    def rates(turn_rate=(0.0, 0.0, 0.0), off_direction=(0.0, 0.0, 0.0), bend=(0.0, 0.0, 0.0), change=(0.0, 0.0, 0.0)):
        turned = np.einsum("lij,lnj->lni", rotation_from_vector(T_S[:, None] * np.array(turn_rate)), place)
        paths = path[None] + T_S[:, None] * np.array(off_direction) + 0.5 * T_S[:, None] ** 2 * np.array(bend)
        paths = paths + T_S[:, None] ** 3 / 6.0 * np.array(change)
        return fit_rates_on_paths(turned[..., :2] / turned[..., 2:], T_S, sigma, paths, number)

    exact = rates()
    by_rotation = np.column_stack([(rates(axis).rate_hz - exact.rate_hz) / off for axis in off * np.eye(3)])
    np.testing.assert_allclose(by_rotation, -exact.by_shared[:, 6:9], rtol=1e-3, atol=1e-3)
    basis = tangent_basis(normalize(path[-1] - path[-2]))
    by_direction = [(rates(off_direction=axis).rate_hz - exact.rate_hz) / off for axis in off * basis.T]
    np.testing.assert_allclose(np.column_stack(by_direction), exact.by_shared[:, :3] @ basis, rtol=1e-3, atol=1e-3)
    by_bend = np.column_stack([(rates(bend=axis).rate_hz - exact.rate_hz) / off for axis in off * np.eye(3)])
    np.testing.assert_allclose(by_bend, exact.by_shared[:, 3:6], rtol=1e-3, atol=1e-3)
    by_change = np.column_stack([(rates(change=axis).rate_hz - exact.rate_hz) / off for axis in off * np.eye(3)])
    np.testing.assert_allclose(by_change, exact.by_shared[:, 9:], rtol=1e-3, atol=1e-3)


def test_without_a_path_or_a_second_view_there_is_no_number():
    path = np.stack([bent_path(), bent_path()])
    path[1, :-1] = np.nan
    position = street(4, np.random.default_rng(4))
    xy = seen(position, path[0])
    xy[:-1, 2] = np.nan
    found = fit_rates_on_paths(xy, T_S, np.full(4, SIGMA), path, np.array([NO_PATH, 0, 0, 1]))
    assert np.isfinite(found.rate_hz).tolist() == [False, True, False, False]
    assert found.n_frames.tolist() == [0, len(T_S), 1, 1]


def test_the_window_ends_where_the_path_was_left():
    """A point that stood until five frames ago."""
    path, position = straight_path(np.array([0.0, 0.0, -1.0]), T_S), np.array([[5.0, -1.5, 15.0]])
    place = position + SPEED_M_S * np.maximum(T_S, -0.4)[:, None, None] * np.array([0.0, 0.0, -1.0])
    xy = place[..., :2] / place[..., 2:]
    found = fit_rates_on_paths(xy, T_S, np.array([SIGMA]), path[None], np.zeros(1, np.int64))
    assert found.n_frames[0] in (5, 6)
    assert found.rate_hz[0] == pytest.approx(SPEED_M_S / 15.0, rel=0.03)
