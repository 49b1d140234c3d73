"""What is kept of every live track: its rays, the rotations between the cameras, and its noise."""

from dataclasses import replace

import numpy as np
import pytest
from drives import CAMERA, DT_S, drive, extended_by, start
from two_views import FOCAL_PX

from ttcvid.geometry.camera.pinhole import pixels_from_rays, rays_from_pixels
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Camera, ImageSize, PointSet
from ttcvid.stages.tracking.history import empty_history, extended, last_frame_only, with_egomotion
from ttcvid.stages.tracking.noise import with_noise

FLOOR_PX = 0.05
FORWARD = np.array([0.0, 0.0, -1.0])


def point_set(*track_ids):
    """Points whose place and ray tell their track: track 7 at (70, 7)."""
    ids = np.array(track_ids, dtype=np.int64)
    xy_px = np.column_stack([10.0 * ids, ids])
    rays = np.column_stack([ids / 100, np.zeros(len(ids)), np.ones(len(ids))])
    return PointSet(ids, xy_px), rays


def history_of(*frames, max_frames=5, unseen_id=()):
    """Tracks ``unseen_id`` may come back; None: any."""
    history = start()
    for frame, ids in enumerate(frames):
        points, rays = point_set(*ids)
        points = replace(points, unseen_id=unseen_id if unseen_id is None else np.array(unseen_id, dtype=np.int64))
        history = extended(history, frame, frame * DT_S, points, rays + np.array([0, frame / 1000, 0]), max_frames)
    return history


def test_rays_of_a_track_are_kept_in_its_place_when_others_come_and_go():
    history = history_of([1, 3, 5], [3, 5, 8], [2, 3, 8, 9])
    assert history.track_id.tolist() == [2, 3, 8, 9]
    assert history.n_frames.tolist() == [1, 3, 2, 1]
    assert history.rays.shape == (3, 4, 3)
    np.testing.assert_allclose(history.rays[:, 1, 0], 0.03)
    np.testing.assert_allclose(history.rays[:, 1, 1], [0.0, 0.001, 0.002])
    np.testing.assert_allclose(history.rays[1:, 2, 0], 0.08)
    assert np.isnan(history.rays[0, 2]).all()
    assert np.isnan(history.rays[:2, [0, 3]]).all()
    np.testing.assert_allclose(history.xy_px[:, 0], [20, 30, 80, 90])


def test_a_track_that_was_gone_for_a_frame_begins_anew():
    history = history_of([1, 2], [1], [1, 2])
    assert history.n_frames.tolist() == [3, 1]
    assert np.isnan(history.rays[:2, 1]).all()


def test_a_track_that_may_come_back_goes_on_where_it_was():
    history = history_of([1, 2, 5], [1], [5], [1, 2, 3], unseen_id=None)
    assert history.track_id.tolist() == [1, 2, 3]
    assert history.n_frames.tolist() == [3, 2, 1]
    np.testing.assert_allclose(history.rays[[0, 1, 3], 0, 1], [0.0, 0.001, 0.003])
    np.testing.assert_allclose(history.rays[[0, 3], 1], [[0.02, 0.0, 1.0], [0.02, 0.003, 1.0]])
    assert np.isnan(history.rays[2, 0]).all()
    assert np.isnan(history.rays[1:3, 1]).all()
    assert np.isnan(history.rays[:3, 2]).all()
    assert history.lost.track_id.tolist() == [5]


def test_only_a_track_that_is_followed_on_may_come_back():
    history = history_of([1, 2, 5], [1], [5], [1, 2, 5], unseen_id=[2])
    assert history.n_frames.tolist() == [1, 2, 2]
    assert history_of([1, 2, 5], [1], unseen_id=[2]).lost.track_id.tolist() == [2]


def test_a_track_that_is_gone_for_longer_than_the_history_reaches_begins_anew():
    frames = [[1, 2], [1], [1], [1], [1], [1, 2]]
    assert history_of(*frames, max_frames=6, unseen_id=None).n_frames.tolist() == [6, 2]
    assert history_of(*frames, max_frames=4, unseen_id=None).n_frames.tolist() == [6, 1]
    assert history_of(*frames, max_frames=4, unseen_id=None).lost is None


def test_no_more_than_the_wanted_frames_are_kept():
    history = history_of(*[[1, 2]] * 9, max_frames=4)
    assert history.frame.tolist() == [5, 6, 7, 8]
    np.testing.assert_allclose(history.t_s, np.array([5, 6, 7, 8]) * DT_S)
    assert history.rays.shape == (4, 2, 3)
    assert history.cam_R_past.shape == (4, 3, 3)
    assert history.scene_direction.shape == (4, 3)
    assert history.n_frames.tolist() == [9, 9]
    np.testing.assert_allclose(history.rays[:, 0, 1], np.array([5, 6, 7, 8]) / 1000)


def timed_history(fps, n_frames, max_frames=20):
    history = start()
    for frame in range(n_frames):
        points, rays = point_set(1, 2)
        history = extended(history, frame, frame / fps, points, rays + np.array([0, frame / 1000, 0]), max_frames)
    return history


@pytest.mark.parametrize("fps", [5.0, 9.6, 30000 / 1001, 30.0])
def test_up_to_thirty_frames_a_second_every_view_is_kept(fps):
    assert timed_history(fps, 50).frame.tolist() == list(range(30, 50))
    rounded = start()
    for frame in range(50):
        rounded = extended(rounded, frame, round(frame / fps, 3), *point_set(1, 2), 20)
    assert rounded.frame.tolist() == list(range(30, 50))


@pytest.mark.parametrize("fps", [31.0, 48.0, 60.0, 120.0, 240.0])
@pytest.mark.parametrize("n_more", range(5))
def test_the_views_of_a_fast_clip_are_thinned_and_reach_as_far_back(fps, n_more):
    history = timed_history(fps, int(2 * fps) + n_more)
    assert len(history.frame) == 20
    assert 0.61 < -history.since_s[0] < 0.75
    assert np.diff(history.frame[-6:]).tolist() == [1] * 5
    assert np.diff(history.t_s).max() < 0.085
    np.testing.assert_allclose(history.t_s, history.frame / fps)
    np.testing.assert_allclose(history.rays[:, 0, 1], history.frame / 1000)


def test_a_frame_without_points_is_survived():
    history = history_of([1, 2], [], [3])
    assert history.track_id.tolist() == [3]
    assert history.n_frames.tolist() == [1]


def test_derotated_rays_of_far_points_are_where_they_are_now():
    motion = drive(6, np.random.default_rng(1), depth_m=(1e9, 2e9), turn_deg=(0.2, 1.5, -0.4))
    history = start()
    for frame in range(6):
        history = extended_by(history, motion, frame)
        if frame:
            history = with_egomotion(history, motion.cam_R_prev[frame], None, 1e-4)
    for index in range(6):
        np.testing.assert_allclose(history.derotated(index), motion.rays[-1], atol=1e-8)
        np.testing.assert_allclose(history.cam_R_past[index], motion.cam_R(5, index), atol=1e-12)


def test_scene_directions_are_noted_with_the_step_they_belong_to():
    motion = drive(4, np.random.default_rng(1))
    history = extended_by(start(), motion, 0)
    for frame, direction in ((1, FORWARD), (2, None), (3, np.array([1.0, 0, 0]))):
        history = with_egomotion(extended_by(history, motion, frame), np.eye(3), direction, 2e-5)
    np.testing.assert_array_equal(
        history.scene_direction, [np.full(3, np.nan), FORWARD, np.full(3, np.nan), [1.0, 0, 0]]
    )
    assert history.rotation_sigma_rad == 2e-5


def test_last_frame_only_forgets_the_past_and_keeps_the_tracks():
    history = last_frame_only(history_of([1, 2], [1, 2, 3], [1, 3]))
    assert history.frame.tolist() == [2]
    assert history.rays.shape == (1, 2, 3)
    assert history.cam_R_past.shape == (1, 3, 3)
    assert history.n_frames.tolist() == [3, 2]


def test_one_pixel_spans_less_towards_the_rim():
    """A small angle per pixel is cos^2 along the radius and cos across: its geometric mean is stated."""
    history = history_of([1])
    oblique = np.array([[np.sin(np.radians(40)), 0, np.cos(np.radians(40))]])
    points, _ = point_set(1)
    history = extended(history, 1, DT_S, points, oblique, 5)
    assert history.sigma_rad[0] == pytest.approx(0.2 / CAMERA.fx_px * np.cos(np.radians(40)) ** 1.5)


def motion_px(rng, motion):
    """Noise of a pixel across the rays of a view, (N, 3)."""
    rays = motion.rays[0]
    per_px = history_of([1]).camera.fx_px * 1.0
    return np.einsum("nij,nj->ni", tangent_basis(rays), rng.normal(size=(motion.n, 2))) * rays[:, 2:] ** 1.5 / per_px


def noisy_history(n_frames=25, sigma_px=0.1, noisy_px=0.5, spread=1.0, n_noisy=20, dt_s=None):
    """After so many frames of a drive, the first tracks of which are noisier than the others."""
    rng = np.random.default_rng(4)
    motion = drive(n_frames, rng, speed_m=0.3)
    noise_px = np.full(motion.n, sigma_px)
    noise_px[:n_noisy] = noisy_px
    history = start(sigma_px)
    for frame in range(n_frames):
        rays = motion.rays[frame] + noise_px[:, None] / FOCAL_PX * rng.normal(size=(motion.n, 3))
        t_s = frame * DT_S if dt_s is None else float(np.sum(dt_s[:frame]))
        history = extended(history, frame, t_s, motion.points(frame), rays, 11)
        if frame:
            history = with_egomotion(history, motion.cam_R_prev[frame], FORWARD, 0.0)
            history = with_noise(history, spread, FLOOR_PX)
    return history


def test_a_noisy_track_gets_a_larger_sigma():
    history = noisy_history()
    quiet, noisy = history.sigma_px[20:], history.sigma_px[:20]
    assert np.median(noisy) > 2.5 * np.median(quiet)
    assert noisy.min() > np.quantile(quiet, 0.95)
    assert np.median(quiet) == pytest.approx(0.1, rel=0.15)


def test_without_evidence_a_track_has_the_noise_of_all():
    history = noisy_history(n_frames=3)
    np.testing.assert_allclose(history.sigma_px, 0.1)


def test_motion_is_not_taken_for_noise():
    """Exact paths with a long flow: all tracks stay at the noise of all, within the spread of the estimate."""
    history = noisy_history(sigma_px=0.1, noisy_px=0.1)
    assert np.std(history.sigma_px) < 0.35 * 0.1
    assert history.sigma_px.max() < 2.0 * 0.1


def test_uneven_time_steps_say_nothing_of_one_tracks_noise():
    history = noisy_history(dt_s=np.tile([0.1, 0.2], 13))
    np.testing.assert_allclose(history.sigma_px, 0.1)


@pytest.mark.parametrize("spread", [0.5, 2.0])
def test_level_of_the_noise_follows_the_scenes_residuals(spread):
    """Residuals twice the assumed noise: twice the noise is soon assumed, and no more."""
    motion = drive(40, np.random.default_rng(5))
    history, true_px = start(0.2), 0.2 * spread
    for frame in range(40):
        history = extended_by(history, motion, frame)
        if frame:
            history = with_egomotion(history, np.eye(3), FORWARD, 0.0)
            history = with_noise(history, true_px / history.pool_sigma_px, FLOOR_PX)
    assert history.pool_sigma_px == pytest.approx(true_px, rel=0.01)


def test_before_a_slow_camera_noise_is_not_less_than_what_paths_are_rough_by():
    """A translation over more frames follows the noise of what shows none, as blobs of a plain sky do."""
    rng, history, true_px = np.random.default_rng(5), start(0.2), 0.3
    motion = drive(60, rng, speed_m=0.01)
    for frame in range(60):
        rays = normalize(motion.rays[frame] + true_px * motion_px(rng, motion))
        history = extended(history, frame, frame * DT_S, motion.points(frame), rays, 11)
        if frame:
            history = with_egomotion(history, np.eye(3), FORWARD, 0.0)
            history = with_noise(history, 0.2, FLOOR_PX, is_slow=True)
    assert history.pool_sigma_px == pytest.approx(true_px, rel=0.1)


def test_noise_never_falls_below_its_floor_and_stays_without_residuals():
    motion = drive(30, np.random.default_rng(6))
    history = start(0.2)
    for frame in range(30):
        history = with_noise(extended_by(history, motion, frame), 0.1, FLOOR_PX)
    assert history.pool_sigma_px == FLOOR_PX
    assert (history.sigma_px >= FLOOR_PX).all()
    unknown = with_noise(extended_by(start(0.2), motion, 0), None, FLOOR_PX)
    assert unknown.pool_sigma_px == 0.2


@pytest.mark.parametrize("background_px", [0.0, 0.005])
@pytest.mark.parametrize("mover_px", [0.1, 0.2])
def test_before_a_background_without_noise_what_moves_has_its_own_noise_and_no_more(background_px, mover_px):
    """Rendered or denoised pictures, and blocks that a codec skips, which do not move at all."""
    rng, n, history = np.random.default_rng(9), 120, start(0.1)
    sigma_px = np.where(np.arange(n) < 30, mover_px, background_px)
    places = np.column_stack([rng.uniform(-0.8, 0.8, n), rng.uniform(-0.2, 0.2, n)])
    for frame in range(25):
        xy = places + sigma_px[:, None] / FOCAL_PX * rng.normal(size=(n, 2))
        xy[:30, 0] += 0.003 * frame
        rays = normalize(np.column_stack([xy, np.ones(n)]))
        xy_px = xy * FOCAL_PX + [CAMERA.cx_px, CAMERA.cy_px]
        history = extended(history, frame, frame * DT_S, PointSet(np.arange(n), xy_px), rays, 11)
        if frame:
            history = with_noise(with_egomotion(history, np.eye(3), None, 0.0), 0.1, FLOOR_PX)
    assert np.median(history.sigma_px[:30]) == pytest.approx(mover_px, rel=0.25)
    np.testing.assert_allclose(history.sigma_px[30:], FLOOR_PX)


def test_new_tracks_start_with_the_noise_of_all_tracks():
    history = noisy_history(spread=1.05)
    points = history.track_id.max() + 1
    rays = np.concatenate([history.rays[-1], [[0.0, 0.0, 1.0]]])
    grown = PointSet(np.append(history.track_id, points), np.concatenate([history.xy_px, [[600.0, 180.0]]]))
    later = extended(history, 99, 9.9, grown, rays, 11)
    assert later.sigma_px[-1] == history.pool_sigma_px
    np.testing.assert_array_equal(later.sigma_px[:-1], history.sigma_px)


LENSES = {
    "none": ("none", (), 40.0),
    "plumb_bob": ("plumb_bob", (-0.28, 0.09, 0.001, -0.0005, -0.01), 38.0),
    "fisheye, middle": ("fisheye", (0.0, 0.0, 0.0, 0.0), 30.0),
    "fisheye, far": ("fisheye", (0.02, -0.01, 0.0, 0.0), 70.0),
}


@pytest.mark.parametrize(("model", "coefficients", "off_deg"), LENSES.values(), ids=LENSES)
def test_noise_of_a_ray_is_what_noise_of_the_pixel_makes_of_it_through_the_lens(model, coefficients, off_deg):
    rng, n, sigma_px = np.random.default_rng(7), 20000, 0.2
    lens = Camera(500.0, 500.0, 639.5, 479.5, ImageSize(1280, 960), model, coefficients)
    off, turn = np.radians(off_deg), 0.7
    true_ray = np.array([np.sin(off) * np.cos(turn), np.sin(off) * np.sin(turn), np.cos(off)])
    xy_px = pixels_from_rays(lens, true_ray[None]) + sigma_px * rng.normal(size=(n, 2))
    plane = rays_from_pixels(lens, xy_px)
    rays = normalize(plane)
    history = extended(empty_history(lens, sigma_px), 0, 0.0, PointSet(np.arange(n), xy_px), rays, 20)
    # One number stands for the noise along the radius and across: the root of what both span.
    scattered_norm = np.linalg.det(np.cov(plane[:, :2], rowvar=False)) ** 0.25
    assert np.median(history.sigma_norm) == pytest.approx(scattered_norm, rel=0.05)
    scattered_rad = np.linalg.det(np.cov(rays @ tangent_basis(true_ray), rowvar=False)) ** 0.25
    assert np.median(history.sigma_rad) == pytest.approx(scattered_rad, rel=0.05)


def test_how_rough_a_track_is_does_not_depend_on_where_a_fisheye_lens_shows_it():
    rng = np.random.default_rng(8)
    lens = Camera(500.0, 500.0, 639.5, 479.5, ImageSize(1280, 960), "fisheye", (0.0, 0.0, 0.0, 0.0))
    off = np.repeat(np.radians([5.0, 65.0]), 300)
    turn = rng.uniform(0.0, 2.0 * np.pi, 600)
    true_rays = np.column_stack([np.sin(off) * np.cos(turn), np.sin(off) * np.sin(turn), np.cos(off)])
    true_px = pixels_from_rays(lens, true_rays)
    history = empty_history(lens, 0.2)
    for frame in range(12):
        xy_px = true_px + 0.2 * rng.normal(size=true_px.shape)
        points = PointSet(np.arange(600), xy_px)
        history = extended(history, frame, 0.1 * frame, points, normalize(rays_from_pixels(lens, xy_px)), 20)
        history = with_noise(with_egomotion(history, np.eye(3), None, 0.0) if frame else history, 1.0, 0.01)
    near, far = np.median(history.sigma_px[:300]), np.median(history.sigma_px[300:])
    # Radius and across are taken as one, which is off by this much where they differ by a factor of three.
    assert far == pytest.approx(near, rel=0.25)
