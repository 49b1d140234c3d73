"""Groups of flows by their epipoles: pairs, the gate on a direction, what chance would give, and all of it together."""

from math import comb, log

import numpy as np
import pytest
from consensus import chance_of_sharing, directions_of_pairs, epipoles_by_ransac, log_false_alarms, shares_direction
from hypothesis import given
from hypothesis import strategies as st
from moving_points import jitter, views
from scipy.special import chdtri

from ttcvid.geometry.rotation import normalize, tangent_basis

GATE = float(chdtri(1, 0.01))
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
    is_in = shares_direction(unit_row(velocity), q, p, np.full(n, sigma_rad), float(chdtri(1, 1.0 - probability)))
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
    n_tests=st.integers(1, 2000), n_members=st.integers(3, 60), part=st.floats(0.0, 1.0), chance=st.floats(0.001, 0.5)
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


def thing(rng, n, centre, velocity, size=(6.0, 2.0, 3.0), gap_s=0.3):
    """Both views of points of one thing, and its direction."""
    position = np.asarray(centre, dtype=float) + rng.uniform(-0.5, 0.5, (n, 3)) * size
    q, p = views(position, np.array(velocity, dtype=float), [-gap_s, 0.0])
    return q, p


SCENE = (90, (0.0, 0.0, 24.0), (0.0, 0.0, -9.0), (20.0, 8.0, 6.0))
CAR = (25, (-6.0, 0.5, 22.0), (6.0, 0.0, -9.0))
LORRY = (30, (7.0, 0.0, 25.0), (-4.0, 0.0, -15.0))


def together(rng, *things, sigma_rad=0.0):
    """Flows of several things in random order, and the number of each flow's thing."""
    parts = [thing(rng, *one) for one in things]
    q, p = (np.concatenate([part[view] for part in parts]) for view in (0, 1))
    truth = np.repeat(np.arange(len(things)), [one[0] for one in things])
    order = rng.permutation(len(truth))
    return jitter(q[order], sigma_rad, rng), jitter(p[order], sigma_rad, rng), truth[order]


def found_in(q, p, sigma_rad, seed=0, gap_s=0.3):
    return epipoles_by_ransac(q, p, np.full(len(q), sigma_rad), gap_s, np.random.default_rng(seed))


@pytest.mark.parametrize("seed", range(5))
def test_exact_flows_of_three_motions_fall_into_three_groups_with_exact_directions(seed):
    q, p, truth = together(np.random.default_rng(seed), SCENE, LORRY, CAR)
    groups = found_in(q, p, 1e-6, seed)
    assert len(groups) == 3
    for number, group in enumerate(groups):
        velocity = (SCENE, LORRY, CAR)[number][2]
        np.testing.assert_allclose(group.direction, normalize(np.array(velocity)), atol=1e-6)
        np.testing.assert_array_equal(group.members, np.flatnonzero(truth == number))


def test_noisy_flows_fall_into_the_same_groups_and_the_covariance_says_how_good_the_directions_are():
    sigma_rad, squares = 0.2e-3, []
    for seed in range(12):
        q, p, truth = together(np.random.default_rng(seed), SCENE, LORRY, CAR, sigma_rad=sigma_rad)
        groups = found_in(q, p, sigma_rad, seed)
        assert len(groups) >= 3
        for group in groups[:3]:
            names, counts = np.unique(truth[group.members], return_counts=True)
            assert counts.max() > 0.8 * counts.sum()
            velocity = normalize(np.array((SCENE, LORRY, CAR)[names[counts.argmax()]][2]))
            basis = tangent_basis(velocity)
            error = basis.T @ group.direction
            squares.append(error @ np.linalg.solve(basis.T @ group.covariance @ basis, error))
    # Chi-square with two degrees of freedom has 99 % under 9.2; some flows are of another motion.
    assert np.median(squares) < 3.0
    assert np.mean(np.array(squares) < 9.2) > 0.8


def test_the_noisiest_flows_of_a_motion_are_no_motion_of_their_own():
    many = [(20 * n, *rest) for n, *rest in (SCENE, LORRY)]
    q, p, truth = together(np.random.default_rng(8), *many, sigma_rad=0.2e-3)
    groups = found_in(q, p, 0.2e-3)
    assert len(groups) == 2
    for number, group in enumerate(groups):
        assert np.mean(truth[group.members] == number) > 0.98
        assert len(group.members) > 0.97 * np.count_nonzero(truth == number)


def test_three_exact_lines_are_a_group_and_two_are_none():
    q, p, _ = together(np.random.default_rng(1), (3, *CAR[1:]))
    (group,) = found_in(q, p, 1e-7)
    np.testing.assert_allclose(group.direction, normalize(np.array(CAR[2])), atol=1e-6)
    np.testing.assert_array_equal(group.members, [0, 1, 2])
    assert found_in(q[:2], p[:2], 1e-7) == []


def test_the_rate_is_speed_over_distance():
    q, p, _ = together(np.random.default_rng(2), (20, (3.0, 1.0, 30.0), (0.0, 0.0, -9.0), (0.5, 0.5, 0.5)))
    (group,) = found_in(q, p, 1e-6)
    assert group.rate_hz == pytest.approx(9.0 / np.linalg.norm([3.0, 1.0, 30.0]), rel=0.02)


def test_two_things_of_one_direction_and_different_times_are_two_groups():
    near, far = (30, (3.0, 0.5, 12.0), (0.0, 0.0, -9.0)), (30, (-8.0, 0.5, 60.0), (0.0, 0.0, -9.0))
    q, p, truth = together(np.random.default_rng(3), near, far)
    groups = found_in(q, p, 1e-6)
    assert [set(truth[group.members]) for group in groups] in ([{0}, {1}], [{1}, {0}])


def test_a_motion_and_its_opposite_are_two_groups():
    q, p, truth = together(np.random.default_rng(4), (30, *CAR[1:]), (25, CAR[1], tuple(-v for v in CAR[2])))
    one, other = found_in(q, p, 1e-6)
    np.testing.assert_allclose(one.direction, -other.direction, atol=1e-6)
    assert set(truth[one.members]) == {0}
    assert set(truth[other.members]) == {1}


@pytest.mark.parametrize("n", [5, 20, 60])
def test_random_flows_make_hardly_any_group(n):
    n_groups = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        ray = normalize(np.column_stack([rng.uniform(-0.4, 0.4, (n, 2)), np.ones(n)]))
        n_groups += len(found_in(ray, jitter(ray, 5e-3, rng), 0.3e-3, seed))
    assert n_groups <= 3


def test_a_wild_flow_belongs_to_no_group_and_missing_or_resting_ones_neither():
    q, p, _ = together(np.random.default_rng(5), CAR)
    p[3] = normalize(q[3] + np.array([0.0, 0.05, 0.0]))
    p[4], q[5] = np.nan, np.nan
    p[6] = q[6]
    (group,) = found_in(q, p, 1e-6)
    assert not {3, 4, 5, 6} & set(group.members.tolist())
    assert len(group.members) == len(q) - 4


def test_gaps_of_their_own_and_scaled_times_scale_the_rate_alone():
    q, p, _ = together(np.random.default_rng(6), CAR)
    (one,), (other,) = found_in(q, p, 1e-6), found_in(q, p, 1e-6, gap_s=np.full(len(q), 0.6))
    np.testing.assert_array_equal(one.direction, other.direction)
    assert other.rate_hz == pytest.approx(0.5 * one.rate_hz)


def test_the_same_choice_of_pairs_gives_the_same_groups_and_nothing_gives_none():
    q, p, _ = together(np.random.default_rng(7), SCENE, CAR, sigma_rad=1e-4)
    for one, other in zip(found_in(q, p, 1e-4), found_in(q, p, 1e-4), strict=True):
        np.testing.assert_array_equal(one.members, other.members)
    assert found_in(np.empty((0, 3)), np.empty((0, 3)), 1e-4) == []
    assert found_in(np.full((9, 3), np.nan), np.full((9, 3), np.nan), 1e-4) == []


def test_arrays_that_do_not_fit_together_are_refused():
    with pytest.raises(ValueError, match=r"expected first and second \(N, 3\)"):
        epipoles_by_ransac(np.zeros((3, 3)), np.zeros((4, 3)), np.ones(3), 0.1, np.random.default_rng(0))
