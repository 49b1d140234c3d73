"""Own motion of a camera that may go anywhere, by all views of a window, against exact truth."""

from dataclasses import replace

import numpy as np
import pytest
from drives import CAMERA, DT_S, Drive, extended_by, start
from test_frame_gap import FLOOR_PX, LEAST_PARALLAX_PX, STEP_M, among_movers, found
from two_views import FOCAL_PX, angle_deg, points_of_a_street

from ttcvid.config import EgomotionConfig
from ttcvid.geometry.estimation.rigid_motion import RigidPaths
from ttcvid.geometry.estimation.window_bundle import adjust_window, planar_dual
from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.model import Platform
from ttcvid.stages.egomotion.frame_gap import find_own_motion
from ttcvid.stages.egomotion.motion_prior import EgomotionMemory
from ttcvid.stages.tracking.history import empty_history, extended

FREE = EgomotionConfig(platform=Platform.free)
TIMES_S = np.arange(-19, 1) * 0.1


def swaying(t_s):
    """Half a metre a second, turning within a second: where the camera is, (L, 3)."""
    return np.column_stack([0.25 * np.sin(2.0 * t_s), 0.2 * np.sin(2.5 * t_s + 1.0), 0.3 * t_s])


def window(rng, sigma_px, n=80):
    """Views of static points by a camera that sways and turns, and its true poses from the present one."""
    rotation = rotation_from_vector(0.02 * rng.normal(size=(len(TIMES_S), 3)))
    rotation[-1] = np.eye(3)
    path = swaying(np.zeros(1)) - swaying(TIMES_S)
    points = points_of_a_street(n, rng, (4.0, 20.0))
    there = (points + path[:, None]) @ rotation
    xy = there[..., :2] / there[..., 2:] + sigma_px / FOCAL_PX * rng.normal(size=(len(TIMES_S), n, 2))
    point = np.column_stack([points[:, :2] / points[:, 2:], 1.0 / points[:, 2]])
    return xy, RigidPaths(rotation[None], path[None]), point


def last_step(fit):
    """The last step of a fitted window, in the axes of the present camera."""
    return -fit.paths.path[0, -2]


def disturbed(rng, paths, point):
    """A start: steps off by a tenth of the way, rotations by 0.1 deg, depths by a third."""
    path = paths.path * (1.0 + 0.1 * rng.normal(size=paths.path.shape))
    off = np.radians(0.1) * rng.normal(size=(len(TIMES_S), 3))
    off[-1] = 0.0
    start = point * [1.0, 1.0, 1.0] * np.exp(0.3 * rng.normal(size=(len(point), 3)) * [0.0, 0.0, 1.0])
    return RigidPaths(rotation_from_vector(off) @ paths.cam_R_past, path), start


def adjusted(xy, start, sigma_px, n_steps=15):
    n = xy.shape[1]
    return adjust_window(xy, np.full(n, sigma_px / FOCAL_PX), np.arange(n), *start, n_steps)


def test_poses_and_points_of_a_swaying_camera_are_exact_without_noise():
    rng = np.random.default_rng(1)
    xy, paths, point = window(rng, 0.0)
    fit = adjusted(xy, disturbed(rng, paths, point), 0.01, 30)
    assert angle_deg(last_step(fit), -paths.path[0, -2]) < 1e-4
    np.testing.assert_allclose(fit.paths.cam_R_past, paths.cam_R_past, atol=1e-7)
    scale = np.linalg.norm(fit.paths.path) / np.linalg.norm(paths.path)
    np.testing.assert_allclose(fit.paths.path, scale * paths.path, atol=1e-5)


def test_the_covariance_of_the_last_step_is_true():
    chi2 = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        xy, paths, point = window(rng, 0.2)
        fit = adjusted(xy, disturbed(rng, paths, point), 0.2)
        off = last_step(fit) / np.linalg.norm(last_step(fit)) + paths.path[0, -2] / np.linalg.norm(paths.path[0, -2])
        chi2.append(off @ np.linalg.pinv(fit.direction_cov, rcond=1e-6) @ off)
    assert 1.3 < np.mean(chi2) < 2.9


def test_a_path_past_points_behind_the_camera_is_turned_round():
    rng = np.random.default_rng(2)
    xy, paths, point = window(rng, 0.1)
    fit = adjusted(xy, (RigidPaths(paths.cam_R_past, -paths.path), point * [1.0, 1.0, -1.0]), 0.1)
    assert angle_deg(last_step(fit), -paths.path[0, -2]) < 3.0


def over_ground(rng, path, rotation, n=90, part_above=0.1):
    """Views of flat ground 12 m below a camera that looks 25 deg down, some points up to 2 m above it, by poses."""
    pitch = rotation_from_vector(np.radians([25.0, 0.0, 0.0]))
    reach_m = rng.uniform(12.0, 60.0, n)
    height_m = 12.0 - np.where(rng.uniform(size=n) < part_above, rng.uniform(0.0, 2.0, n), 0.0)
    points = np.column_stack([rng.uniform(-0.6, 0.6, n) * reach_m, height_m, reach_m]) @ pitch.T
    there = (points + path[:, None]) @ rotation
    noise = 0.2 / FOCAL_PX * rng.normal(size=(len(path), n, 2))
    return there[..., :2] / there[..., 2:] + noise, np.column_stack([points[:, :2] / points[:, 2:], 1.0 / points[:, 2]])


def test_flat_ground_leaves_a_second_motion_and_its_dual_leads_back_to_the_true_one():
    velocity_m_s, wrong_deg, back_deg = np.array([0.5, -0.3, 2.0]), [], []
    for seed in range(10):
        rng, path = np.random.default_rng(seed), -TIMES_S[:, None] * velocity_m_s
        rotation = np.tile(np.eye(3), (len(TIMES_S), 1, 1))
        xy, point = over_ground(rng, path, rotation)
        true = adjusted(xy, (RigidPaths(rotation[None], path[None]), point), 0.2)
        assert angle_deg(last_step(true), -velocity_m_s) < 6.0
        wrong = adjusted(xy, planar_dual(true), 0.2)
        back = adjusted(xy, planar_dual(wrong), 0.2)
        assert back.cost < 0.9 * wrong.cost
        wrong_deg.append(angle_deg(last_step(wrong), -velocity_m_s))
        back_deg.append(angle_deg(last_step(back), -velocity_m_s))
    assert min(wrong_deg) > 60.0
    assert max(back_deg) < 6.0


def test_a_drone_over_flat_ground_that_was_taken_to_climb_is_seen_to_drift():
    times_s, velocity_m_s = 0.1 * np.arange(14), np.array([0.5, -0.3, 2.0])
    turned = np.tile(np.eye(3), (len(times_s), 1, 1))
    for seed in range(5):
        xy, _ = over_ground(np.random.default_rng(seed), -times_s[:, None] * velocity_m_s, turned)
        motion = Drive(normalize(np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=2)), turned)
        history, memory, everything = start(), EgomotionMemory(), np.ones(motion.n, dtype=bool)
        for frame in range(len(times_s)):
            history = extended_by(history, motion, frame)
            if frame == len(times_s) - 1:
                window = memory.window
                shape = xy[frame - len(window.frame) : frame], np.full(motion.n, 0.2 / FOCAL_PX), np.arange(motion.n)
                rate = np.full((motion.n, 1), 0.05)
                fit = adjust_window(*shape, window.paths, np.concatenate([xy[frame - 1], rate], axis=1), 15)
                wrong = adjust_window(*shape, *planar_dual(fit), 0)
                memory = replace(memory, window=replace(window, paths=wrong.paths))
                assert angle_deg(last_step(wrong), -velocity_m_s) > 60.0
            step, history, memory = find_own_motion(
                history, everything, everything, memory, FREE, LEAST_PARALLAX_PX, FLOOR_PX
            )
        assert angle_deg(step.direction, -velocity_m_s) < 10.0


@pytest.mark.parametrize("part_above", [0.0, 0.1])
def test_over_flat_ground_the_true_motion_is_not_left_for_its_dual(part_above):
    """About as fast as it is high in 12 s: noise alone often makes the dual the cheaper one."""
    times_s, velocity_m_s, off_deg = 0.1 * np.arange(24), np.array([0.25, -0.15, 1.0]), []
    turned = np.tile(np.eye(3), (len(times_s), 1, 1))
    for seed in range(4):
        rng = np.random.default_rng(seed)
        xy, _ = over_ground(rng, -times_s[:, None] * velocity_m_s, turned, part_above=part_above)
        motion = Drive(normalize(np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=2)), turned)
        steps, _ = found(motion, config=FREE)
        off_deg += [angle_deg(one.direction, -velocity_m_s) for one in steps[1:] if one.direction is not None]
    assert len(off_deg) > 40
    assert np.mean(np.array(off_deg) > 20.0) < 0.05


@pytest.mark.parametrize("n_of_each", [16, 24])
def test_movers_that_hold_most_of_the_tracks_are_not_the_scene(n_of_each):
    """They are not known. The scene holds most of the picture, and stays rigid over all views."""
    off_deg = []
    for seed in range(4):
        motion, _ = in_patches(np.random.default_rng(seed), n_of_each)
        steps, _ = found(motion, config=FREE)
        off_deg += [angle_deg(step.direction, -STEP_M) for step in steps[6:] if step.direction is not None]
    assert len(off_deg) > 20
    assert np.median(off_deg) < 3.0
    assert np.quantile(off_deg, 0.9) < 10.0


def in_patches(rng, n_of_each):
    """As `among_movers`, each of the movers in a small part of the picture."""
    return among_movers(rng, n_static=45, n_of_each=n_of_each, n_frames=12, patch=0.12)


def aside(speed_m, n_frames=12, turn_deg=0.0, stretch=1.0):
    """Aside at so many metres a frame, turning about the vertical axis before a lens ``stretch`` times as long."""
    rng, rays = np.random.default_rng(1), []
    points = points_of_a_street(150, rng, (8.0, 25.0))
    for frame in range(n_frames):
        turn = rotation_from_vector(np.array([0.0, np.radians(turn_deg) * frame, 0.0]))
        there = (points - [speed_m * frame, 0.0, 0.0]) @ turn.T
        plane = there / there[:, 2:] * [stretch, stretch, 1.0]
        plane[:, :2] += 0.1 / FOCAL_PX * rng.normal(size=(len(points), 2))
        rays.append(normalize(plane))
    return Drive(np.array(rays), np.tile(np.eye(3), (n_frames, 1, 1)))


def last_of(motion, common_error_px=0.0, camera=CAMERA):
    """Own motion of the last frame, and what is remembered of it."""
    history, memory, everything = empty_history(camera, 0.2), EgomotionMemory(), np.ones(motion.n, dtype=bool)
    for frame in range(len(motion.rays)):
        points = replace(motion.points(frame), common_error_px=common_error_px)
        history = extended(history, frame, frame * DT_S, points, motion.rays[frame], 21)
        step, history, memory = find_own_motion(history, everything, everything, memory, FREE, LEAST_PARALLAX_PX, 0.05)
    return step, memory


def test_a_direction_is_told_where_the_flow_of_the_window_is_larger_than_what_tracks_err_in_common():
    fast, _ = last_of(aside(0.1), common_error_px=0.25)
    assert fast.is_told
    assert angle_deg(fast.direction, np.array([-1.0, 0.0, 0.0])) < 3.0
    (slow, _), (alone, _) = last_of(aside(0.015), common_error_px=0.25), last_of(aside(0.015))
    assert not slow.is_told
    assert alone.is_told
    assert np.trace(slow.direction_cov) > 4.0 * np.trace(alone.direction_cov)


@pytest.mark.parametrize(("turn_deg", "stretch", "k1"), [(1.0, 1.0, 0.1), (1.5, 1.0, -0.1), (1.5, 1.06, 0.0)])
def test_a_pan_before_a_lens_that_nobody_measured_is_told_as_no_translation(turn_deg, stretch, k1):
    pan = aside(0.0, n_frames=20, turn_deg=turn_deg, stretch=stretch)
    plane = pan.rays / pan.rays[..., 2:]
    plane[..., :2] *= 1.0 + k1 * (plane[..., :2] ** 2).sum(axis=2, keepdims=True)
    bent = replace(pan, rays=normalize(plane))
    assert not last_of(bent, common_error_px=0.25)[0].is_told
    # Who says that the lens is known is believed.
    assert last_of(bent, common_error_px=0.25, camera=replace(CAMERA, origin="given"))[0].is_told
