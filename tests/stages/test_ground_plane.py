"""The road as a plane of depths, and what lies on it."""

import numpy as np
import pytest

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.stages.segmentation.ground_plane import RoadMemory, find_road, on_road, steadied

SPEED_M_S, CAMERA_M = 10.0, 1.4


def fit_of(position_m):
    rate_hz = SPEED_M_S / position_m[:, 2]
    n = len(position_m)
    return PathFit(position_m[:, :2] / position_m[:, 2:], rate_hz, 0.01 * rate_hz, np.ones(n), np.full(n, 10))


def road_and_wall(rng):
    depth_m = CAMERA_M / rng.uniform(0.05, 0.3, 80)
    road = np.column_stack([rng.uniform(-0.4, 0.4, 80) * depth_m, np.full(80, CAMERA_M), depth_m])
    wall = np.column_stack([rng.uniform(-3.0, 3.0, 30), rng.uniform(-2.0, 0.4, 30), np.full(30, 12.0)])
    return fit_of(np.concatenate([road, wall]))


def test_the_road_is_the_plane_at_the_cameras_height():
    fit = road_and_wall(np.random.default_rng(1))
    plane = find_road(fit, np.ones(110, dtype=bool), 0.0)
    assert plane == pytest.approx([0.0, 0.0, SPEED_M_S / CAMERA_M], abs=0.1)


def test_points_of_the_road_lie_on_it_and_those_of_a_wall_that_stands_there_do_not():
    fit = road_and_wall(np.random.default_rng(2))
    plane = find_road(fit, np.ones(110, dtype=bool), 0.0)
    lies = on_road(fit, RoadMemory(plane=plane))
    assert lies[:80].all()
    assert not lies[80:].any()


def test_without_a_road_nothing_lies_on_it():
    assert not on_road(road_and_wall(np.random.default_rng(3)), RoadMemory()).any()


def test_an_aircraft_below_our_way_whose_belly_is_a_little_nearer_is_no_road():
    rng = np.random.default_rng(5)
    x_m = np.concatenate([rng.uniform(-8.0, 8.0, 80), rng.uniform(-1.0, 1.0, 60)])
    y_m = np.concatenate([rng.normal(2.5, 0.2, 80), rng.uniform(0.5, 4.0, 60)])
    fit = fit_of(np.column_stack([x_m, y_m, 30.0 - 1.5 * (y_m - 2.5)]))
    assert find_road(fit, np.ones(140, dtype=bool), 0.0) is None


@pytest.mark.parametrize("share", [0.4, 0.65, 0.9])
def test_a_road_most_of_which_is_seen_at_one_distance_is_one(share):
    rng = np.random.default_rng(6)
    depth_m = np.where(rng.random(120) < share, rng.uniform(12.0, 15.0, 120), 1.0 / rng.uniform(1 / 40, 1 / 5, 120))
    road = np.column_stack([rng.uniform(-3.0, 3.0, 120), np.full(120, CAMERA_M), depth_m])
    plane = find_road(fit_of(road), np.ones(120, dtype=bool), 0.0)
    assert plane == pytest.approx([0.0, 0.0, SPEED_M_S / CAMERA_M], abs=0.1)


def test_cars_ahead_with_more_corners_than_the_road_do_not_hide_it():
    """What goes our way looks many times as far away as it is, and so would lie under the road."""
    rng = np.random.default_rng(7)
    depth_m = CAMERA_M / rng.uniform(0.05, 0.3, 60)
    road = np.column_stack([rng.uniform(-0.5, 0.5, 60) * depth_m, np.full(60, CAMERA_M), depth_m])
    cars = []
    for x_m, z_m in ((-3.5, 11.0), (0.0, 15.0), (3.5, 20.0)):
        ahead = np.column_stack([rng.uniform(-0.9, 0.9, 60) + x_m, rng.uniform(0.0, 1.3, 60), np.full(60, z_m)])
        cars.append(8.0 * ahead)
    plane = find_road(fit_of(np.concatenate([road, *cars])), np.ones(240, dtype=bool), 0.0)
    assert plane is not None
    below = np.array([0.1, 0.2, 0.3])
    assert plane[0] + below * plane[2] == pytest.approx(below * SPEED_M_S / CAMERA_M, rel=0.05)


def test_the_horizon_of_a_noisy_road_is_steadied_along_our_way_while_the_camera_pitches():
    rng = np.random.default_rng(4)
    slope_hz, horizon = SPEED_M_S / CAMERA_M, 0.005
    memory, raw, steady = RoadMemory(), [], []
    for frame in range(60):
        epipole_y = 0.02 * np.sin(frame)
        seen = horizon + rng.normal(0.0, 0.004)
        raw.append(seen - horizon)
        plane = steadied(memory, np.array([-slope_hz * (epipole_y + seen), 0.0, slope_hz]), epipole_y)
        steady.append(-plane[0] / plane[2] - epipole_y - horizon)
        memory = RoadMemory(plane=plane, epipole_y=epipole_y)
    assert np.std(steady[20:]) < 0.4 * np.std(raw)
    assert plane[2] == pytest.approx(slope_hz)


def test_a_road_that_is_not_seen_is_none():
    assert steadied(RoadMemory(plane=np.array([0.0, 0.0, 7.0])), None, 0.0) is None


def test_the_road_of_the_frames_before_comes_nearer_as_slowly_as_we_drive_now():
    """Heights and tilts stay; rates are in units of our mean speed, which has fallen to a third."""
    before = RoadMemory(plane=np.array([0.02, -0.1, 7.0]), epipole_y=0.01)
    now = np.array([0.02, -0.1, 7.0]) / 3.0
    np.testing.assert_allclose(steadied(before.in_units(1.0 / 3.0), now, 0.01), now, rtol=1e-12)
    assert RoadMemory().in_units(0.5).plane is None
