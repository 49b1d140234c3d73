"""Paths against closed forms and independent quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad

from ttcvid.simulate.motion import Motion, heading_at, position_at, speed_at, velocity_at

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
