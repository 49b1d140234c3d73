"""Own motion along a drive: where the flow of one step is short, a longer gap makes it surer."""

import numpy as np
import pytest
from drives import Drive, drive, extended_by, start
from two_views import FOCAL_PX, angle_deg, points_of_a_street

from ttcvid.config import EgomotionConfig
from ttcvid.geometry.rotation import normalize, vector_from_rotation
from ttcvid.model import Platform
from ttcvid.stages.egomotion.frame_gap import find_own_motion
from ttcvid.stages.egomotion.motion_prior import EgomotionMemory
from ttcvid.stages.egomotion.relative_pose import RayPairs, estimate_egomotion, picture_region
from ttcvid.stages.egomotion.window_motion import LEAST_TOLD

FORWARD = np.array([0.0, 0.0, -1.0])
CONFIG = EgomotionConfig(platform=Platform.vehicle)
LEAST_PARALLAX_PX, FLOOR_PX = 0.25, 0.05


def found(motion, is_free=None, config=CONFIG, in_scene=None):
    """Own motion of each frame, and the last history. ``is_free`` is of all frames, or ``(T, N)`` of each."""
    history, memory, steps = start(), EgomotionMemory(), []
    for frame in range(len(motion.rays)):
        history = extended_by(history, motion, frame)
        everything = np.ones(motion.n, dtype=bool)
        free = everything if is_free is None else np.broadcast_to(is_free, (len(motion.rays), motion.n))[frame]
        egomotion, history, memory = find_own_motion(
            history,
            free,
            everything if in_scene is None else in_scene,
            memory,
            config,
            LEAST_PARALLAX_PX,
            FLOOR_PX,
        )
        steps.append(egomotion)
    return steps, history


def from_single_steps(motion):
    """Own motion of each step by itself."""
    memory, steps = EgomotionMemory(), []
    sigma_rad = np.full(motion.n, 0.2 / FOCAL_PX)
    for frame in range(1, len(motion.rays)):
        pairs = RayPairs(motion.rays[frame - 1], motion.rays[frame], sigma_rad, picture_region(motion.rays[frame]))
        step = estimate_egomotion(pairs, LEAST_PARALLAX_PX / FOCAL_PX, memory, CONFIG.platform)
        memory = memory.after(step)
        steps.append(step)
    return steps


def turn_error_deg(cam_R, true_R):
    return np.degrees(np.linalg.norm(vector_from_rotation(cam_R @ true_R.T)))


def test_the_first_frame_has_no_motion_and_every_other_has():
    steps, history = found(drive(4, np.random.default_rng(1), sigma_px=0.1))
    assert steps[0] is None
    assert all(step is not None and step.direction is not None for step in steps[1:])
    assert history.frame.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("turn_deg", [(0.0, 0.0, 0.0), (0.02, 0.6, 0.01)], ids=["straight", "turning"])
def test_rotation_and_direction_are_found_along_a_drive(turn_deg):
    motion = drive(14, np.random.default_rng(2), turn_deg=turn_deg, sigma_px=0.15)
    steps, history = found(motion)
    late = steps[6:]
    assert max(turn_error_deg(step.cam_R_prev, motion.cam_R_prev[1]) for step in late) < 0.05
    # Over a gap in a curve the direction is the mean over it: it lags by half of the turn.
    lag_deg = 5 * np.linalg.norm(turn_deg) / 2
    assert max(angle_deg(step.direction, FORWARD) for step in late) < 0.5 + lag_deg
    assert max(turn_error_deg(history.cam_R_past[i], motion.cam_R(13, 13 - 10 + i)) for i in range(10)) < 0.1


def slow_drive(seed):
    """Creeping at a tenth of a metre a frame: most flows of one step are shorter than a pixel."""
    return drive(12, np.random.default_rng(seed), speed_m=0.1, sigma_px=0.2, turn_deg=(0.0, 0.2, 0.0))


def test_a_longer_gap_makes_a_slow_drive_surer():
    one, several = [], []
    for seed in range(6):
        motion = slow_drive(seed)
        for steps, errors in ((from_single_steps(motion), one), (found(motion)[0], several)):
            last = steps[-1]
            errors.append(90.0 if last.direction is None else angle_deg(last.direction, FORWARD))
    assert np.median(several) < 0.75 * np.median(one)
    assert np.median(several) < 2.5


@pytest.mark.parametrize("platform", [Platform.free, Platform.vehicle])
@pytest.mark.parametrize(("speed_m", "sigma_px"), [(0.0, 0.1), (0.02, 0.05), (0.06, 0.1), (0.1, 0.05)])
def test_the_noise_of_tracks_is_theirs_however_slow_the_camera(platform, speed_m, sigma_px):
    """In single steps of 2 to 6 cm no translation is seen: what is left of the flow was taken for noise, four times
    what it is, and no small thing that came nearer stood out of that.
    """
    motion = drive(20, np.random.default_rng(1), speed_m=speed_m, sigma_px=sigma_px)
    _, history = found(motion, config=EgomotionConfig(platform=platform))
    assert history.pool_sigma_px == pytest.approx(sigma_px, rel=0.15)


def test_summed_rotations_drift_less_than_single_steps_do():
    one, several = [], []
    for seed in range(6):
        motion = slow_drive(seed)
        summed = np.eye(3)
        for step in from_single_steps(motion)[-10:]:
            summed = step.cam_R_prev @ summed
        one.append(turn_error_deg(summed, motion.cam_R(11, 1)))
        several.append(turn_error_deg(found(motion)[1].cam_R_past[0], motion.cam_R(11, 1)))
    assert np.median(several) < np.median(one)
    assert max(several) < 0.15


def test_too_few_tracks_give_no_motion_and_forget_the_past():
    motion = drive(5, np.random.default_rng(4), n=11, sigma_px=0.1)
    steps, history = found(motion)
    assert steps == [None] * 5
    assert history.frame.tolist() == [4]
    assert found(motion, config=EgomotionConfig(min_tracks=11, platform=Platform.free))[0][-1] is not None


def test_frozen_tracks_take_no_part():
    """A third of the tracks is glued to the windscreen."""
    motion = drive(12, np.random.default_rng(5), sigma_px=0.1, speed_m=1.0)
    glued = np.arange(motion.n) < motion.n // 3
    motion.rays[:, glued] = motion.rays[0, glued]
    steps, _ = found(motion, is_free=~glued)
    assert angle_deg(steps[-1].direction, FORWARD) < 0.3
    assert len(steps[-1].residual) == np.count_nonzero(~glued)


def test_a_few_tracks_of_the_scene_say_more_than_a_hundred_of_known_movers():
    """A resting camera over a full junction: nine tracks of houses, seven movers, each its own way."""
    rng = np.random.default_rng(8)
    motion, in_scene = drive(12, rng, n=121, speed_m=0.0, sigma_px=0.2), np.arange(121) < 9
    steps_px = np.repeat(rng.uniform(-3.0, 3.0, size=(7, 2)), 16, axis=0)
    for frame in range(12):
        xy = motion.rays[frame, ~in_scene, :2] / motion.rays[frame, ~in_scene, 2:] + frame * steps_px / FOCAL_PX
        motion.rays[frame, ~in_scene] = normalize(np.column_stack([xy, np.ones(len(xy))]))
    steps, _ = found(motion, config=EgomotionConfig(platform=Platform.static), in_scene=in_scene)
    assert max(turn_error_deg(step.cam_R_prev, np.eye(3)) for step in steps[1:]) < 0.05


@pytest.mark.parametrize("seed", range(4))
def test_a_few_tracks_of_the_scene_do_not_make_the_noise_vanish_where_we_drive(seed):
    """A translation fits six tracks to their noise: of 0.2 px it left 0.05."""
    rng = np.random.default_rng(seed)
    motion, in_scene = drive(20, rng, n=66, speed_m=0.6, sigma_px=0.2), np.arange(66) < 6
    steps_px = np.repeat(rng.uniform(-3.0, 3.0, size=(4, 2)), 15, axis=0)
    for frame in range(20):
        xy = motion.rays[frame, ~in_scene, :2] / motion.rays[frame, ~in_scene, 2:] + frame * steps_px / FOCAL_PX
        motion.rays[frame, ~in_scene] = normalize(np.column_stack([xy, np.ones(len(xy))]))
    _, history = found(motion, in_scene=in_scene)
    assert history.pool_sigma_px > 0.15


def test_a_stop_ends_the_direction_and_a_start_brings_it_back():
    motion = drive(26, np.random.default_rng(6), speed_m=0.6, sigma_px=0.1)
    # Stands from frame 6 to frame 19: the same rays, with noise of their own.
    noise = 0.1 / FOCAL_PX * np.random.default_rng(7).normal(size=motion.rays[6:20].shape)
    stopped = np.concatenate([motion.rays[:6], motion.rays[5] + noise, motion.rays[6:12]])
    steps, _ = found(type(motion)(stopped, motion.cam_R_prev))
    has_direction = [step is not None and step.direction is not None for step in steps]
    assert all(has_direction[1:6])
    assert not any(has_direction[17:20])
    assert has_direction[-1]
    assert angle_deg(steps[-1].direction, FORWARD) < 0.5


STEP_M = np.array([0.25, -0.1, 0.1])
GROUPS_M = ((0.5, 0.25, -0.1), (-0.6, 0.1, 0.2), (0.1, -0.7, 0.0))


def among_movers(rng, n_static, n_of_each, n_frames=8, sigma_px=0.2, patch=None):
    """A camera that goes aside among three bodies that each go their own way; and which points are static.

    The bodies are spread over the picture, or each is in a ``patch``, by its share of the distance.
    """
    n = n_static + n_of_each * len(GROUPS_M)
    velocity_m = np.zeros((n, 3))
    for number, group_m in enumerate(GROUPS_M):
        velocity_m[n_static + number * n_of_each :][:n_of_each] = group_m
    places = points_of_a_street(n, rng, (8.0, 25.0))
    for number in range(len(GROUPS_M) if patch is not None else 0):
        own = places[n_static + number * n_of_each :][:n_of_each]
        own[:] = own[0] + patch * own[0, 2] * rng.uniform(-0.5, 0.5, own.shape)
    rays = []
    for frame in range(n_frames):
        plane = places + frame * (velocity_m - STEP_M)
        plane = plane / plane[:, 2:]
        plane[:, :2] += sigma_px / FOCAL_PX * rng.normal(size=(n, 2))
        rays.append(normalize(plane))
    turns = np.tile(np.eye(3), (n_frames, 1, 1))
    return Drive(np.array(rays), turns), np.arange(n) < n_static


def direction_errors_deg(motion, in_scene):
    steps, _ = found(motion, config=EgomotionConfig(platform=Platform.free), in_scene=in_scene)
    way = -STEP_M / np.linalg.norm(STEP_M)
    # Of fewer views none is told.
    assert not any(step.is_told for step in steps[: LEAST_TOLD - 1] if step is not None)
    return [90.0 if step.direction is None else angle_deg(step.direction, way) for step in steps[LEAST_TOLD - 1 :]]


@pytest.mark.parametrize("sigma_px", [0.0, 0.2])
def test_known_movers_do_not_turn_the_direction_though_most_tracks_are_theirs(sigma_px):
    known, unknown = [], []
    for seed in range(3):
        motion, is_static = among_movers(np.random.default_rng(seed), n_static=40, n_of_each=16, sigma_px=sigma_px)
        known += direction_errors_deg(motion, is_static)
        unknown += direction_errors_deg(motion, None)
    assert np.median(known) < 0.05 + 7.0 * sigma_px
    assert np.quantile(known, 0.9) < 0.5 * np.quantile(unknown, 0.9)


def test_where_the_scene_is_taken_for_movers_all_tracks_tell_of_own_motion():
    """A way back: what is known of movers may be wrong."""
    for seed in range(3):
        motion, is_static = among_movers(np.random.default_rng(seed), n_static=120, n_of_each=10)
        assert np.median(direction_errors_deg(motion, ~is_static)) < 3.0


def to_and_fro(seed, n_ahead=14, n_still=10, n_back=20):
    """A camera that is mounted 8 deg off drives ahead, stands, and goes back."""
    speeds_m = np.repeat([0.5, 0.0, -0.5], [n_ahead, n_still, n_back])
    rng, way = np.random.default_rng(seed), np.array([np.sin(np.radians(8.0)), 0.0, np.cos(np.radians(8.0))])
    places, rays = points_of_a_street(250, rng, (15.0, 60.0)), []
    for gone_m in np.cumsum(speeds_m) - speeds_m[0]:
        plane = (places - gone_m * way) / (places - gone_m * way)[:, 2:]
        plane[:, :2] += 0.2 / FOCAL_PX * rng.normal(size=(len(places), 2))
        rays.append(normalize(plane))
    return Drive(np.array(rays), np.tile(np.eye(3), (len(rays), 1, 1))), -way


@pytest.mark.parametrize("n_still", [0, 1, 3, 10])
@pytest.mark.parametrize("seed", range(2))
def test_a_car_goes_back_whether_or_not_it_is_seen_to_stand_before(n_still, seed):
    motion, ahead = to_and_fro(seed, n_still=n_still)
    steps, _ = found(motion)
    assert max(angle_deg(step.direction, ahead) for step in steps[6:14]) < 2.0
    assert max(angle_deg(step.direction, -ahead) for step in steps[-8:]) < 2.0
    # Until it is known to go back, its direction is not told.
    told = [step for step in steps[14 + n_still + 5 :] if step.direction is not None and step.is_told]
    assert max(angle_deg(step.direction, -ahead) for step in told) < 2.0
    if n_still == 10:
        assert all(step.direction is None for step in steps[20:24])


@pytest.mark.parametrize("seed", range(3))
def test_what_the_usual_direction_does_not_explain_is_not_drawn_to_it(seed):
    """A camera ahead of the rear axle goes aside by 10 deg in a bend, before a scene that is 60 to 200 m away."""
    rng, ways = np.random.default_rng(seed), np.radians(np.repeat([0.0, 10.0], [25, 15]))
    places, rays = points_of_a_street(250, rng, (100.0, 250.0)), []
    for way in ways:
        places = places - 1.5 * np.array([np.sin(way), 0.0, np.cos(way)])
        plane = places / places[:, 2:]
        plane[:, :2] += 0.2 / FOCAL_PX * rng.normal(size=(len(places), 2))
        rays.append(normalize(plane))
    steps, _ = found(Drive(np.array(rays), np.tile(np.eye(3), (len(rays), 1, 1))))
    true_dir = -np.array([np.sin(ways[-1]), 0.0, np.cos(ways[-1])])
    off_deg = [angle_deg(step.direction, true_dir) for step in steps[-8:]]
    sigma_deg = [np.degrees(np.sqrt(np.trace(step.direction_cov))) for step in steps[-8:]]
    assert np.median(np.divide(off_deg, sigma_deg)) < 2.0


NEAR_AND_FAR_M = ((60.0, 150.0), (200.0, 500.0))


def test_before_a_far_scene_the_usual_direction_is_better_known_than_that_of_a_step():
    """At 200 to 500 m, by themselves, the steps err by several degrees."""
    off_deg, first_deg = [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        near, far = (drive(40, rng, n=150, sigma_px=0.4, speed_m=1.0, depth_m=depth_m) for depth_m in NEAR_AND_FAR_M)
        is_there = np.repeat([[True] * 150 + [False] * 150, [False] * 150 + [True] * 150], [12, 28], axis=0)
        steps, _ = found(Drive(np.concatenate([near.rays, far.rays], axis=1), far.cam_R_prev), is_there)
        off_deg += [angle_deg(step.direction, FORWARD) for step in steps[24:] if step.direction is not None]
        alone, _ = found(Drive(far.rays[:12], far.cam_R_prev[:12]))
        first_deg += [angle_deg(step.direction, FORWARD) for step in alone[1:] if step.direction is not None]
    assert len(off_deg) > 20
    assert np.median(off_deg) < 0.5 * np.median(first_deg)
