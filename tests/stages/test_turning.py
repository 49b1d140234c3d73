"""A thing drives straight on unless its views say that it turns."""

import numpy as np
import pytest
from scipy.special import chdtri

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.rotation import normalize, rotation_from_vector, skew, tangent_basis
from ttcvid.stages.objects.turning import believed_straight, straight_or_in_bend

T_S = 0.05 * np.arange(-12.0, 1.0)
VELOCITY_M_S = np.array([-4.0, 0.0, -5.0])
DIRECTION = normalize(VELOCITY_M_S)
SIGMA_NORM = 0.1 / 500.0


def views(middle_m, half_size_m, turn_rad_s, noise, n=60, seed=1):
    """Points about a middle that moves straight, and about which they turn: (L, N, 2)."""
    rng = np.random.default_rng(seed)
    offset = rng.uniform(-1.0, 1.0, (n, 3)) * half_size_m
    turn = rotation_from_vector(T_S[:, None] * np.asarray(turn_rad_s))
    place = middle_m + T_S[:, None, None] * VELOCITY_M_S + np.einsum("lij,nj->lni", turn, offset)
    return place[..., :2] / place[..., 2:] + noise * rng.standard_normal((len(T_S), n, 2))


def fitted(xy, noise=SIGMA_NORM, direction=DIRECTION, config=None, may_leave_directions=True):
    n = xy.shape[1]
    return straight_or_in_bend(
        xy,
        T_S,
        np.full(n, noise),
        believed_straight(T_S, direction[None], np.zeros((1, 3, 3)), np.array([True]), None),
        np.zeros(n, dtype=np.int64),
        CollisionTimesConfig() if config is None else config,
        may_leave_directions=may_leave_directions,
    )


def test_the_direction_that_a_search_begins_with_does_not_matter():
    xy = views(np.array([2.0, 0.0, 25.0]), np.array([0.8, 0.6, 0.3]), np.zeros(3), SIGMA_NORM, 30)
    turn = rotation_from_vector(np.radians([[0.0, 15.0, 0.0]]))[0]
    one, other = (fitted(xy, direction=start).direction[0] for start in (DIRECTION, turn @ DIRECTION))
    assert np.degrees(np.arccos(one @ DIRECTION)) < 1.0
    assert np.degrees(np.arccos(one @ other)) < 0.3


@pytest.mark.parametrize("turn_deg_s", [-8.0, 12.0])
def test_a_bus_that_turns_is_found_to(turn_deg_s):
    turn = np.radians([0.0, turn_deg_s, 0.0])
    found = fitted(views(np.array([2.0, 0.0, 14.0]), np.array([1.5, 1.5, 3.0]), turn, SIGMA_NORM))
    np.testing.assert_allclose(found.turn_rad_s[0], turn, atol=0.2 * np.abs(turn).max())


def test_what_drives_straight_on_is_not_taken_to_turn():
    turns = [
        fitted(views(np.array([2.0, 0.0, 25.0]), np.array([1.0, 0.7, 0.5]), np.zeros(3), SIGMA_NORM, 15, seed))
        for seed in range(30)
    ]
    turn_rad_s = np.concatenate([one.turn_rad_s for one in turns])
    assert np.degrees(np.abs(turn_rad_s)).max() < 1.0


def test_what_is_left_of_the_views_is_their_noise():
    found = fitted(views(np.array([2.0, 0.0, 25.0]), np.array([1.0, 0.7, 0.5]), np.zeros(3), SIGMA_NORM, n=40))
    n_left = 40 * (2 * len(T_S) - 3)
    assert 0.9 * n_left < found.squares[0] < 1.1 * n_left
    assert 0.8 < found.median_chi2[0] < 1.1


def views_on_a_circle(middle_m, velocity_m_s, own_m_s, turn_rad_s, half_size_m, noise, n=60, seed=3):
    """Of points that drive on a circle, at ``velocity_m_s`` relative to a camera that drives straight on: (L, N, 2)."""
    rng = np.random.default_rng(seed)
    rotation = rotation_from_vector(T_S[:, None] * np.array([0.0, turn_rad_s, 0.0]))
    # The velocity turn x (middle - middle of the circle) is the relative one and our own.
    from_circle_m = np.cross(velocity_m_s + own_m_s, [0.0, 1.0, 0.0]) / turn_rad_s
    offset = rng.uniform(-1.0, 1.0, (n, 3)) * half_size_m
    place = middle_m - from_circle_m + np.einsum("lij,nj->lni", rotation, from_circle_m + offset)
    place -= T_S[:, None, None] * own_m_s
    return place[..., :2] / place[..., 2:] + noise * rng.standard_normal((len(T_S), n, 2))


def views_of_a_tight_bend(turn_rad_s, noise=SIGMA_NORM):
    middle_m, own_m_s = np.array([3.0, 0.3, 15.0]), np.array([0.0, 0.0, 5.0])
    half_size_m = np.array([4.0, 1.2, 1.5])
    velocity_m_s = np.array([-6.3, 0.0, -5.0])
    return views_on_a_circle(middle_m, velocity_m_s, own_m_s, turn_rad_s, half_size_m, noise)


def views_of_a_car_ahead(turn_rad_s, seed):
    """And their noise, and the direction of its middle."""
    velocity_m_s, noise = np.array([0.3, 0.0, -1.8]), 0.3 * SIGMA_NORM
    middle_m, half_size_m = np.array([-2.0, 0.5, 10.0]), np.array([0.8, 0.6, 2.0])
    own_m_s = np.array([0.0, 0.0, 8.0])
    xy = views_on_a_circle(middle_m, velocity_m_s, own_m_s, turn_rad_s, half_size_m, noise, 30, seed)
    return xy, noise, normalize(velocity_m_s)


def test_what_drives_round_a_tight_bend_is_found_on_its_circle():
    """Where a straight path is rejected: at three times this noise it misses the views by less than twice the noise."""
    noise = 0.3 * SIGMA_NORM
    found = fitted(views_of_a_tight_bend(-0.45, noise), noise)
    np.testing.assert_allclose(found.turn_rad_s[0], [0.0, -0.45, 0.0], atol=0.02)
    assert found.median_chi2[0] < 1.2


def test_a_car_ahead_in_a_bend_turns_as_fast_as_it_does():
    """A path that hardly turns follows its points to their noise, in another direction and with a wrong speed."""
    found = [fitted(*views_of_a_car_ahead(0.17, seed)) for seed in range(9)]
    turn_rad_s = np.array([one.turn_rad_s[0] for one in found])
    np.testing.assert_allclose(np.median(turn_rad_s, axis=0), [0.0, 0.17, 0.0], atol=0.01)


@pytest.mark.parametrize("turn_rad_s", [0.02, 0.05, 0.1])
def test_what_is_said_of_a_direction_holds_for_what_turns_as_well(turn_rad_s):
    """Its direction was found as if it drove straight on: that of the middle of the window, known to 0.05 deg.

    To take that as it is holds in one of twenty cases, to let the views alone say it in about half.
    """
    velocity_m_s, holds = np.array([-4.0, 0.0, -5.0]), []
    own_m_s, half_size_m = np.array([0.0, 0.0, 8.0]), np.array([0.8, 0.6, 2.0])
    turned = rotation_from_vector(0.5 * T_S[:1, None] * np.array([0.0, turn_rad_s, 0.0]))[0]
    found_before = normalize(turned @ (velocity_m_s + own_m_s) - own_m_s)
    for seed in range(20):
        middle_m = np.array([2.0, 0.0, 25.0])
        xy = views_on_a_circle(middle_m, velocity_m_s, own_m_s, turn_rad_s, half_size_m, SIGMA_NORM, 30, seed)
        found = fitted(xy, direction=found_before)
        across = tangent_basis(normalize(velocity_m_s)[None])[0]
        # Its middle moves as its points do, turned back, and by the turn about the camera.
        middle = middle_m / np.linalg.norm(velocity_m_s)
        by_shared = across.T @ np.hstack([np.eye(3), np.zeros((3, 3)), -skew(middle[None])[0]])
        off = across.T @ (found.direction[0] + np.cross(found.turn_rad_s[0], middle))
        cov = by_shared @ found.cov[0, :9, :9] @ by_shared.T
        holds.append(off @ np.linalg.solve(cov, off) < chdtri(2, 0.1))
    assert np.mean(holds) >= 0.35


def test_a_tight_bend_is_judged_by_the_views_that_may_be_used_and_by_no_others():
    xy, config = views_of_a_tight_bend(-0.45), CollisionTimesConfig(max_frames=10)
    by_few = fitted(xy, config=config)
    np.testing.assert_allclose(by_few.turn_rad_s[0], [0.0, -0.45, 0.0], atol=0.05)
    longer = xy.copy()
    longer[: len(T_S) - 10] += 0.05
    np.testing.assert_array_equal(fitted(longer, config=config).turn_rad_s, by_few.turn_rad_s)


def test_where_the_direction_is_held_to_a_horizon_no_circle_is_looked_for():
    found = fitted(views_of_a_tight_bend(-0.45), may_leave_directions=False)
    assert abs(found.turn_rad_s[0, 1]) < 0.2


def rear_views(depth_m, noise, seed, n=40):
    """Places (L, n, 2) of points on the rear of a car ahead of us, at its depths (L,)."""
    rng = np.random.default_rng(seed)
    rear_m = rng.uniform([-0.85, -0.7], [0.85, 0.7], (n, 2)) + np.array([0.3, 0.5])
    return rear_m / depth_m[:, None, None] + noise * rng.standard_normal((len(T_S), n, 2))


AHEAD = np.array([0.0, 0.0, -1.0])


def test_who_brakes_ahead_shows_his_acceleration_and_how_sure_it_is():
    """2 m/s and 5 m/s^2, at 16 m: with the prior of whoever drives on, a third of that is found."""
    off = []
    for seed in range(60):
        xy = rear_views(16.0 - 2.0 * T_S - 2.5 * T_S**2, 0.05 * SIGMA_NORM, seed)
        braking = fitted(xy, 0.05 * SIGMA_NORM, AHEAD)
        off.append((braking.offset[0, 5] + 2.5) / np.sqrt(braking.cov[0, 5, 5]))
        assert braking.offset[0, 5] == pytest.approx(-2.5, abs=0.6)
    assert abs(np.mean(off)) < 0.4
    assert np.std(off) < 1.3


def test_who_keeps_his_speed_is_not_said_to_brake():
    said = [fitted(rear_views(16.0 - 2.0 * T_S, SIGMA_NORM, seed), SIGMA_NORM, AHEAD) for seed in range(60)]
    wide = [np.sqrt(one.cov[0, 5, 5]) > 0.155 for one in said]
    assert np.mean(wide) < 0.1
    assert np.mean([abs(one.offset[0, 5]) > 2.0 * np.sqrt(one.cov[0, 5, 5]) for one in said]) < 0.1
