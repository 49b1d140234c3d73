"""The road as a plane of depths, and what lies on it."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.stages.segmentation.ground_plane import RoadMemory, RoadPoints, find_road, on_road, road_points

SPEED_M_S, CAMERA_M = 10.0, 1.4
AHEAD = np.zeros(2)


def fit_of(position_m):
    rate_hz = SPEED_M_S / position_m[:, 2]
    n = len(position_m)
    return PathFit(position_m[:, :2] / position_m[:, 2:], rate_hz, 0.01 * rate_hz, np.ones(n), np.full(n, 10))


def seen_now(fit, t_s=0.0, first_id=0, aim=AHEAD):
    n = len(fit.rate_hz)
    return road_points(fit, np.ones(n, dtype=bool), aim, first_id + np.arange(n), t_s)


def road_of(fit):
    return find_road(seen_now(fit), AHEAD)


def road_and_wall(rng):
    depth_m = CAMERA_M / rng.uniform(0.05, 0.3, 80)
    road = np.column_stack([rng.uniform(-0.4, 0.4, 80) * depth_m, np.full(80, CAMERA_M), depth_m])
    wall = np.column_stack([rng.uniform(-3.0, 3.0, 30), rng.uniform(-2.0, 0.4, 30), np.full(30, 12.0)])
    return fit_of(np.concatenate([road, wall]))


def test_the_road_is_the_plane_at_the_cameras_height():
    fit = road_and_wall(np.random.default_rng(1))
    plane = road_of(fit)
    assert plane == pytest.approx([0.0, 0.0, SPEED_M_S / CAMERA_M], abs=0.1)


def test_points_of_the_road_lie_on_it_and_those_of_a_wall_that_stands_there_do_not():
    fit = road_and_wall(np.random.default_rng(2))
    plane = road_of(fit)
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
    assert road_of(fit) is None


@pytest.mark.parametrize("share", [0.4, 0.65, 0.9])
def test_a_road_most_of_which_is_seen_at_one_distance_is_one(share):
    rng = np.random.default_rng(6)
    depth_m = np.where(rng.random(120) < share, rng.uniform(12.0, 15.0, 120), 1.0 / rng.uniform(1 / 40, 1 / 5, 120))
    road = np.column_stack([rng.uniform(-3.0, 3.0, 120), np.full(120, CAMERA_M), depth_m])
    plane = road_of(fit_of(road))
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
    plane = road_of(fit_of(np.concatenate([road, *cars])))
    assert plane is not None
    below = np.array([0.1, 0.2, 0.3])
    assert plane[0] + below * plane[2] == pytest.approx(below * SPEED_M_S / CAMERA_M, rel=0.05)


def few_of_a_road(rng, epipole_y=0.0, noise=0.03):
    """Five points, seen by a camera that pitches."""
    depth_m = CAMERA_M / rng.uniform(0.05, 0.3, 5)
    fit = fit_of(np.column_stack([rng.uniform(-0.4, 0.4, 5) * depth_m, np.full(5, CAMERA_M), depth_m]))
    rate_hz = fit.rate_hz * rng.normal(1.0, noise, 5)
    return replace(fit, place=fit.place + np.array([0.0, epipole_y]), rate_hz=rate_hz)


def test_a_road_of_few_points_a_frame_is_found_over_several_frames_along_our_way_while_the_camera_pitches():
    rng, seen = np.random.default_rng(4), RoadPoints()
    for frame in range(8):
        aim = np.array([0.0, 0.02 * np.sin(frame)])
        now = seen_now(few_of_a_road(rng, aim[1]), 0.1 * frame, 5 * frame, aim)
        assert find_road(now, aim) is None
        seen = seen.and_now(now, 0.1 * frame)
    plane = find_road(seen, aim)
    assert -plane[0] / plane[2] == pytest.approx(aim[1], abs=0.005)
    assert plane[2] == pytest.approx(SPEED_M_S / CAMERA_M, rel=0.08)


def test_a_few_tracks_that_are_seen_for_long_are_no_road():
    fit, seen = few_of_a_road(np.random.default_rng(8), noise=0.0), RoadPoints()
    for frame in range(8):
        seen = seen.and_now(seen_now(fit, 0.1 * frame), 0.1 * frame)
    assert len(seen.t_s) == 40
    assert find_road(seen, AHEAD) is None


def test_a_road_that_was_seen_more_than_a_second_ago_is_none():
    seen = RoadPoints().and_now(seen_now(road_and_wall(np.random.default_rng(9))), 0.0)
    nothing = seen_now(fit_of(np.empty((0, 3))), 0.9)
    assert find_road(seen.and_now(nothing, 0.9), AHEAD) is not None
    assert find_road(seen.and_now(nothing, 1.1), AHEAD) is None


def test_a_plane_whose_horizon_is_not_at_the_height_of_our_way_is_no_road():
    """Where we go is parallel to the road, wherever the camera looks."""
    fit = road_and_wall(np.random.default_rng(1)).take(np.arange(80))
    assert road_of(fit) is not None
    assert road_of(replace(fit, place=fit.place + np.array([0.0, 0.04]))) is None


def test_the_road_of_the_frames_before_comes_nearer_as_slowly_as_we_drive_now():
    """Heights and tilts stay; rates are in units of our mean speed, which has fallen to a third."""
    before = seen_now(road_and_wall(np.random.default_rng(1)))
    slower = find_road(replace(before, rate_hz=before.rate_hz / 3.0), AHEAD)
    np.testing.assert_allclose(slower, find_road(before, AHEAD) / 3.0, rtol=1e-9, atol=1e-9)


def test_where_observations_are_many_the_older_ones_are_fewer():
    seen = RoadPoints()
    for frame in range(6):
        fit = fit_of(np.column_stack([np.zeros(200), np.full(200, CAMERA_M), np.full(200, 10.0)]))
        seen = seen.and_now(seen_now(fit, 0.1 * frame), 0.1 * frame)
    times, counts = np.unique(seen.t_s, return_counts=True)
    assert len(seen.t_s) <= 500
    assert len(times) == 6
    assert (np.diff(counts) >= 0).all()
