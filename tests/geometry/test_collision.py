"""The paper's k, H and P' and the three times, against points whose position and velocity are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_points import moving_points, views

from ttcvid.geometry.paper.collision import (
    angle_from_direction,
    collision_point,
    k_from_two_angles,
    times_from_position_velocity,
    times_from_state,
)
from ttcvid.geometry.rotation import normalize
from ttcvid.model import Status

EXACT = {"rtol": 1e-9, "atol": 1e-12}


def angles_from_epipole(position, velocity, times_s):
    direction = normalize(velocity)
    normal = np.cross(-direction, position)
    return [angle_from_direction(rays, -direction, normal) for rays in views(position, velocity, times_s)]


def test_crossing_car_of_the_conventions():
    times = times_from_position_velocity(np.array([[20.0, 0, 20]]), np.array([[-10.0, 0, -2]]))
    assert times.tcpa_s[0] == pytest.approx(2.3077, abs=1e-4)
    assert times.ttc_z_s[0] == pytest.approx(10.0)
    assert times.miss_s[0] * np.sqrt(104) == pytest.approx(15.69, abs=0.01)


@given(moving_points(), st.floats(0.05, 1.5))
def test_k_from_two_angles_is_exact_at_both_views(scene, gap):
    position, velocity = scene
    k, status = k_from_two_angles(*angles_from_epipole(position, velocity, [-gap, 0.0]), gap)
    tcpa = times_from_position_velocity(position, velocity).tcpa_s
    assert (status == Status.ok).all()
    np.testing.assert_allclose(k - gap, tcpa, rtol=1e-9, atol=1e-9)


@given(moving_points())
def test_receding_points_have_the_negative_k_of_the_reversed_approach(scene):
    position, velocity = scene
    there, back = times_from_position_velocity(position, velocity), times_from_position_velocity(position, -velocity)
    np.testing.assert_allclose(there.tcpa_s, -back.tcpa_s, **EXACT)
    np.testing.assert_allclose(there.miss_s, back.miss_s, **EXACT)
    k, _ = k_from_two_angles(*angles_from_epipole(position, -velocity, [0.0, 0.5]), 0.5)
    np.testing.assert_allclose(k, back.tcpa_s, rtol=1e-9, atol=1e-9)


def test_k_stays_exact_while_the_collision_plane_sweeps_the_camera():
    position, velocity = np.array([[3.0, 0, 4.0]]), np.array([[-1.0, 0, 0]])
    t = np.array([2.0, 3.0, 4.0])
    angles = np.concatenate(angles_from_epipole(position, velocity, t))
    k, status = k_from_two_angles(angles[[0, 0, 1]], angles[[1, 2, 2]], np.array([1.0, 2.0, 1.0]))
    np.testing.assert_allclose(k, [1.0, 1.0, 0.0], **EXACT)
    assert (status == Status.ok).all()


@given(moving_points())
def test_angle_is_that_between_the_rays_and_alpha_of_the_conventions(scene):
    position, velocity = scene
    times = times_from_position_velocity(position, velocity)
    (angle,) = angles_from_epipole(position, velocity, [0.0])
    np.testing.assert_allclose(angle, np.arctan2(times.miss_s, times.tcpa_s), **EXACT)


@given(moving_points())
def test_collision_point_is_the_position_in_units_of_speed(scene):
    position, velocity = scene
    times = times_from_position_velocity(position, velocity)
    point = collision_point(normalize(position), normalize(velocity), times.tcpa_s, times.miss_s)
    np.testing.assert_allclose(point, position / np.linalg.norm(velocity, axis=1)[:, None], **EXACT)


def test_collision_point_on_the_epipole_needs_no_side():
    direction = np.array([0.0, 0.0, -1.0])
    point = collision_point(np.array([[0.0, 0.0, 3.0]]), direction, np.array([4.0]), np.array([0.0]))
    np.testing.assert_array_equal(point, [[0, 0, 4]])


@given(moving_points(), st.floats(0.1, 10))
def test_scaling_time_scales_the_times_and_mirroring_keeps_them(scene, factor):
    position, velocity = scene
    times = np.array(times_from_position_velocity(position, velocity))
    np.testing.assert_allclose(times_from_position_velocity(position, velocity / factor), factor * times, rtol=1e-9)
    mirror = np.array([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(times_from_position_velocity(position * mirror, velocity * mirror), times, rtol=1e-12)


@given(moving_points(), st.randoms(use_true_random=False))
def test_state_has_the_times_of_the_point_in_any_order(scene, random):
    position, velocity = scene
    state = np.concatenate([position[:, :2], velocity], axis=1) / position[:, 2:]
    order = list(range(len(position)))
    random.shuffle(order)
    expected = np.array(times_from_position_velocity(position, velocity))
    np.testing.assert_allclose(np.array(times_from_state(state[order])), expected[:, order], **EXACT)


@pytest.mark.parametrize(
    ("alpha", "beta", "gap", "expected"),
    [
        (0.0, 0.1, 1.0, Status.at_epipole),
        (0.0, 0.0, 1.0, Status.at_epipole),
        (np.pi, np.pi, 1.0, Status.at_epipole),
        (0.1, 0.1, 1.0, Status.no_parallax),
        (0.1, 0.1 + np.pi, 1.0, Status.no_parallax),
        (0.1, 0.2, 0.0, Status.no_parallax),
        (0.1, 0.2, np.nan, Status.no_parallax),
        (np.nan, 0.2, 1.0, Status.no_epipole),
    ],
)
def test_degenerate_angles_have_a_reason_and_no_number(alpha, beta, gap, expected):
    k, status = k_from_two_angles(np.array([alpha]), np.array([beta]), gap)
    assert np.isnan(k[0])
    assert status[0] == expected


def test_a_point_at_rest_or_unknown_has_no_times():
    position = np.array([[1.0, 2, 3], [np.nan, 0, 1], [1, 1, 1]])
    velocity = np.array([[0.0, 0, 0], [1, 1, 1], [1, 0, 0]])
    times = times_from_position_velocity(position, velocity)
    assert np.isnan(times.tcpa_s).tolist() == [True, True, False]
    assert np.isnan(times.ttc_z_s).tolist() == [True, False, True]
    assert np.isnan(angle_from_direction(position, np.zeros(3), np.zeros((3, 3)))).all()
