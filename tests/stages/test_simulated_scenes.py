"""Whole scenes with truth: what moves is found, with its direction and time, and what will hit us is warned of."""

import numpy as np
import pytest
from relative_motion import box_of_points
from simulated_runs import run

from ttcvid.calibration.without_file import assumed_camera
from ttcvid.config import PipelineConfig
from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.model import Camera, Frame, ImageSize, PointSet
from ttcvid.pipeline import analyze_frames

pytestmark = pytest.mark.slow

CAR = 1
BUS, LORRY = 1, 2
# The scene with six movers: car to the right, to the left, bus towards us, lorry away, walker, car across.
SIX = range(1, 7)


def test_a_car_on_collision_course_is_found_with_its_direction_and_time():
    car = run("crossing_collision").objects[CAR]
    assert car.found_part > 0.85
    assert car.one_number_part > 0.95
    assert np.nanmedian(car.off_deg) < 1.0
    assert np.nanpercentile(car.off_deg, 90) < 3.0
    assert car.in_interval_part > 0.6


def test_a_car_on_collision_course_is_warned_of_once_in_time_and_to_the_end():
    scene = run("crossing_collision")
    (event,) = scene.events
    assert event.kind in ("collision_course", "constant_bearing")
    assert event.cluster_id in scene.objects[CAR].cluster_id
    # The cars touch at 4.9 s: two seconds ahead at the least.
    assert event.start_s <= 2.9 + 1e-9
    assert event.end_frame == scene.results[-1].frame
    assert event.min_ttc_z_s == pytest.approx(1.0, abs=0.3)


def test_a_car_that_passes_well_before_us_is_found_and_not_warned_of():
    scene = run("crossing_clear")
    car = scene.objects[CAR]
    assert car.found_part > 0.85
    assert car.one_number_part > 0.85
    assert np.nanmedian(car.off_deg) < 6.0
    assert car.in_interval_part > 0.7
    assert scene.events == []


def test_bus_and_lorry_on_the_roundabout_are_found_with_their_directions_and_not_warned_of():
    scene = run("roundabout")
    for number in (BUS, LORRY):
        assert scene.objects[number].found_part > 0.8
        # They turn, which one direction for all their points describes to some degrees only.
        assert np.nanmedian(scene.objects[number].off_deg) < 12.0
    assert set(scene.objects[BUS].cluster_id) & set(scene.objects[LORRY].cluster_id) == set()
    assert scene.events == []


@pytest.mark.parametrize("name", ["crossing_collision", "crossing_clear", "roundabout", "resting_six_movers"])
def test_what_stands_still_stays_with_the_scene_to_the_last_frame(name):
    scene = run(name)
    assert scene.static_in_scene[1:].mean() > 0.95
    assert scene.static_in_scene[-20:].mean() > 0.93


def test_before_a_resting_camera_all_six_movers_are_found_and_little_else():
    scene = run("resting_six_movers")
    for number in SIX:
        assert scene.objects[number].found_part > 0.85
    assert scene.n_objects <= 10


@pytest.mark.parametrize(("number", "median_deg"), [(3, 3.0), (4, 3.0), (5, 10.0), (6, 10.0)])
def test_before_a_resting_camera_directions_and_times_are_right(number, median_deg):
    mover = run("resting_six_movers").objects[number]
    assert mover.one_number_part > 0.9
    assert np.nanmedian(mover.off_deg) < median_deg
    assert mover.in_interval_part > 0.5


def test_an_aircraft_that_comes_straight_at_us_is_warned_of():
    head_on = run("aircraft_head_on")
    assert np.nanmedian(head_on.objects[1].off_deg) < 2.0
    # It gets another number where it is lost for a moment.
    assert head_on.events
    assert {event.cluster_id for event in head_on.events} <= set(head_on.objects[1].cluster_id)


def test_a_car_that_stands_in_our_lane_is_an_object_of_the_scenes_motion_and_warned_of():
    scene = run("stopped_car_ahead")
    car = scene.objects[CAR]
    assert car.one_number_part > 0.9
    rows = [row for result in scene.results for row in result.clusters if row.cluster_id in car.cluster_id]
    assert np.mean([row.motion_id == 0 for row in rows]) > 0.8
    (event,) = scene.events
    assert event.cluster_id in car.cluster_id
    # The cars touch at 4.3 s.
    assert event.start_s <= 2.3 + 1e-9


def test_cars_parked_along_our_way_are_nothing_in_our_way():
    scene = run("parked_street")
    assert scene.events == []
    static = [r for result in scene.results for r in result.clusters if r.role == "object" and r.motion_id == 0]
    assert len(static) <= 0.02 * len(scene.results)


def test_rotations_stay_rotations_over_a_hundred_frames():
    """Exact static points before a camera that rests keep no flow, however long the clip."""
    camera = Camera(500.0, 500.0, 319.5, 179.5, ImageSize(640, 360))
    rng = np.random.default_rng(111)
    point = box_of_points(rng, 60, (0.0, 0.0, 20.0), (14.0, 8.0, 8.0))
    xy_px = 500.0 * point[:, :2] / point[:, 2:] + (319.5, 179.5)
    frames = [
        Frame(i, 0.04 * i, points=PointSet(np.arange(60), xy_px + 0.1 * rng.normal(size=(60, 2)))) for i in range(101)
    ]
    results = [result for _, result in analyze_frames(frames, camera, PipelineConfig())]
    assert np.mean([np.mean(result.tracks.cluster_id == 0) for result in results[1:]]) > 0.97
    assert all(row.role == "scene" for result in results for row in result.clusters)
    turned_rad = [np.linalg.norm(result.rotation_rad) for result in results[1:]]
    assert max(turned_rad) < 1e-3


def seen_through_an_unknown_lens(width_px):
    """A bend at 36 km/h through static points, by a lens whose barrel distortion nobody knows of, with its results."""
    rng, n, size = np.random.default_rng(0), 600, ImageSize(width_px, width_px * 9 // 16)
    camera = assumed_camera(size)
    step = rotation_from_vector(np.radians([0.0, 0.4, 0.0]))
    depth_m = rng.uniform(8.0, 80.0, n)
    position_m = np.column_stack([rng.uniform(-0.5, 0.5, n) * depth_m, rng.uniform(-0.28, 0.28, n) * depth_m, depth_m])
    frames = []
    for k in range(24):
        place = position_m[:, :2] / position_m[:, 2:]
        seen = np.flatnonzero((position_m[:, 2] > 3.0) & (np.abs(place) < [0.5, 0.28]).all(axis=1))
        distorted = place[seen] * (1.0 - 0.3 * np.sum(place[seen] ** 2, axis=1))[:, None]
        noise_px = 1e-4 * width_px * rng.normal(size=distorted.shape)
        xy_px = distorted * camera.fx_px + [camera.cx_px, camera.cy_px] + noise_px
        frames.append(Frame(k, 0.04 * k, points=PointSet(seen, xy_px)))
        position_m = (position_m - [0.0, 0.0, 0.4]) @ step.T
    return [result for _, result in analyze_frames(frames, camera, PipelineConfig())]


@pytest.mark.parametrize("width_px", [960, pytest.param(1920, marks=pytest.mark.exhaustive), 3840])
def test_a_lens_that_nobody_measured_makes_no_movers_however_many_pixels_it_serves(width_px):
    assert not [row for r in seen_through_an_unknown_lens(width_px) for row in r.clusters if row.role == "object"]
