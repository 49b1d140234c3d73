"""A frame seen once more with views after it: where its tracks were and will be, and what their motion then is."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import CAMERA, EXACT_SIGMA_PX, box_of_points, pixels, unit

from ttcvid.config import CollisionTimesConfig, EgomotionConfig, PipelineConfig
from ttcvid.geometry.rotation import normalize, rotation_from_vector
from ttcvid.model import NO_CLUSTER, Platform, PointSet, Status
from ttcvid.stages.egomotion.relative_pose import Egomotion
from ttcvid.stages.objects.clusters import ClusterMotion
from ttcvid.stages.objects.motions import FrameMotions
from ttcvid.stages.objects.track_states import multi_frame_states
from ttcvid.stages.smoothing import Seen, are_enough, seen_again
from ttcvid.stages.tracking.history import empty_history, extended, with_egomotion

DT_S, N_FRAMES, MAX_FRAMES = 0.1, 25, 20
NOW, AFTER = 14, 9
TURN = rotation_from_vector(np.radians([0.1, 0.4, -0.2]))
CONFIG = CollisionTimesConfig(max_frames=MAX_FRAMES, object_window_s=5.0)
PIPELINE = PipelineConfig(collision_times=CONFIG, egomotion=EgomotionConfig(platform=Platform.vehicle))
VELOCITY = np.array([-1.0, 0.1, -5.0])


def histories(
    position_m, braking_m_s2=0.0, sigma_px=EXACT_SIGMA_PX, rng=None, n_alive=None, step_s=DT_S, n_frames=N_FRAMES
):
    """History of every frame, of points at `position_m` in frame NOW that move by VELOCITY there and slow down.

    The camera turns by TURN in every step, known exactly; from frame NOW + 3 on only the first `n_alive` points are
    still seen.
    """
    history, found = empty_history(CAMERA, sigma_px), []
    cam_R_now = [np.linalg.matrix_power(TURN, frame - NOW) for frame in range(n_frames)]
    for frame in range(n_frames):
        since_s = (frame - NOW) * step_s
        moved = VELOCITY * since_s - 0.5 * braking_m_s2 * unit(VELOCITY) * since_s**2
        point = ((position_m + moved) @ cam_R_now[frame].T)[: n_alive if frame >= NOW + 3 else None]
        xy_px = pixels(point)
        if rng is not None:
            xy_px = xy_px + sigma_px * rng.normal(size=xy_px.shape)
        rays = (xy_px - (CAMERA.cx_px, CAMERA.cy_px)) / CAMERA.fx_px
        rays = normalize(np.column_stack([rays, np.ones(len(rays))]))
        points = PointSet(np.arange(len(point)), xy_px)
        history = extended(history, frame, frame * step_s, points, rays, MAX_FRAMES)
        if frame:
            history = with_egomotion(history, TURN, None, 1e-6)
        found.append(history)
    return found


def seen(history, cluster_id=None):
    """All tracks are one object, or each is in the cluster given; objects with about the direction that they have."""
    n = history.n_tracks
    turned = rotation_from_vector(np.radians([[0.0, 2.0, 0.0]]))[0]
    way = turned @ np.linalg.matrix_power(TURN, int(history.frame[-1]) - NOW) @ unit(VELOCITY)
    cov = np.radians(2.0) ** 2 * (np.eye(3) - np.outer(way, way))
    cluster_id = np.ones(n, np.int64) if cluster_id is None else np.array(cluster_id)[:n]
    numbers = np.unique(cluster_id[cluster_id != NO_CLUSTER]).tolist()
    motions = FrameMotions(
        cluster_id=cluster_id,
        no_direction_status=np.full(n, Status.no_epipole),
        clusters=tuple(
            ClusterMotion(k, np.flatnonzero(cluster_id == k), way, cov, Status.ok, "whole-tracks")
            if k
            else ClusterMotion(k, np.flatnonzero(cluster_id == k), None, None, Status.no_epipole, "-")
            for k in numbers
        ),
        link_px=32.0,
        is_free=np.ones(n, bool),
    )
    egomotion = Egomotion(TURN, 1e-12 * np.eye(3), None, None, np.zeros(n))
    return Seen(history, egomotion, motions, None)


def smoothed(found, now=NOW, after=AFTER):
    return again(seen(found[now]), found, now, after)


def again(item, found, now=NOW, after=AFTER):
    return seen_again(item, [seen(history) for history in found[now + 1 : now + 1 + after]], CAMERA, PIPELINE)


def rates_of(item):
    """1 / ttc_z of the points, and their status."""
    states = multi_frame_states(item.history, item.motions, None, CONFIG)
    return -states.abc_hz[:, 2], states.status


def car(n=40):
    return box_of_points(np.random.default_rng(2), n, (2.0, 0.5, 16.0), (2.0, 1.5, 0.8))


def test_views_lie_where_a_camera_that_stands_still_would_have_seen_the_points():
    position = car()
    history = smoothed(histories(position)).history
    assert history.frame.tolist() == list(range(NOW + AFTER - MAX_FRAMES + 1, NOW + AFTER + 1))
    np.testing.assert_allclose(history.since_s, (history.frame - NOW) * DT_S, atol=1e-12)
    place = position + VELOCITY * history.since_s[:, None, None]
    np.testing.assert_allclose(history.xy, place[..., :2] / place[..., 2:], atol=1e-9)
    assert history.n_past == 14 - 4
    np.testing.assert_array_equal(history.xy_px, pixels(position))


def test_a_track_that_ends_has_its_views_up_to_there():
    history = smoothed(histories(car(), n_alive=25)).history
    later = np.isfinite(history.rays[history.n_past + 1 :, :, 0])
    assert later[:, :25].all()
    assert later[:2, 25:].all()
    assert not later[2:, 25:].any()


def test_the_path_of_the_scene_goes_on_behind_the_present_frame():
    found = histories(car())
    forward = np.array([0.0, 0.0, -1.0])
    noted = [replace(history, scene_direction=np.tile(forward, (len(history.frame), 1))) for history in found]
    history = smoothed(noted).history
    steps = history.scene_steps
    np.testing.assert_allclose(steps[history.now], 0.0)
    after = DT_S * (TURN.T @ forward)
    np.testing.assert_allclose(steps[history.now + 1], after, atol=1e-12)
    np.testing.assert_allclose(steps[history.now - 1], -DT_S * forward, atol=1e-12)


@pytest.mark.parametrize("braking_m_s2", [0.0, 2.0, 4.0])
def test_without_noise_the_rate_is_that_of_the_frame_also_where_the_velocity_changes(braking_m_s2):
    position = car()
    eta_hz, status = rates_of(smoothed(histories(position, braking_m_s2, 0.05)))
    assert (status == Status.ok).all()
    np.testing.assert_allclose(eta_hz, 5.0 / position[:, 2], rtol=2e-3)


def test_braking_makes_past_views_lag_and_not_views_on_both_sides():
    """Few points in noise cannot tell an acceleration: past views give the rate of half a window ago."""
    position, rng = car(8), np.random.default_rng(3)
    late, smooth = [], []
    for _ in range(20):
        found = histories(position, 2.0, 0.5, rng)
        late.append(rates_of(seen(found[NOW]))[0] * position[:, 2] / 5.0)
        smooth.append(rates_of(smoothed(found))[0] * position[:, 2] / 5.0)
    assert np.nanmedian(late) > 1.02
    assert np.nanmedian(smooth) == pytest.approx(1.0, abs=0.015)


def test_at_constant_velocity_intervals_hold_and_are_narrower():
    position, rng = car(12), np.random.default_rng(5)
    off, ratio = [], []
    for _ in range(200):
        found = histories(position, 0.0, 0.2, rng)
        states, past = (
            multi_frame_states(item.history, item.motions, None, CONFIG) for item in (smoothed(found), seen(found[NOW]))
        )
        sigma_hz = np.sqrt(states.cov[:, 2, 2])
        off.append((-states.abc_hz[:, 2] - 5.0 / position[:, 2]) / sigma_hz)
        ratio.append(sigma_hz / np.sqrt(past.cov[:, 2, 2]))
    # An object's own intervals also allow for velocities that do not last.
    assert np.mean(np.abs(off) < 1.645) >= 0.87
    assert np.nanmedian(ratio) < 0.9


def test_intervals_of_single_tracks_hold_as_often_as_they_say():
    position, rng, off = car(60), np.random.default_rng(6), []
    alone = np.full(len(position), NO_CLUSTER)
    for _ in range(15):
        found = histories(position, 0.0, 0.2, rng)
        item = seen_again(
            seen(found[NOW], alone), [seen(h, alone) for h in found[NOW + 1 : NOW + 10]], CAMERA, PIPELINE
        )
        states = multi_frame_states(item.history, item.motions, None, CONFIG)
        off.append((-states.abc_hz[:, 2] - 5.0 / position[:, 2]) / np.sqrt(states.cov[:, 2, 2]))
    assert 0.87 <= np.mean(np.abs(off) < 1.645) <= 0.93


def test_tracks_of_no_cluster_have_their_free_state_from_both_sides():
    position = car()
    found, alone = histories(position), np.full(len(position), NO_CLUSTER)
    later = [seen(history, alone) for history in found[NOW + 1 : NOW + 1 + AFTER]]
    item = seen_again(seen(found[NOW], alone), later, CAMERA, PIPELINE)
    states = multi_frame_states(item.history, item.motions, None, CONFIG)
    assert (states.status == Status.ok).all()
    np.testing.assert_allclose(states.abc_hz, VELOCITY / position[:, 2:], rtol=1e-4, atol=1e-5)


def swinging(found, rng=None):
    """The same histories with the directions of steps of a camera that swings, noisy with `rng`; those directions."""
    angle = 0.1 * np.sin(0.25 * np.arange(N_FRAMES))
    true_dir = -np.column_stack([np.sin(angle), np.zeros(N_FRAMES), np.cos(angle)])
    cam_R_world = [np.linalg.matrix_power(TURN, frame) for frame in range(N_FRAMES)]
    own = np.array([turn @ e for turn, e in zip(cam_R_world, true_dir, strict=True)])
    noted = own if rng is None else normalize(own + 2e-3 * rng.normal(size=own.shape))
    return [replace(history, scene_direction=noted[history.frame]) for history in found], own, noted


def own_direction(found, noted, now=NOW):
    item = seen(found[now])
    egomotion = replace(item.egomotion, direction=noted[now], direction_cov=1e-6 * np.eye(3))
    scene = ClusterMotion(0, np.arange(item.history.n_tracks), noted[now], np.eye(3), Status.ok, "egomotion")
    motions = replace(item.motions, clusters=(scene,), cluster_id=np.zeros(item.history.n_tracks, np.int64))
    item = replace(item, egomotion=egomotion, motions=motions)
    later = [seen(history, np.zeros(history.n_tracks, np.int64)) for history in found[now + 1 : now + 1 + AFTER]]
    return seen_again(item, later, CAMERA, PIPELINE).motions.clusters[0].direction


def test_own_direction_is_that_of_the_steps_around_and_follows_their_swing():
    bare = histories(car(20))
    found, own, noted = swinging(bare)
    np.testing.assert_allclose(own_direction(found, noted), own[NOW], atol=1e-3)
    rng, errors = np.random.default_rng(9), []
    for _ in range(40):
        found, own, noted = swinging(bare, rng)
        errors.append([np.linalg.norm(e - own[NOW]) for e in (own_direction(found, noted), noted[NOW])])
    smooth, causal = np.sqrt(np.mean(np.square(errors), axis=0))
    assert smooth < 0.65 * causal


def test_tracks_are_in_an_object_as_soon_as_the_next_frames_will_have_them_there():
    """Tracks 0-9 are found as object 7 two frames later, 10 is its own from the first, 11-13 are too few for one."""
    found = histories(car(20))
    now = np.array([0] * 10 + [3] + [0] * 9)
    then = np.array([7] * 10 + [7] + [8] * 3 + [0] * 5 + [NO_CLUSTER])
    later = [seen(found[NOW + 1], now)] + [seen(history, then) for history in found[NOW + 2 : NOW + 1 + AFTER]]
    item = seen_again(seen(found[NOW], now), later, CAMERA, PIPELINE)
    np.testing.assert_array_equal(item.motions.cluster_id, [7] * 10 + [3] + [0] * 9)
    assert [(m.cluster_id, m.members.tolist()) for m in item.motions.clusters] == [
        (0, list(range(11, 20))),
        (3, [10]),
        (7, list(range(10))),
    ]
    np.testing.assert_allclose(item.motions.clusters[2].direction, unit(VELOCITY), atol=1e-3)


def test_views_on_both_sides_tell_a_direction_that_the_frame_did_not_know():
    found = histories(car(20))
    item = seen(found[NOW])
    unknown = replace(item.motions.clusters[0], direction=None, direction_cov=None, status=Status.no_parallax)
    item = replace(item, motions=replace(item.motions, clusters=(unknown,)))
    (motion,) = again(item, found).motions.clusters
    assert motion.status == Status.ok
    np.testing.assert_allclose(motion.direction, unit(VELOCITY), atol=1e-3)


def test_an_object_that_is_gone_before_the_last_frame_is_not_there_earlier():
    found = histories(car(20))
    now, then = np.zeros(20, np.int64), np.array([7] * 10 + [8] * 10)
    histories_after = found[NOW + 1 : NOW + 1 + AFTER]
    later = [seen(one, then if k < 5 else [7] * 10 + [0] * 10) for k, one in enumerate(histories_after)]
    item = seen_again(seen(found[NOW], now), later, CAMERA, PIPELINE)
    np.testing.assert_array_equal(item.motions.cluster_id, [7] * 10 + [0] * 10)


def test_what_is_frozen_to_its_pixel_joins_no_object():
    found = histories(car(20))
    item = seen(found[NOW], np.zeros(20, np.int64))
    item = replace(item, motions=replace(item.motions, is_free=np.arange(20) >= 10))
    assert again(item, found).motions.cluster_id.tolist() == [0] * 10 + [1] * 10


def test_without_later_views_or_own_motion_nothing_is_estimated_again():
    found = histories(car())
    item = seen(found[NOW])
    assert again(item, found, after=0) is item
    lost = replace(item, egomotion=None)
    assert again(lost, found) is lost


def test_a_frame_is_not_continued_by_what_has_forgotten_it():
    found = histories(car())
    assert seen(found[NOW]).is_continued_by(found[NOW + 9])
    assert not seen(found[3]).is_continued_by(found[NOW + 9])
    fresh = replace(found[NOW + 1], frame=found[NOW + 1].frame[-1:])
    assert not seen(found[NOW]).is_continued_by(fresh)


def test_a_frame_waits_for_half_of_a_window():
    def waits_for(step_s, max_frames=20):
        return next(n for n in range(99) if are_enough(n, n * step_s, max_frames))

    assert (waits_for(0.2), waits_for(1 / 30), waits_for(1 / 30, 3)) == (10, 10, 1)
    assert waits_for(1 / 120) / 120 == pytest.approx(10 / 30, abs=0.02)


def test_views_on_both_sides_of_a_frame_that_was_thinned_out_lie_where_they_were():
    position, step_s, n_frames = car(), 1 / 120, 200
    found = histories(position, step_s=step_s, n_frames=n_frames)
    for now in (NOW + 100, NOW + 101, NOW + 102, NOW + 103):
        history = smoothed(found, now, 40).history
        assert history.frame[history.n_past] == now
        assert history.since_s[0] < -0.2
        assert history.since_s[-1] == pytest.approx(40 * step_s)
        place = position + VELOCITY * (history.since_s + (now - NOW) * step_s)[:, None, None]
        there = np.linalg.matrix_power(TURN, now - NOW)
        place = place @ there.T
        np.testing.assert_allclose(history.xy, place[..., :2] / place[..., 2:], atol=1e-9)
