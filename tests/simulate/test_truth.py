"""The true times and the truth of frames against forms written down independently."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ttcvid.simulate import Scene, TrackOptions, build_world, simulate_tracks, true_times
from ttcvid.simulate.poses import horizon_lines_px, mean_horizon_px, mean_velocities_m_s, rotation_vectors_rad

VECTORS = arrays(float, 3, elements=st.floats(-50, 50).filter(lambda x: abs(x) > 0.1))


def scene_of(**parts) -> Scene:
    camera = {"image_size": [320, 180], "hfov_deg": 60, "fps": 10, "n_frames": 12, **parts.pop("camera", {})}
    return Scene.model_validate({"name": "test", "camera": camera, **parts})


def test_crossing_car_of_the_design():
    times = true_times(np.array([[20.0, 0.0, 20.0]]), np.array([[-10.0, 0.0, -2.0]]))
    assert times.tcpa_s[0] == pytest.approx(240 / 104, rel=1e-12)
    assert times.ttc_z_s[0] == pytest.approx(10.0, rel=1e-12)
    assert times.miss_s[0] * np.sqrt(104) == pytest.approx(160 / np.sqrt(104), rel=1e-12)


@given(VECTORS, VECTORS)
def test_times_agree_with_the_cross_product_form(position, velocity):
    times = true_times(position[None], velocity[None])
    square = velocity @ velocity
    assert times.tcpa_s[0] == pytest.approx(-(position @ velocity) / square, rel=1e-9, abs=1e-12)
    expected = np.linalg.norm(np.cross(position, velocity)) / square
    assert times.miss_s[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert times.ttc_z_s[0] == pytest.approx(-position[2] / velocity[2], rel=1e-9)
    np.testing.assert_allclose(times.direction[0], velocity / np.sqrt(square), atol=1e-12)


def test_what_rests_relative_to_the_camera_has_no_times():
    times = true_times(np.array([[1.0, 2.0, 3.0]]), np.zeros((1, 3)))
    assert np.isnan([times.tcpa_s[0], times.miss_s[0], times.ttc_z_s[0], *times.direction[0]]).all()


def test_points_of_a_straight_scene_follow_the_analytic_path():
    body = {"name": "box", "kind": "box", "at_m": [20, 3, 0], "size_m": [2, 4, 3], "velocity_m_s": [-4, -1, 0.2]}
    scene = scene_of(own_motion={"speed_m_s": 6}, bodies=[body])
    tracks = simulate_tracks(scene, TrackOptions(n_tracks=200, sigma_px=0, death_rate=0, births=False))
    own, moving = np.array([0.0, 0.0, -6.0]), np.array([1.0, -0.2, -10.0])
    first = {track: p for track, p, f in zip(tracks.track_id, tracks.position_m, tracks.frame, strict=True) if f == 0}
    velocity = np.where(tracks.object_id[:, None] == 1, moving, own)
    expected = np.array([first[track] for track in tracks.track_id]) + velocity * tracks.t_s[:, None]
    assert (tracks.object_id == 1).sum() > 100
    np.testing.assert_allclose(tracks.position_m, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(tracks.velocity_m_s, velocity, rtol=0, atol=1e-9)
    np.testing.assert_allclose(tracks.times.ttc_z_s, -expected[:, 2] / velocity[:, 2], rtol=1e-9)


def test_relative_velocity_is_the_derivative_of_the_place_with_the_rotation_removed():
    bus = {"name": "bus", "kind": "bus", "at_m": [18, 4, 0], "heading_deg": 200, "speed_m_s": 6, "yaw_rate_deg_s": 25}
    scene = scene_of(
        camera={"fps": 1000, "n_frames": 3, "pitch_deg": 3, "roll_deg": 2},
        own_motion={"speed_m_s": 6, "yaw_rate_deg_s": 8, "pitch_jitter_deg": 0.2, "acceleration_m_s2": -1},
        bodies=[bus],
    )
    tracks = simulate_tracks(scene, TrackOptions(n_tracks=150, death_rate=0, births=False))
    rotations = build_world(scene).path.cam_R_road
    frames = [tracks.frame == k for k in range(3)]
    common = set.intersection(*(set(tracks.track_id[mask]) for mask in frames))
    assert {1} <= set(tracks.object_id[np.isin(tracks.track_id, list(common))])
    before, now, after = (mask & np.isin(tracks.track_id, list(common)) for mask in frames)
    # In the axes of the road the difference of two places needs no camera rotation.
    places = [tracks.position_m[mask] @ rotations[k] for k, mask in enumerate((before, now, after))]
    derivative = (places[2] - places[0]) / 0.002
    np.testing.assert_allclose(derivative, tracks.velocity_m_s[now] @ rotations[1], atol=2e-4)


def test_rotation_of_a_turning_level_camera_is_about_its_y_axis():
    world = build_world(scene_of(own_motion={"speed_m_s": 5, "yaw_rate_deg_s": 10}))
    rotation = rotation_vectors_rad(world.path)
    assert np.isnan(rotation[0]).all()
    # Turning left moves what is seen to the right: a positive rotation about y, which points down.
    np.testing.assert_allclose(rotation[1:], np.tile([0, np.radians(1.0), 0], (11, 1)), atol=1e-12)


def test_mean_velocity_of_a_circle_is_its_chord():
    world = build_world(scene_of(own_motion={"speed_m_s": 5, "yaw_rate_deg_s": 10}))
    half = np.radians(0.5)
    chord = 5 * np.sin(half) / half
    expected = [chord * np.sin(half), 0, chord * np.cos(half)]
    np.testing.assert_allclose(mean_velocities_m_s(world.path)[1:], np.tile(expected, (11, 1)), atol=1e-10)


def test_horizon_of_a_camera_that_looks_down_lies_above_the_centre():
    scene = scene_of(camera={"pitch_deg": 5, "fx_px": 300, "hfov_deg": None})
    left, right = mean_horizon_px(scene)
    assert left == pytest.approx(89.5 - 300 * np.tan(np.radians(5)), abs=1e-9)
    assert right == pytest.approx(left, abs=1e-9)


def test_horizon_of_a_rolled_camera_is_tilted_by_the_roll():
    left, right = mean_horizon_px(scene_of(camera={"roll_deg": 4}))
    # Where the right side of the camera is low, the world's level line rises to the right.
    assert np.degrees(np.arctan2(left - right, 319)) == pytest.approx(4, abs=1e-9)


def test_far_points_of_the_ground_lie_on_the_horizon():
    scene = scene_of(camera={"pitch_deg": 4, "roll_deg": -3}, own_motion={"pitch_jitter_deg": 0.4})
    world = build_world(scene)
    for frame in (0, 7):
        far = world.path.cam_R_road[frame] @ np.array([1e9, 2e8, 0])
        x = world.camera.cx_px + world.camera.fx_px * far[0] / far[2]
        y = world.camera.cy_px + world.camera.fy_px * far[1] / far[2]
        left, right = horizon_lines_px(world.camera, world.path.cam_R_road)[frame]
        assert y == pytest.approx(left + (right - left) * x / 319, abs=1e-6)
