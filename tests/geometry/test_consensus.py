"""Hypotheses from pairs, the gate on a direction, and what chance alone would give."""

from math import comb, log

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_points import jitter, views
from scipy.stats import chi2

from ttcvid.geometry.consensus import (
    chance_of_sharing,
    directions_of_pairs,
    log_false_alarms,
    shares_direction,
)
from ttcvid.geometry.rotation import normalize, tangent_basis

GATE = float(chi2.ppf(0.99, 1))
FIRST, SECOND = np.array([0]), np.array([1])


def points(rng, n):
    return np.column_stack([rng.uniform(-15, 15, n), rng.uniform(-5, 5, n), rng.uniform(15, 60, n)])


@given(seed=st.integers(0, 2**32 - 1))
def test_two_flows_of_one_motion_meet_in_its_direction_with_its_sense(seed):
    rng = np.random.default_rng(seed)
    velocity = normalize(rng.normal(size=3)) * 10.0
    q, p = views(points(rng, 2), velocity, [-0.2, 0.0])
    directions, is_defined = directions_of_pairs(q, p, FIRST, SECOND)
    meets_at = np.linalg.norm(np.cross(*normalize(np.cross(q, p))))
    if meets_at > 0.01:
        assert is_defined[0]
        np.testing.assert_allclose(directions[0], normalize(velocity), atol=1e-9 / meets_at)


def test_order_within_a_pair_does_not_matter():
    rng = np.random.default_rng(1)
    q, p = views(points(rng, 12), np.array([3.0, 1.0, -8.0]), [-0.2, 0.0])
    one, other = np.arange(6), np.arange(6, 12)
    np.testing.assert_allclose(
        directions_of_pairs(q, p, one, other)[0], directions_of_pairs(q, p, other, one)[0], atol=1e-12
    )


def test_opposite_motions_define_no_direction_together():
    position = np.array([[4.0, 1.0, 20.0], [-3.0, 2.0, 30.0]])
    q, p = views(position, np.array([[0.0, 0.0, -5.0], [0.0, 0.0, 5.0]]), [-0.2, 0.0])
    assert not directions_of_pairs(q, p, FIRST, SECOND)[1][0]


def test_flows_along_one_line_define_no_direction():
    position = np.array([[2.0, 0.0, 20.0], [6.0, 0.0, 20.0]])
    q, p = views(position, np.array([1.0, 0.0, -5.0]), [-0.2, 0.0])
    assert not directions_of_pairs(q, p, FIRST, SECOND)[1][0]


def test_a_track_with_itself_or_without_flow_defines_nothing_and_warns_of_nothing():
    q, p = views(np.array([[2.0, 1.0, 20.0], [5.0, 0.0, 30.0]]), np.array([0.0, 0.0, -5.0]), [-0.2, 0.0])
    p[1] = q[1]
    _, is_defined = directions_of_pairs(q, p, np.array([0, 0]), np.array([0, 1]))
    assert not is_defined.any()


@pytest.mark.parametrize("velocity", [(0, 0, -10), (3, 1, -8), (-8, 0, 0.2), (0, 0, 9)])
@pytest.mark.parametrize("probability", [0.9, 0.99])
def test_noisy_flows_of_a_motion_share_its_direction_with_the_probability_of_the_gate(velocity, probability):
    rng = np.random.default_rng(2)
    n, sigma_rad = 6000, 0.3e-3
    q, p = (jitter(v, sigma_rad, rng) for v in views(points(rng, n), np.array(velocity, dtype=float), [-0.3, 0.0]))
    is_in = shares_direction(unit_row(velocity), q, p, np.full(n, sigma_rad), float(chi2.ppf(probability, 1)))
    assert is_in.shape == (1, n)
    assert is_in.mean() == pytest.approx(probability, abs=4.0 * np.sqrt(probability * (1 - probability) / n))


def unit_row(vector):
    return normalize(np.asarray(vector, dtype=float))[None]


def test_flows_in_the_opposite_sense_do_not_share_a_direction():
    rng = np.random.default_rng(3)
    q, p = views(points(rng, 200), np.array([2.0, 0.5, -8.0]), [-0.3, 0.0])
    directions = np.concatenate([unit_row([2.0, 0.5, -8.0]), unit_row([-2.0, -0.5, 8.0])])
    shares = shares_direction(directions, q, p, np.full(200, 1e-5), GATE)
    assert shares[0].all()
    assert not shares[1].any()


def test_a_flow_within_noise_contradicts_no_sense():
    q, p = views(np.array([[3.0, 1.0, 20.0]]), np.array([0.0, 0.0, -1.0]), [-0.01, 0.0])
    directions = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    assert shares_direction(directions, q, p, np.full(1, 1e-3), GATE).all()


@pytest.mark.parametrize("length_sigmas", [3.3, 5.0, 12.0, 40.0, 120.0])
def test_chance_of_sharing_is_the_part_of_random_orientations_that_pass(length_sigmas):
    rng = np.random.default_rng(4)
    n, sigma_rad = 40000, 1e-4
    ray = normalize(np.column_stack([rng.uniform(-0.4, 0.4, (n, 2)), np.ones(n)]))
    angle = rng.uniform(0, 2 * np.pi, n)
    across = np.einsum("nij,nj->ni", tangent_basis(ray), np.column_stack([np.cos(angle), np.sin(angle)]))
    flow = np.sqrt(2.0) * sigma_rad * length_sigmas * across
    direction = unit_row([0.8, 0.6, 0.0])
    passed = shares_direction(
        direction, normalize(ray - 0.5 * flow), normalize(ray + 0.5 * flow), sigma_rad + 0 * angle, GATE
    )
    chance = float(chance_of_sharing(np.array([length_sigmas]), GATE)[0])
    assert passed.mean() == pytest.approx(chance, abs=4.0 * np.sqrt(chance / n))


def test_longer_flows_share_less_by_chance_and_short_ones_one_time_in_two():
    chance = chance_of_sharing(np.array([0.0, 1.0, 3.0, 10.0, 1000.0]), GATE)
    assert (np.diff(chance) <= 0.0).all()
    np.testing.assert_allclose(chance[:2], 0.5)
    assert chance[-1] < 1e-3


def brute_force_log_false_alarms(n_tests, n_members, n_inliers, chance):
    n, k = n_members - 2, n_inliers - 2
    return log(n_tests * sum(comb(n, j) * chance**j * (1.0 - chance) ** (n - j) for j in range(k, n + 1)))


@given(
    n_tests=st.integers(1, 2000),
    n_members=st.integers(3, 60),
    part=st.floats(0.0, 1.0),
    chance=st.floats(0.001, 0.5),
)
def test_log_false_alarms_is_the_binomial_tail(n_tests, n_members, part, chance):
    n_inliers = 2 + round(part * (n_members - 2))
    expected = brute_force_log_false_alarms(n_tests, n_members, n_inliers, chance)
    assert log_false_alarms(n_tests, n_members, n_inliers, chance) == pytest.approx(expected, abs=1e-7)


def test_two_tracks_always_share_a_direction():
    assert log_false_alarms(50, 10, 2, 0.01) == pytest.approx(log(50))


def test_large_groups_neither_overflow_nor_warn():
    few, many = (log_false_alarms(1500, 1500, n, 0.05) for n in (75, 1400))
    assert few == pytest.approx(log(1500), abs=1.0)
    assert np.isfinite(many)
    assert many < -1000.0
