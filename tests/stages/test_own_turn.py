"""The bend that we drive along, and who is on collision course in it: exact tracks of cars on circles."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX
from watched_rows import FRAME_S, first_warned, row_of, watched

from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.stages.segmentation.own_turn import OwnBend, own_bend
from ttcvid.stages.segmentation.road import Road
from ttcvid.stages.tracking.history import empty_history

CAMERA_M, RADIUS_M, OWN_M_S = 1.4, 50.0, 9.0
AHEAD = np.array([0.0, 0.0, 1.0])


def bend_to(side, radius_m=RADIUS_M, own_m_s=OWN_M_S):
    """Our bend with a level road."""
    return OwnBend(AHEAD, side * own_m_s / radius_m, Road(np.array([0.0, 0.0, own_m_s / CAMERA_M])))


def on_our_circle(side, off_m, angle_rad, speed_m_s, length_m=0.0, own_m_s=OWN_M_S):
    """Row of what drives or stands at an angle along our bend, ``off_m`` to the right of our line; 1.8 m wide.

    It is seen from its roof to the road. Its side, ``length_m`` behind its front, reaches to the inside of the bend.
    """
    r = RADIUS_M - side * off_m
    place = np.array([side * (RADIUS_M - r * np.cos(angle_rad)), 0.3, r * np.sin(angle_rad)])
    tangent = np.array([side * np.sin(angle_rad), 0.0, np.cos(angle_rad)])
    row = row_of(place, speed_m_s * tangent - own_m_s * AHEAD, relative_sigma=0.003)
    foot_px = CAMERA.cy_px + FOCAL_PX * CAMERA_M / place[2]
    x0_px, top_px, x1_px, _ = row.box_px
    front_px = (x0_px, top_px, x1_px, foot_px)
    back = place - np.sign(speed_m_s) * length_m * tangent
    back_px = CAMERA.cx_px + FOCAL_PX * back[0] / back[2]
    return replace(row, front_px=front_px, box_px=(min(x0_px, back_px), top_px, max(x1_px, back_px), foot_px))


def drive(side, off_m, speed_m_s, angle_rad=0.9, **options):
    """Rows of what drives along our bend, until it has reached us."""
    closing_rad_s = OWN_M_S / RADIUS_M - speed_m_s / (RADIUS_M - side * off_m)
    angles_rad = np.arange(angle_rad, 0.1, -closing_rad_s * FRAME_S)
    return [on_our_circle(side, off_m, angle, speed_m_s, **options) for angle in angles_rad]


def warned(rows, bend):
    return first_warned(watched(rows, on_ground=True, bend=bend)[0])


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("speed_m_s", [-7.0, -9.0, -12.0])
def test_who_comes_in_the_other_lane_of_our_bend_is_not_warned_of(side, speed_m_s):
    """Traffic on the right: the other lane is to our left. Circles that do not meet, straight lines that may."""
    assert warned(drive(side, -3.6, speed_m_s), bend_to(side)) is None


def test_by_straight_lines_who_is_slower_in_the_other_lane_would_be_warned_of():
    assert warned(drive(1.0, -3.6, -6.0), None) is not None


def test_the_side_that_a_lorry_shows_in_a_bend_follows_its_front():
    rows = drive(1.0, -3.6, -9.0, length_m=14.0)
    assert warned(rows, bend_to(1.0)) is None
    assert warned([replace(row, front_px=None) for row in rows], None) is not None


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("speed_m_s", [-12.0, -7.0, 0.0, 3.0])
def test_what_is_in_our_own_lane_of_a_bend_is_warned_of_in_time(side, speed_m_s):
    rows = drive(side, 0.0, speed_m_s)
    start = warned(rows, bend_to(side))
    assert start is not None
    assert rows[start].times.tcpa_s[0] > 1.2


@pytest.mark.parametrize("turn_rad_s", [0.2, -0.2])
def test_a_turn_is_that_of_the_camera(turn_rad_s):
    t_s = 0.05 * np.arange(20)
    to_the_right = rotation_from_vector(np.outer(t_s[-1] - t_s, [0.0, -turn_rad_s, 0.0]))
    history = replace(empty_history(CAMERA, 0.1), frame=np.arange(20), t_s=t_s, cam_R_past=to_the_right)
    found = own_bend(history, -AHEAD, None)
    assert found.turn_rad_s == pytest.approx(turn_rad_s, rel=0.01)
    assert own_bend(history, AHEAD, None) is None
    assert own_bend(replace(history, t_s=t_s / 3.0), -AHEAD, None) is None


def test_steering_to_and_fro_is_no_bend():
    t_s, rate = 0.05 * np.arange(20), np.radians(0.3)
    turned = rotation_from_vector(np.outer(t_s[-1] - t_s, [0.0, -rate, 0.0]))
    history = replace(empty_history(CAMERA, 0.1), frame=np.arange(20), t_s=t_s, cam_R_past=turned)
    assert own_bend(history, -AHEAD, None).turn_rad_s < 0.1 * rate
