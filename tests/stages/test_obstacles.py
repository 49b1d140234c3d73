"""What stands in our own path is found, keeps its number, and nothing that we pass by is taken for it."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import box_of_points

from ttcvid.config import BodiesConfig
from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.stages.segmentation.obstacles import StaticPoints, find_obstacles, own_path
from ttcvid.stages.segmentation.road import Road

CONFIG = BodiesConfig()
FOCAL_PX, LINK_PX, DT_S, N_VIEWS = 500.0, 32.0, 0.05, 20
SPEED_M_S, CAMERA_M = 10.0, 1.4
SINCE_S = DT_S * np.arange(1 - N_VIEWS, 1)
# After so many frames four tracks are an obstacle.
FOUND_IN = 3


def driven(yaw_rad_s=0.0):
    """Where the scene was in the camera of now, less where it is now, in s of our speed: on a circle to the right."""
    heading = yaw_rad_s * SINCE_S
    if yaw_rad_s == 0.0:
        return np.column_stack([0.0 * SINCE_S, 0.0 * SINCE_S, -SINCE_S])
    return np.column_stack([-(1.0 - np.cos(heading)) / yaw_rad_s, 0.0 * SINCE_S, -np.sin(heading) / yaw_rad_s])


def road(rng, n=150):
    """Points of a level road, with x, y, z in m: as many in each part of the picture."""
    below = rng.uniform(0.04, 0.3, n)
    depth_m = CAMERA_M / below
    return np.column_stack([rng.uniform(-0.4, 0.4, n) * depth_m, np.full(n, CAMERA_M), depth_m])


LEVEL_ROAD = Road(np.array([0.0, 0.0, SPEED_M_S / CAMERA_M]))


def points_of(position_m, rng, noise=0.01, track_id=None):
    rate_hz = SPEED_M_S / position_m[:, 2] * (1.0 + noise * rng.normal(size=len(position_m)))
    place = position_m[:, :2] / position_m[:, 2:]
    n = len(place)
    fit = PathFit(place, rate_hz, (noise + 1e-3) * rate_hz, np.ones(n), np.full(n, N_VIEWS))
    ids = np.arange(n) if track_id is None else track_id
    return StaticPoints(ids, FOCAL_PX * place, FOCAL_PX, LINK_PX, fit, np.ones(n, dtype=bool))


def watched(
    position_m,
    frames=FOUND_IN,
    ground=LEVEL_ROAD,
    on_ground=True,
    yaw_rad_s=0.0,
    speed_m_s=SPEED_M_S,
):
    """Public obstacles after some frames in which we come nearer."""
    rng = np.random.default_rng(3)
    memory, next_id, public, way = (), 1, {}, own_path(driven(yaw_rad_s), SINCE_S)
    for k in range(frames):
        now = position_m - np.array([0.0, 0.0, speed_m_s * DT_S * k])
        public, memory, next_id = find_obstacles(
            memory, points_of(now, rng), way, ground, next_id, CONFIG, on_ground=on_ground
        )
    return public


def rear_of_car(rng, x_m, depth_m, n=20, width_m=1.8):
    return box_of_points(rng, n, (x_m, CAMERA_M - 0.7, depth_m), (width_m, 1.2, 0.0))


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def test_own_path_heads_straight_ahead():
    way = own_path(driven(), SINCE_S)
    assert way.aim == pytest.approx([0.0, 0.0])
    assert way.turn_hz == 0.0
    assert way.speed == pytest.approx(1.0)
    assert way.reached_s(np.array([0.25])) == pytest.approx(4.0)


def test_own_path_in_a_bend_leads_to_where_the_circle_goes():
    yaw_rad_s, later_s = 0.2, 2.0
    way = own_path(driven(yaw_rad_s), SINCE_S)
    # After an angle of w t of the circle: aside by (1 - cos) / w, ahead by sin / w.
    expected = (1.0 - np.cos(yaw_rad_s * later_s)) / np.sin(yaw_rad_s * later_s)
    assert way.aim_at(np.array([later_s]))[0, 0] == pytest.approx(expected, rel=0.05)


def test_a_car_that_does_not_move_ahead_has_no_path():
    assert own_path(np.zeros((N_VIEWS, 3)), SINCE_S) is None
    assert own_path(-driven(), SINCE_S) is None


def test_few_tracks_of_a_stopped_car_are_an_obstacle_once_they_have_lasted(rng):
    scene = np.concatenate([road(rng), rear_of_car(rng, 0.2, 30.0, n=6)])
    assert watched(scene, 1) == {}
    (few,) = watched(scene).values()
    assert 4 <= len(few) <= 6


def test_a_stopped_car_in_our_lane_is_an_obstacle_in_the_second_frame(rng):
    scene = np.concatenate([road(rng), rear_of_car(rng, 0.2, 30.0)])
    assert watched(scene, 1) == {}
    assert list(watched(scene, 2)) == [1]
    public = watched(scene)
    assert list(public) == [1]
    on_car = public[1] >= 150
    assert on_car.sum() >= 15
    assert on_car.mean() > 0.8


def test_an_aircraft_head_on_is_one_thing_though_what_lies_near_our_way_tells_little_of_its_depth(rng):
    aircraft = box_of_points(rng, 60, (0.0, 0.0, 40.0), (10.0, 2.5, 0.5))
    place, depth_m = aircraft[:, :2] / aircraft[:, 2:], aircraft[:, 2]
    # An error of half a pixel along a short way from where we go is a large part of it.
    off = np.linalg.norm(place, axis=1)
    sigma_hz = SPEED_M_S / depth_m * np.where(off < 0.05, 0.19, 0.02)
    wrong_hz = np.where(off < 0.05, 2.0 * sigma_hz, 0.0)
    fit = PathFit(place, SPEED_M_S / depth_m + wrong_hz, sigma_hz, np.ones(60), np.full(60, N_VIEWS))
    seen = StaticPoints(np.arange(60), FOCAL_PX * place, FOCAL_PX, LINK_PX, fit, np.ones(60, dtype=bool))
    memory, next_id, public = (), 1, {}
    for _ in range(FOUND_IN):
        public, memory, next_id = find_obstacles(
            memory, seen, own_path(driven(), SINCE_S), None, next_id, CONFIG, on_ground=False
        )
    assert list(public) == [1]
    assert len(public[1]) >= 55


@pytest.mark.parametrize(("height_m", "is_one"), [(0.45, True), (0.15, False)])
def test_a_car_of_which_only_bumper_and_plate_are_seen_is_one_and_a_flat_box_is_driven_over(rng, height_m, is_one):
    low = box_of_points(rng, 12, (0.0, CAMERA_M - height_m, 15.0), (1.6, 0.06, 0.0))
    assert bool(watched(np.concatenate([road(rng), low]))) == is_one


def test_what_looks_near_but_hangs_over_the_road_is_none(rng):
    """A car far ahead that moves as we do, and a little to the side: all of it lies beside the point we head for."""
    upper = box_of_points(rng, 12, (0.3, 0.1 * CAMERA_M, 25.0), (1.2, 0.6 * CAMERA_M, 0.0))
    assert watched(np.concatenate([road(rng), upper])) == {}
    # In the air nothing has to.
    assert len(watched(np.concatenate([road(rng), upper]), on_ground=False)) == 1
    # It reaches down to the road, as anything that stands there.
    lower = box_of_points(rng, 4, (0.3, 0.8 * CAMERA_M, 25.0), (1.2, 0.2 * CAMERA_M, 0.0))
    assert len(watched(np.concatenate([road(rng), upper, lower]))) == 1


def test_a_lorry_is_still_there_when_its_low_tracks_are_lost(rng):
    """They leave the picture, or a car cuts in; the others hang."""
    speed_m_s, still_there = 25.0, 15
    lorry, way, level = (
        box_of_points(rng, 30, (0.0, -0.1, 60.0), (2.4, 2.6, 0.0)),
        own_path(driven(), SINCE_S),
        LEVEL_ROAD,
    )
    ground, noise, memory, next_id, public = road(rng), np.random.default_rng(3), (), 1, {}
    track_id = np.arange(len(ground) + len(lorry))
    is_high = np.concatenate([np.ones(len(ground), dtype=bool), lorry[:, 1] < 0.2 * CAMERA_M])
    for k in range(2 * still_there):
        now = np.concatenate([ground, lorry]) - np.array([0.0, 0.0, speed_m_s * DT_S * k])
        is_seen = (now[:, 2] > 2.0) & (is_high | (k < still_there))
        points = points_of(now[is_seen], noise, track_id=track_id[is_seen])
        points = replace(points, fit=replace(points.fit, rate_hz=points.fit.rate_hz * speed_m_s / SPEED_M_S))
        at_speed = level.at_speed(speed_m_s / SPEED_M_S)
        public, memory, next_id = find_obstacles(memory, points, way, at_speed, next_id, CONFIG, on_ground=True)
    assert list(public) == [1]


@pytest.mark.parametrize("aside_m", [-1.5, 1.5])
def test_a_stopped_car_that_half_of_our_front_would_hit_is_one(rng, aside_m):
    """It is 1.8 m wide, we are 1.96 m: we would meet over 0.4 m."""
    assert watched(np.concatenate([road(rng), rear_of_car(rng, aside_m, 25.0)])) != {}


def test_a_stopped_car_is_found_by_tracks_that_tell_its_depth_only_together(rng):
    """Near our heading the noise of the picture is a large part of a track's flow."""
    car, way = rear_of_car(rng, 0.0, 32.0, n=16), own_path(driven(), SINCE_S)
    n_found = 0
    for _ in range(20):
        points = points_of(np.concatenate([road(rng), car]), rng)
        own, fit = np.arange(150, 166), points.fit
        sigma_hz, off = fit.rate_sigma_hz.copy(), np.linalg.norm(fit.place[own], axis=1)
        # The corners tell it to a fifth, the middle tells nothing.
        sigma_hz[own] = 0.2 * SPEED_M_S / 32.0 * off.max() / off
        rate_hz = np.maximum(fit.rate_hz + np.where(sigma_hz > 0.1, sigma_hz, 0.0) * rng.normal(size=166), 0.0)
        seen = replace(points, fit=replace(fit, rate_hz=rate_hz, rate_sigma_hz=sigma_hz))
        memory, next_id, public = (), 1, {}
        for _ in range(FOUND_IN):
            public, memory, next_id = find_obstacles(memory, seen, way, LEVEL_ROAD, next_id, CONFIG, on_ground=True)
        n_found += any(np.isin(members, own).sum() > 8 for members in public.values())
    assert n_found >= 16


@pytest.mark.parametrize("aside_m", [-2.8, 2.8])
def test_a_parked_car_at_the_roadside_is_none(rng, aside_m):
    assert watched(np.concatenate([road(rng), rear_of_car(rng, aside_m, 25.0)])) == {}


def test_the_road_alone_is_none(rng):
    assert watched(road(rng, 400)) == {}
    assert watched(road(rng, 400), ground=None) == {}


def test_a_wall_along_our_way_is_none(rng):
    depth_m = 10.0 / rng.uniform(0.16, 1.0, 300)
    wall = np.column_stack([np.full(300, 1.6), rng.uniform(-2.0, CAMERA_M, 300), depth_m])
    assert watched(np.concatenate([road(rng), wall])) == {}


def test_a_bridge_over_our_road_is_none(rng):
    bridge = box_of_points(rng, 60, (0.0, -3.6, 35.0), (20.0, 1.0, 0.0))
    assert watched(np.concatenate([road(rng), bridge])) == {}
    assert watched(bridge, ground=None) == {}


def test_a_bridge_with_its_pillars_is_none(rng):
    """All of it has one depth, and it stands on both sides of our way."""
    deck = box_of_points(rng, 90, (0.0, -3.6, 35.0), (14.0, 1.0, 0.0))
    pillars = [box_of_points(rng, 30, (x_m, -0.8, 35.0), (1.0, 4.4, 0.0)) for x_m in (-6.0, 6.0)]
    assert watched(np.concatenate([road(rng), deck, *pillars])) == {}


def test_a_gate_that_leaves_us_twice_our_width_is_none(rng):
    posts = [box_of_points(rng, 40, (x_m, CAMERA_M - 2.2, 25.0), (0.2, 4.2, 0.0)) for x_m in (-1.9, 1.9)]
    beam = box_of_points(rng, 40, (0.0, CAMERA_M - 4.3, 25.0), (3.8, 0.4, 0.0))
    assert watched(np.concatenate([road(rng), beam, *posts])) == {}


@pytest.mark.parametrize("depth_m", [30.0, 40.0])
def test_a_stopped_lorry_of_which_only_the_doors_and_a_wheel_are_seen_is_one(rng, depth_m):
    """What is between them is plain."""
    doors = box_of_points(rng, 30, (0.0, CAMERA_M - 2.7, depth_m), (2.5, 2.2, 0.0))
    wheel = box_of_points(rng, 6, (-1.12, CAMERA_M - 0.5, depth_m), (0.25, 0.8, 0.0))
    assert watched(np.concatenate([road(rng), doors, wheel])) != {}


def test_what_is_reached_in_ten_seconds_is_none_yet(rng):
    assert watched(np.concatenate([road(rng), rear_of_car(rng, 0.0, 100.0)])) == {}


def test_an_aircraft_head_on_is_one_with_the_four_tracks_that_it_has():
    aircraft = np.array([[-2.2, 0.1, 36.0], [2.2, 0.1, 36.0], [0.0, 0.3, 35.5], [0.7, 0.2, 35.7]])
    public = watched(aircraft, ground=None, on_ground=False)
    assert [len(members) for members in public.values()] == [4]


@pytest.mark.parametrize("turn", [-1.0, 1.0])
def test_a_house_straight_ahead_in_a_bend_is_none(rng, turn):
    house = box_of_points(rng, 60, (0.0, -1.0, 35.0), (8.0, 4.5, 0.0))
    assert watched(np.concatenate([road(rng), house])) != {}
    assert watched(np.concatenate([road(rng), house]), yaw_rad_s=0.25 * turn) == {}


@pytest.mark.parametrize("turn", [-1.0, 1.0])
@pytest.mark.parametrize(("way_m", "off_m", "is_one"), [(24.0, 0.0, True), (24.0, 4.0, False), (24.0, -4.0, False)])
def test_a_car_that_stands_in_our_lane_in_a_bend_is_one(rng, turn, way_m, off_m, is_one):
    """On a circle of 70 m it stands 4 m beside where we would get to by going straight on."""
    radius_m = SPEED_M_S / 0.14
    angle = way_m / radius_m
    x_m = radius_m - (radius_m - off_m) * np.cos(angle)
    car = rear_of_car(rng, turn * x_m, (radius_m - off_m) * np.sin(angle))
    assert bool(watched(np.concatenate([road(rng), car]), yaw_rad_s=0.14 * turn)) == is_one


@pytest.mark.parametrize("turn", [-1.0, 1.0])
def test_a_house_that_our_bend_would_lead_to_in_five_seconds_is_none(rng, turn):
    """By then the bend may well have ended."""
    house = box_of_points(rng, 80, (turn * 22.0, -2.0, 44.0), (24.0, 6.0, 0.0))
    assert watched(np.concatenate([road(rng), house]), yaw_rad_s=0.21 * turn) == {}


def test_steering_to_and_fro_takes_no_car_out_of_our_way(rng):
    """At half a degree in a second it stands 0.6 m beside where we would get to by going on to turn."""
    assert watched(np.concatenate([road(rng), rear_of_car(rng, 0.0, 45.0)]), yaw_rad_s=np.radians(0.5))


def test_an_obstacle_keeps_its_number_while_its_tracks_change_and_over_short_gaps(rng):
    car = rear_of_car(rng, 0.0, 30.0, n=40)
    way, noise = own_path(driven(), SINCE_S), np.random.default_rng(4)
    memory, next_id, numbers = (), 7, []
    for k in range(40):
        now = car - np.array([0.0, 0.0, SPEED_M_S * DT_S * k])
        # Every other frame one of its tracks ends and another begins; in three frames it is not seen at all.
        kept = np.arange(k // 2, k // 2 + 12)
        points = points_of(now[kept] if k not in (20, 21, 22) else now[kept] + [9.0, 0.0, 0.0], noise, track_id=kept)
        public, memory, next_id = find_obstacles(memory, points, way, LEVEL_ROAD, next_id, CONFIG, on_ground=True)
        numbers += list(public)
    assert set(numbers) == {7}
    assert len(numbers) >= 40 - FOUND_IN - 3
    assert next_id == 8


def test_an_obstacle_keeps_its_number_over_frames_in_which_we_do_not_move_ahead(rng):
    car, noise = rear_of_car(rng, 0.0, 30.0), np.random.default_rng(4)
    memory, next_id, numbers = (), 7, []
    for k in range(20):
        way = None if k in (12, 13, 14) else own_path(driven(), SINCE_S)
        points = points_of(car - np.array([0.0, 0.0, SPEED_M_S * DT_S * k]), noise)
        public, memory, next_id = find_obstacles(memory, points, way, LEVEL_ROAD, next_id, CONFIG, on_ground=True)
        numbers.append(list(public))
    assert numbers[11] == numbers[15] == numbers[19] == [7]
    assert next_id == 8


def test_nothing_to_see_is_no_obstacle():
    nothing = np.empty((0, 3))
    assert watched(nothing) == {}


def test_paint_across_a_road_that_rises_is_no_obstacle(rng):
    """A zebra crossing 35 m ahead lies 0.4 m over the plane of the road before us."""
    height_m = 0.4 + 0.02 * rng.normal(size=16)
    paint = np.column_stack([np.linspace(-2.5, 2.5, 16), CAMERA_M - height_m, np.full(16, 35.0)])
    assert watched(np.concatenate([road(rng), paint]), frames=2 * FOUND_IN) == {}
