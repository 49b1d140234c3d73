"""Flows over a gap that grows until they are long enough, and the scene's direction over each gap."""

import numpy as np
import pytest
from drives import DT_S, drive, extended_by, start
from two_views import FOCAL_PX, angle_deg

from ttcvid.geometry.rotation import normalize
from ttcvid.model import PointSet
from ttcvid.stages.egomotion.flows import scene_directions, select_flows
from ttcvid.stages.tracking.history import extended, with_egomotion

FORWARD = np.array([0.0, 0.0, -1.0])
TURN_DEG = (0.1, 0.8, -0.2)


def history_of(motion, direction=FORWARD, rotation_sigma_rad=0.0, max_frames=11):
    history = start()
    for frame in range(len(motion.rays)):
        history = extended_by(history, motion, frame, max_frames)
        if frame:
            history = with_egomotion(history, motion.cam_R_prev[frame], direction, rotation_sigma_rad)
    return history


def length_px(flows):
    return np.linalg.norm(flows.second - flows.first, axis=1) * FOCAL_PX


def test_gap_is_the_smallest_with_the_wanted_flow():
    motion = drive(11, np.random.default_rng(1), turn_deg=TURN_DEG, speed_m=0.15)
    history = history_of(motion)
    flows = select_flows(history, 10, 8.0)
    long_enough = length_px(flows) >= 8.0
    assert 0.2 < long_enough.mean() < 0.95
    assert (flows.gap_frames[~long_enough] == 10).all()
    shorter = np.flatnonzero(long_enough & (flows.gap_frames > 1))
    before = np.array([history.derotated(-flows.gap_frames[i])[i] for i in shorter])
    assert (np.linalg.norm(flows.second[shorter] - before, axis=1) * FOCAL_PX < 8.0).all()


@pytest.mark.parametrize(("speed_m", "gap"), [(10.0, 1), (0.001, 10)], ids=["fast", "creeping"])
def test_fast_scenes_take_one_frame_and_slow_ones_all(speed_m, gap):
    motion = drive(11, np.random.default_rng(2), speed_m=speed_m, depth_m=(150.0, 200.0))
    flows = select_flows(history_of(motion), 10, 3.0)
    off_epipole = np.linalg.norm(motion.rays[-1][:, :2], axis=1) > 0.2
    assert (flows.gap_frames[off_epipole] == gap).all()


def test_gap_never_exceeds_the_limit_or_the_history():
    motion = drive(6, np.random.default_rng(3), speed_m=0.01)
    assert select_flows(history_of(motion), 10, 8.0).gap_frames.max() == 5
    assert select_flows(history_of(motion), 3, 8.0).gap_frames.max() == 3


def test_rotation_leaves_no_flow():
    motion = drive(8, np.random.default_rng(4), speed_m=0.0, turn_deg=TURN_DEG)
    flows = select_flows(history_of(motion), 10, 8.0)
    np.testing.assert_allclose(length_px(flows), 0.0, atol=1e-8)
    assert (flows.gap_frames == 7).all()


def test_flows_of_static_points_point_along_the_scenes_direction():
    motion = drive(8, np.random.default_rng(5), turn_deg=TURN_DEG)
    history = history_of(motion)
    flows = select_flows(history, 10, 8.0)
    directions = scene_directions(history, flows)
    off_plane = np.einsum("ni,ni->n", normalize(np.cross(flows.first, flows.second)), directions)
    assert np.degrees(np.arcsin(np.abs(off_plane))).max() < 0.05
    assert (np.einsum("ni,ni->n", flows.second - flows.first, directions) > 0).all()


def test_time_of_the_gap_is_that_of_its_frames():
    motion = drive(5, np.random.default_rng(6), speed_m=0.01)
    history, times_s = start(), [0.0, 0.1, 0.35, 0.4, 0.9]
    for frame, t_s in enumerate(times_s):
        history = extended(history, frame, t_s, motion.points(frame), motion.rays[frame], 11)
    flows = select_flows(history, 3, 8.0)
    np.testing.assert_allclose(flows.gap_s, 0.9 - 0.1)


def test_tracks_of_one_observation_have_no_flow():
    motion = drive(3, np.random.default_rng(7))
    history = history_of(motion)
    new = PointSet(np.append(np.arange(motion.n), 999), np.concatenate([history.xy_px, [[10.0, 10.0]]]))
    rays = np.concatenate([motion.rays[-1], [[0.0, 0.0, 1.0]]])
    flows = select_flows(extended(history, 3, 3 * DT_S, new, rays, 11), 10, 8.0)
    assert flows.has_flow.tolist() == [True] * motion.n + [False]
    assert flows.gap_frames[-1] == 0
    assert np.isnan(flows.first[-1]).all()
    assert np.isfinite(flows.sigma_rad).all()


def test_tracks_without_a_present_ray_have_no_flow():
    """A point that a lens which bends lines does not map any more."""
    motion = drive(4, np.random.default_rng(7))
    rays = motion.rays[3].copy()
    rays[5] = np.nan
    history = extended(history_of(drive(3, np.random.default_rng(7))), 3, 3 * DT_S, motion.points(3), rays, 11)
    flows = select_flows(history, 10, 8.0)
    assert np.flatnonzero(~flows.has_flow).tolist() == [5]
    assert flows.gap_frames[5] == flows.gap_s[5] == 0
    assert np.isnan(flows.first[5]).all()
    assert np.isnan(flows.second[5]).all()


def test_a_track_that_is_younger_than_the_others_uses_what_it_has():
    motion = drive(6, np.random.default_rng(8), speed_m=0.01)
    history = start()
    for frame in range(6):
        first = 50 if frame < 3 else 0
        everything = motion.points(frame)
        points = PointSet(everything.track_id[first:], everything.xy_px[first:])
        history = extended(history, frame, frame * DT_S, points, motion.rays[frame, first:], 11)
    gap = select_flows(history, 10, 8.0).gap_frames
    assert (gap[:50] == 2).all()
    assert (gap[50:] == 5).all()


def test_error_of_the_rotation_is_shared_out_to_both_rays():
    motion = drive(11, np.random.default_rng(9), speed_m=0.0)
    exact = select_flows(history_of(motion), 10, 8.0)
    rough = select_flows(history_of(motion, rotation_sigma_rad=1e-3), 10, 8.0)
    added = rough.sigma_rad**2 - exact.sigma_rad**2
    np.testing.assert_allclose(2.0 * added, 1e-6, rtol=1e-9)


def test_length_in_sigmas_is_chi_for_noise_alone():
    motion = drive(2, np.random.default_rng(10), n=3000, speed_m=0.0, sigma_px=0.2, depth_m=(1e6, 2e6))
    flows = select_flows(history_of(motion), 10, 8.0)
    length = np.linalg.norm(flows.second - flows.first, axis=1) / (np.sqrt(2.0) * flows.sigma_rad)
    assert np.mean(length**2) == pytest.approx(2.0, rel=0.1)


def test_scene_direction_over_a_gap_is_the_mean_of_its_steps():
    motion = drive(4, np.random.default_rng(11), speed_m=0.001)
    history = extended_by(start(), motion, 0)
    for frame, degrees in ((1, 2.0), (2, 4.0), (3, 6.0)):
        swung = np.array([np.sin(np.radians(degrees)), 0.0, -np.cos(np.radians(degrees))])
        history = with_egomotion(extended_by(history, motion, frame), np.eye(3), swung, 0.0)
    for gap, expected_deg in ((1, 6.0), (2, 5.0), (3, 4.0)):
        directions = scene_directions(history, select_flows(history, gap, 8.0))
        expected = np.array([np.sin(np.radians(expected_deg)), 0.0, -np.cos(np.radians(expected_deg))])
        assert max(angle_deg(d, expected) for d in directions) < 1e-6


def test_scene_directions_are_turned_into_the_present_camera():
    motion = drive(5, np.random.default_rng(12), speed_m=0.001, turn_deg=(0.0, 2.0, 0.0))
    # A direction fixed in the world, as the turning camera sees it.
    world = normalize(np.array([0.3, 0.1, -1.0]))
    history = extended_by(start(), motion, 0)
    for frame in range(1, 5):
        seen = motion.cam_R(frame, 0) @ world
        history = with_egomotion(extended_by(history, motion, frame), motion.cam_R_prev[frame], seen, 0.0)
    directions = scene_directions(history, select_flows(history, 4, 8.0))
    np.testing.assert_allclose(directions, np.tile(motion.cam_R(4, 0) @ world, (motion.n, 1)), atol=1e-12)


def test_steps_without_translation_do_not_count_and_none_at_all_leaves_it_open():
    motion = drive(4, np.random.default_rng(13), speed_m=0.001)
    history = extended_by(start(), motion, 0)
    for frame, direction in ((1, FORWARD), (2, None), (3, None)):
        history = with_egomotion(extended_by(history, motion, frame), np.eye(3), direction, 0.0)
    np.testing.assert_allclose(scene_directions(history, select_flows(history, 3, 8.0))[0], FORWARD)
    assert np.isnan(scene_directions(history, select_flows(history, 2, 8.0))).all()
