"""Paths against closed forms and independent quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad

from ttcvid.simulate.motion import Motion, heading_at, position_at, speed_at, turn_rate_at, velocity_at

TIMES_S = np.array([0.0, 0.05, 0.7, 1.3, 2.0, 3.7, 6.0])
START_M = (3.0, -2.0, 0.5)


def test_straight_path_at_constant_speed_is_start_plus_velocity_times_time():
    motion = Motion(START_M, course_rad=0.3, speed_m_s=12.0, climb_m_s=-1.5)
    velocity = np.array([12 * np.cos(0.3), 12 * np.sin(0.3), -1.5])
    expected = np.array(START_M) + TIMES_S[:, None] * velocity
    np.testing.assert_allclose(position_at(motion, TIMES_S), expected, rtol=0, atol=1e-11)


def test_constant_yaw_rate_gives_a_circle():
    motion = Motion(START_M, course_rad=-0.4, speed_m_s=7.0, yaw_rate_rad_s=0.5)
    radius, turned = 14.0, -0.4 + 0.5 * TIMES_S
    x = 3.0 + radius * (np.sin(turned) - np.sin(-0.4))
    y = -2.0 - radius * (np.cos(turned) - np.cos(-0.4))
    np.testing.assert_allclose(position_at(motion, TIMES_S)[:, :2], np.stack([x, y], axis=-1), rtol=0, atol=1e-11)


def test_braking_car_stops_where_v_squared_over_two_a_says_and_stays_there():
    motion = Motion((0, 0, 0), speed_m_s=12.0, acceleration_m_s2=-5.0, acceleration_from_s=0.8)
    x = position_at(motion, np.array([0.8, 1.8, 3.2, 5.0]))[:, 0]
    rest = 0.8 * 12 + 12**2 / 10
    np.testing.assert_allclose(x, [9.6, 9.6 + 12 - 2.5, rest, rest], rtol=0, atol=1e-11)
    assert speed_at(motion, np.array([4.0])) == 0


def test_acceleration_ends_where_the_scene_says():
    motion = Motion((0, 0, 0), speed_m_s=2.0, acceleration_m_s2=3.0, acceleration_from_s=1.0, acceleration_until_s=2.0)
    assert position_at(motion, np.array([4.0]))[0, 0] == pytest.approx(2 + 2 + 1.5 + 2 * 5, abs=1e-11)


def test_turning_braking_swinging_path_agrees_with_independent_quadrature():
    motion = Motion(
        START_M,
        course_rad=0.2,
        speed_m_s=10.0,
        acceleration_m_s2=-1.7,
        acceleration_from_s=0.5,
        yaw_rate_rad_s=0.3,
        sideslip_rad=0.17,
        sideslip_period_s=2.5,
    )

    def rate(t: float, axis: int) -> float:
        speed = max(10 - 1.7 * max(t - 0.5, 0), 0)
        course = 0.2 + 0.3 * t + 0.17 * np.sin(2 * np.pi * t / 2.5)
        return speed * (np.cos(course), np.sin(course))[axis]

    for t_s in (0.4, 2.0, 5.0):
        expected = [quad(rate, 0, t_s, args=(axis,), points=[0.5], epsabs=1e-12, limit=200)[0] for axis in (0, 1)]
        moved = position_at(motion, np.array([t_s]))[0, :2] - START_M[:2]
        np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-9)


def test_position_does_not_depend_on_which_other_times_are_asked_for():
    motion = Motion(START_M, speed_m_s=9.0, acceleration_m_s2=-4.0, yaw_rate_rad_s=0.4)
    alone = position_at(motion, TIMES_S[3:4])
    np.testing.assert_allclose(position_at(motion, TIMES_S)[3:4], alone, rtol=0, atol=1e-12)


def test_sideslip_turns_the_course_but_not_the_heading():
    motion = Motion(START_M, speed_m_s=5.0, sideslip_rad=np.radians(10), sideslip_period_s=4.0)
    vx, vy, _ = velocity_at(motion, np.array([1.0]))[0]
    assert np.degrees(np.arctan2(vy, vx)) == pytest.approx(10)
    assert heading_at(motion, np.array([1.0])) == 0


def test_turn_between_two_times_is_an_arc_between_two_straights():
    motion = Motion((0, 0, 0), speed_m_s=8.0, yaw_rate_rad_s=0.5, yaw_from_s=1.0, yaw_until_s=1.0 + np.pi)
    quarter_m = 8.0 / 0.5
    x, y, _ = position_at(motion, np.array([1.0 + np.pi + 2.0]))[0]
    assert (x, y) == pytest.approx((8.0 + quarter_m, quarter_m + 16.0), abs=1e-11)
    np.testing.assert_allclose(heading_at(motion, np.array([0.5, 9.0])), [0.0, np.pi / 2], atol=1e-12)


def test_lane_change_ends_one_lane_aside_and_points_ahead_again():
    motion = Motion((0, 0, 0), speed_m_s=20.0, lane_change_m=3.5, lane_change_from_s=1.0, lane_change_duration_s=3.0)
    places = position_at(motion, np.array([0.9, 2.5, 4.2]))
    np.testing.assert_allclose(places, [[18.0, 0, 0], [50.0, 1.75, 0], [84.0, 3.5, 0]], atol=1e-11)
    aside = 2 * 3.5 / 3.0
    assert heading_at(motion, np.array([2.5]))[0] == pytest.approx(np.arctan2(aside, 20.0))
    assert heading_at(motion, np.array([4.2]))[0] == 0


@pytest.mark.parametrize(
    "motion",
    [
        Motion(START_M, speed_m_s=9.0, yaw_rate_rad_s=-0.4, yaw_from_s=0.5, yaw_until_s=3.0),
        Motion(START_M, 0.4, 9.0, -1.5, 0.5, 4.0, lane_change_m=-3.0, lane_change_from_s=0.6),
    ],
)
def test_velocity_and_turn_rate_are_the_rates_of_position_and_heading(motion):
    step, times = 1e-5, np.array([0.3, 0.8, 1.9, 2.7, 3.5])
    moved = (position_at(motion, times + step) - position_at(motion, times - step)) / (2 * step)
    np.testing.assert_allclose(velocity_at(motion, times), moved, atol=1e-6)
    turned = (heading_at(motion, times + step) - heading_at(motion, times - step)) / (2 * step)
    np.testing.assert_allclose(turn_rate_at(motion, times), turned, atol=1e-6)


def test_path_goes_on_before_time_zero():
    motion = Motion(START_M, course_rad=0.3, speed_m_s=12.0)
    back = position_at(motion, np.array([-0.02, 1.0]))[0]
    np.testing.assert_allclose(back, np.array(START_M) - 0.02 * 12 * np.array([np.cos(0.3), np.sin(0.3), 0]))
