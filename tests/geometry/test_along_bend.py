"""Coordinates along our own bend: what goes along the road, or stands, or crosses it, goes straight in them."""

import numpy as np
import pytest

from ttcvid.geometry.along_bend import straightened

SPEED_M_S, RADIUS_M = 9.0, 60.0
FORWARD = np.array([0.0, 0.0, 1.0])


def on_circle(side, off_m, angle_rad, speed_m_s):
    """Place and velocity over the ground, at ``off_m`` to the right of the circle that we drive to a ``side``."""
    r = RADIUS_M - side * off_m
    place = np.array([side * (RADIUS_M - r * np.cos(angle_rad)), 0.0, r * np.sin(angle_rad)])
    tangent = np.array([side * np.sin(angle_rad), 0.0, np.cos(angle_rad)])
    return place, speed_m_s * tangent


def seen(place_m, ground_m_s, turn, speed_m_s=SPEED_M_S, heading=FORWARD):
    return straightened(place_m, ground_m_s - speed_m_s * heading, heading, speed_m_s, turn)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("off_m", [-3.5, 0.0, 3.5])
@pytest.mark.parametrize("other_m_s", [-11.0, -9.0, -6.0, 0.0, 5.0])
def test_who_drives_along_our_bend_stays_where_it_is_across_the_road(side, off_m, other_m_s):
    place, ground = on_circle(side, off_m, 0.6, other_m_s)
    found = seen(place, ground, side * SPEED_M_S / RADIUS_M)
    np.testing.assert_allclose(found.place, [off_m, 0.0, RADIUS_M * 0.6], atol=1e-9)
    on_our_circle_m_s = other_m_s * RADIUS_M / (RADIUS_M - side * off_m)
    np.testing.assert_allclose(found.velocity, [0.0, 0.0, on_our_circle_m_s - SPEED_M_S], atol=1e-9)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_who_crosses_the_bend_at_a_right_angle_goes_on_across(side):
    place, _ = on_circle(side, -20.0, 0.4, 0.0)
    inwards = np.array([np.cos(0.4), 0.0, -side * np.sin(0.4)])
    found = seen(place, 5.0 * inwards, side * SPEED_M_S / RADIUS_M)
    np.testing.assert_allclose(found.velocity, [5.0, 0.0, -SPEED_M_S], atol=1e-9)


def test_a_gentler_and_gentler_bend_is_no_bend_in_the_end():
    place, velocity = np.array([3.0, 0.4, 30.0]), np.array([1.0, 0.2, -14.0])
    straight = straightened(place, velocity, FORWARD, SPEED_M_S, 0.0)
    np.testing.assert_array_equal(straight.place, place)
    np.testing.assert_array_equal(straight.velocity, velocity)
    for turn in (1e-5, -1e-5):
        found = straightened(place, velocity, FORWARD, SPEED_M_S, turn)
        np.testing.assert_allclose(found.place, place, atol=1e-3)
        np.testing.assert_allclose(found.velocity, velocity, atol=1e-3)


def test_a_bend_is_the_same_where_the_camera_looks_aside():
    aside = np.array([[np.cos(0.2), 0.0, np.sin(0.2)], [0.0, 1.0, 0.0], [-np.sin(0.2), 0.0, np.cos(0.2)]])
    place, ground = on_circle(1.0, 3.5, 0.5, -8.0)
    found = seen(aside @ place, aside @ ground, SPEED_M_S / RADIUS_M, heading=aside @ FORWARD)
    np.testing.assert_allclose(found.place, [3.5, 0.0, RADIUS_M * 0.5], atol=1e-9)


@pytest.mark.parametrize("turn", [0.0, 0.15, -0.15])
def test_its_jacobian_is_what_a_change_of_the_velocity_does(turn):
    place, velocity, step = np.array([3.0, 0.4, 30.0]), np.array([1.0, 0.2, -14.0]), np.array([0.3, -0.2, 0.5])
    before, after = (straightened(place, v, FORWARD, SPEED_M_S, turn) for v in (velocity, velocity + step))
    np.testing.assert_allclose(after.velocity - before.velocity, before.jacobian @ step, atol=1e-9)


def test_what_lies_beyond_the_centre_or_behind_us_is_left_as_it_is():
    for place in (np.array([70.0, 0.0, 10.0]), np.array([1.0, 0.0, -5.0])):
        np.testing.assert_array_equal(straightened(place, -FORWARD, FORWARD, SPEED_M_S, 0.15).place, place)
