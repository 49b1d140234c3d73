"""Expansion of regions: exact for rigid planes, blind to sideways motion, with a sigma that holds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ttcvid.geometry.paper.expansion import expansion_of_neighbourhood, expansion_rate


def plane(rng, m, depth=20.0):
    return np.column_stack([rng.uniform(-3, 3, (m, 2)), np.full(m, depth)])


@given(st.integers(2, 40), st.floats(-15, 9), st.floats(-5, 5), st.floats(0.02, 0.5), st.integers(0, 10**6))
def test_ttc_z_is_one_over_expansion_at_the_second_view(m, closing, sideways, dt_s, seed):
    second = plane(np.random.default_rng(seed), m)
    first = second + dt_s * np.array([-sideways, 0.0, closing])
    expansion_hz, sigma_hz = expansion_rate(first, second, dt_s)
    assert expansion_hz == pytest.approx(closing / 20.0, rel=1e-9, abs=1e-11)
    if m > 2:
        assert sigma_hz < 1e-7


def test_a_small_camera_rotation_is_no_expansion():
    second = plane(np.random.default_rng(1), 30) + np.array([0.5, 0.5, 0])
    yaw = 1e-3
    first = second @ np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    assert abs(expansion_rate(first, second, 0.1)[0]) < 0.001


def test_weights_and_missing_points_are_left_out():
    rng = np.random.default_rng(2)
    second = plane(rng, 12)
    first = second + np.array([0.0, 0.0, 1.0])
    expected, _ = expansion_rate(first[:9], second[:9], 0.1)
    second[9], first[10], second[11] = np.nan, [1, 1, -5], [80, 0, 20]
    weights = np.append(np.ones(11), 0.0)
    assert expansion_rate(first, second, 0.1, weights)[0] == pytest.approx(expected, rel=1e-12)


def test_noise_does_not_bias_it_and_sigma_covers():
    rng = np.random.default_rng(3)
    sigma, n, m = 3e-4, 4000, 8
    second = np.stack([plane(rng, m) for _ in range(n)]) / 20.0
    first = np.concatenate([second[..., :2] / 1.01, second[..., 2:]], axis=-1)
    first[..., :2] += sigma * rng.normal(size=(n, m, 2))
    second[..., :2] += sigma * rng.normal(size=(n, m, 2))
    expansion_hz, sigma_hz = expansion_rate(first, second, 0.1)
    error = expansion_hz - 0.1
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(n)
    assert np.sqrt(np.mean(sigma_hz**2)) == pytest.approx(error.std(), rel=0.1)


def test_neighbourhoods_are_the_regions_of_their_points():
    rng = np.random.default_rng(4)
    second = plane(rng, 30)
    first = second + rng.normal(size=(30, 3)) * 0.01 + np.array([0, 0, 0.5])
    neighbours = rng.integers(0, 30, (50, 6))
    neighbours[3] = [1, 2, 3, 4, -1, -1]
    expansion_hz, sigma_hz = expansion_of_neighbourhood(first, second, neighbours, 0.1)
    assert expansion_hz.shape == sigma_hz.shape == (50,)
    assert (expansion_hz[3], sigma_hz[3]) == pytest.approx(expansion_rate(first[1:5], second[1:5], 0.1))


@pytest.mark.parametrize("m", [0, 1])
def test_no_region_no_expansion(m):
    points = plane(np.random.default_rng(5), m)
    assert np.isnan(expansion_rate(points, points, 0.1)).all()


def test_degenerate_regions_have_no_number():
    points = plane(np.random.default_rng(6), 5)
    assert np.isnan(expansion_rate(np.repeat(points[:1], 5, axis=0), points, 0.1)[0])
    assert np.isnan(expansion_rate(points, points, 0.0)).all()
    assert np.isnan(expansion_rate(points * np.nan, points, 0.1)).all()


@pytest.mark.parametrize("tiny_view", [0, 1, 2])
def test_points_that_coincide_have_no_expansion(tiny_view: int) -> None:
    """What rounding leaves between them would grow by any factor."""
    wide = np.array([[0.3, 0.1, 1.0], [0.31, 0.1, 1.0], [0.3, 0.12, 1.0]])
    tiny = wide[:1] + np.array([[0, 0, 0], [1e-16, 0, 0], [0, -3e-17, 0]])
    first, second = [(tiny, wide), (wide, tiny), (tiny, tiny)][tiny_view]
    assert np.isnan(expansion_rate(first, second, 0.1)).all()
