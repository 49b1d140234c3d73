"""The road as a plane that bends, and what lies on it."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.stages.segmentation import road
from ttcvid.stages.segmentation.road import Road, RoadPoints, find_road, on_road

SPEED_M_S, CAMERA_M = 10.0, 1.4
AHEAD = np.zeros(2)


def fit_of(position_m):
    rate_hz = SPEED_M_S / position_m[:, 2]
    n = len(position_m)
    return PathFit(position_m[:, :2] / position_m[:, 2:], rate_hz, 0.01 * rate_hz, np.ones(n), np.full(n, 10))


def seen_now(fit, t_s=0.0, first_id=0, aim=AHEAD):
    n = len(fit.rate_hz)
    return RoadPoints.of(fit, np.ones(n, dtype=bool), aim, first_id + np.arange(n), t_s)


def road_of(fit):
    return find_road(seen_now(fit), AHEAD)


def road_and_wall(rng):
    depth_m = CAMERA_M / rng.uniform(0.05, 0.3, 80)
    road = np.column_stack([rng.uniform(-0.4, 0.4, 80) * depth_m, np.full(80, CAMERA_M), depth_m])
    wall = np.column_stack([rng.uniform(-3.0, 3.0, 30), rng.uniform(-2.0, 0.4, 30), np.full(30, 12.0)])
    return fit_of(np.concatenate([road, wall]))


def test_the_road_is_the_plane_at_the_cameras_height():
    fit = road_and_wall(np.random.default_rng(1))
    found = road_of(fit)
    assert found.plane == pytest.approx([0.0, 0.0, SPEED_M_S / CAMERA_M], abs=0.1)
    assert abs(found.bend) < 1e-4


def test_points_of_the_road_lie_on_it_and_those_of_a_wall_that_stands_there_do_not():
    fit = road_and_wall(np.random.default_rng(2))
    lies = on_road(fit, road_of(fit))
    assert lies[:80].all()
    assert not lies[80:].any()


def test_without_a_road_nothing_lies_on_it():
    assert not on_road(road_and_wall(np.random.default_rng(3)), None).any()


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
    plane = road_of(fit_of(road)).plane
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
    found = road_of(fit_of(np.concatenate([road, *cars])))
    assert found is not None
    below = np.array([0.1, 0.2, 0.3])
    assert found.rate_hz(np.column_stack([np.zeros(3), below])) == pytest.approx(below * SPEED_M_S / CAMERA_M, rel=0.05)


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
    plane = find_road(seen, aim).plane
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
    as_before = find_road(before, AHEAD)
    np.testing.assert_allclose(slower.plane, as_before.plane / 3.0, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(slower.bend, as_before.bend, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(slower.plane, as_before.at_speed(1.0 / 3.0).plane, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(slower.cov, as_before.at_speed(1.0 / 3.0).cov, rtol=1e-6, atol=1e-12)


def test_where_observations_are_many_the_older_ones_are_fewer():
    seen = RoadPoints()
    for frame in range(6):
        fit = fit_of(np.column_stack([np.zeros(200), np.full(200, CAMERA_M), np.full(200, 10.0)]))
        seen = seen.and_now(seen_now(fit, 0.1 * frame), 0.1 * frame)
    times, counts = np.unique(seen.t_s, return_counts=True)
    assert len(seen.t_s) <= 500
    assert len(times) == 6
    assert (np.diff(counts) >= 0).all()


def bent_road(rng, radius_m, n=300, noise=0.0):
    """Points of a crest (a hollow: ``radius_m`` below 0) from 6 to 45 m ahead, with relative noise of their depths."""
    depth_m = 1.0 / rng.uniform(1 / 45, 1 / 6, n)
    height_m = CAMERA_M + depth_m**2 / (2.0 * radius_m)
    fit = fit_of(np.column_stack([rng.uniform(-4.0, 4.0, n), height_m, depth_m]))
    return replace(fit, rate_hz=fit.rate_hz * rng.normal(1.0, noise, n))


@pytest.mark.parametrize("radius_m", [3000.0, -3000.0, 1500.0, -1500.0])
def test_the_depth_and_the_bend_of_a_crest_and_of_a_hollow_are_found(radius_m):
    fit = bent_road(np.random.default_rng(1), radius_m)
    found = road_of(fit)
    # The prior, a crest of 3 km, holds it back.
    assert 0.6 < found.bend / (CAMERA_M / (2.0 * radius_m)) < 1.05
    np.testing.assert_allclose(found.rate_hz(fit.place), fit.rate_hz, rtol=0.1)
    off, off_level = (np.abs(one.heights(fit.place, fit.rate_hz)).max() for one in (found, Road(found.plane)))
    assert off < 0.12
    assert off < 0.5 * off_level


def test_a_road_that_bends_is_seen_where_its_points_project_to():
    """Road points to the picture and back, against the plain geometry."""
    bent, depth = Road(np.array([0.1, 0.02, 5.0]), 3e-4), np.linspace(5.0, 30.0, 40)
    x = np.linspace(-0.3, 0.3, 40)
    y = (1.0 + 3e-4 * depth**2) / depth - (0.1 + 0.02 * x) / 5.0
    place = np.column_stack([x, y])
    np.testing.assert_allclose(bent.rate_hz(place), 5.0 / depth, rtol=1e-9)
    np.testing.assert_allclose(bent.heights(place, 5.0 / depth), 0.0, atol=1e-9)
    # Half a height of the camera over the road.
    np.testing.assert_allclose(bent.heights(place - np.array([0.0, 0.5])[None] / depth[:, None], 5.0 / depth), 0.5)
    # A crest that hides the road stands at half of the tangential plane's inverse depth.
    assert bent.rate_hz(np.array([0.0, 0.01])) == pytest.approx(5.0 * 0.5 * (0.01 + 0.1 / 5.0))
    # Above the horizon of the tangential plane no road is known, in a hollow neither.
    assert replace(bent, bend=-3e-4).rate_hz(np.array([0.0, -0.03])) < 0.0


def test_the_error_of_the_road_does_not_depend_on_where_the_camera_looks():
    fit = bent_road(np.random.default_rng(3), 3000.0, noise=0.03)
    aim = np.array([0.2, -0.1])
    ahead = road_of(fit)
    aside = find_road(seen_now(replace(fit, place=fit.place + aim), aim=aim), aim)
    np.testing.assert_allclose(aside.rate_hz(fit.place + aim), ahead.rate_hz(fit.place))
    np.testing.assert_allclose(aside.sigma_hz(fit.place + aim), ahead.sigma_hz(fit.place))


def test_a_road_seen_at_one_distance_only_is_found_though_it_says_little_of_its_horizon():
    is_found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        depth_m = CAMERA_M * rng.uniform(4.0, 4.4, 14)
        fit = fit_of(np.column_stack([rng.uniform(-3.0, 3.0, 14), np.full(14, CAMERA_M), depth_m]))
        is_found.append(road_of(replace(fit, rate_hz=fit.rate_hz * rng.normal(1.0, 0.04, 14))) is not None)
    assert np.mean(is_found) >= 0.9


def test_the_error_of_the_road_is_what_is_claimed_at_every_distance(monkeypatch):
    monkeypatch.setattr(road, "_BUMP_SIGMA", 0.0)
    z = []
    for seed in range(80):
        rng = np.random.default_rng(seed)
        bend, horizon_y = rng.normal(0.0, 2e-4), rng.normal(0.0, 0.005)
        fit = bent_road(rng, CAMERA_M / (2.0 * bend), n=120, noise=0.04)
        found = road_of(replace(fit, place=fit.place + np.array([0.0, horizon_y])))
        depth = np.array([6.0, 12.0, 20.0])
        place = np.column_stack([np.zeros(3), 1.0 / depth + bend * depth + horizon_y])
        z.append((found.rate_hz(place) - SPEED_M_S / CAMERA_M / depth) / found.sigma_hz(place))
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert (rms > 0.35).all()
    assert (rms < 1.4).all()
