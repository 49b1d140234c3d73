"""The rows of a frame: every track with its time or its reason, every cluster in order."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import CAMERA, box_of_points, history_of, pixels, unit

from ttcvid.config import CollisionTimesConfig
from ttcvid.model import NO_CLUSTER, MotionState, Platform, Status
from ttcvid.stages.analyzed_frames import without_remnants
from ttcvid.stages.objects.clusters import ClusterMotion
from ttcvid.stages.objects.motions import FrameMotions
from ttcvid.stages.rows import cluster_rows, no_tracks, track_rows

STATIC, CAR, LOOSE = 40, 25, 3
OWN, CAR_V, LOOSE_V = np.array([0.0, 0.0, -8.0]), np.array([3.0, 0.3, -6.0]), np.array([0.0, 4.0, -1.0])
TWO_FRAME, THREE_FRAME, MULTI_FRAME = (
    CollisionTimesConfig(estimator=name) for name in ("two-frame", "three-frame", "multi-frame")
)


@pytest.fixture
def frame():
    """History, motions and true places of a scene, a car on collision course and three tracks of no cluster."""
    rng = np.random.default_rng(101)
    side = rng.choice([-1.0, 1.0], STATIC)
    static = np.column_stack(
        [side * rng.uniform(3, 8, STATIC), rng.uniform(-2, 2, STATIC), rng.uniform(15, 40, STATIC)]
    )
    car = box_of_points(rng, CAR, (-5.0, 0.5, 15.0), (2.0, 1.2, 0.0))
    loose = box_of_points(rng, LOOSE, (2.0, -3.0, 25.0), (1.0, 0.5, 1.0))
    position_m = np.concatenate([static, car, loose])
    velocity = np.repeat([OWN, CAR_V, LOOSE_V], [STATIC, CAR, LOOSE], axis=0)
    history = history_of(position_m, velocity, 0.05 * np.arange(9))
    history = replace(history, scene_direction=np.tile(unit(OWN), (9, 1)))
    cluster = np.repeat([0, 4, NO_CLUSTER], [STATIC, CAR, LOOSE])
    return history, motions_of(history, cluster), position_m, velocity


def motions_of(history, cluster, known=(True, True)):
    status = np.full(history.n_tracks, Status.no_epipole, dtype=np.int64)
    clusters = []
    for number, velocity, is_known in zip((0, 4), (OWN, CAR_V), known, strict=True):
        members, e = np.flatnonzero(cluster == number), unit(velocity)
        status[members] = Status.ok if is_known else Status.no_parallax
        e_cov = 1e-10 * (np.eye(3) - np.outer(e, e)) if is_known else None
        clusters.append(
            ClusterMotion(number, members, e if is_known else None, e_cov, Status(status[members[0]]), "consensus")
        )
    return FrameMotions(cluster, status, tuple(clusters), 32.0, np.ones(len(cluster), dtype=bool))


@pytest.mark.parametrize(
    "config", [TWO_FRAME, THREE_FRAME, MULTI_FRAME], ids=["two-frame", "three-frame", "multi-frame"]
)
def test_every_track_of_a_cluster_has_its_exact_times(frame, config):
    history, motions, position_m, velocity = frame
    _, rows = track_rows(history, motions, config)
    chosen = np.arange(STATIC + CAR)
    assert (rows.status[chosen] == Status.ok).all()
    speed2 = np.einsum("ni,ni->n", velocity, velocity)
    tcpa_s = -np.einsum("ni,ni->n", position_m, velocity) / speed2
    miss_s = np.linalg.norm(np.cross(position_m, velocity), axis=1) / speed2
    np.testing.assert_allclose(rows.times.tcpa_s[chosen], tcpa_s[chosen], rtol=1e-6)
    np.testing.assert_allclose(rows.times.miss_s[chosen], miss_s[chosen], rtol=1e-6)
    np.testing.assert_allclose(rows.times.ttc_z_s[chosen], (-position_m[:, 2] / velocity[:, 2])[chosen], rtol=1e-6)
    cosine = -np.einsum("ni,ni->n", unit(position_m), unit(velocity))
    np.testing.assert_allclose(rows.alpha_rad[chosen], np.arccos(cosine)[chosen], atol=1e-6)


def test_tracks_without_an_epipole_have_a_reason_and_no_time(frame):
    history, motions, *_ = frame
    _, rows = track_rows(history, motions, TWO_FRAME)
    loose = slice(STATIC + CAR, None)
    assert (rows.status[loose] == Status.no_epipole).all()
    assert np.isnan(rows.times.tcpa_s[loose]).all()
    assert (rows.cluster_id[loose] == NO_CLUSTER).all()


@pytest.mark.parametrize("config", [THREE_FRAME, MULTI_FRAME], ids=["three-frame", "multi-frame"])
def test_tracks_of_no_cluster_have_times_of_their_own(frame, config):
    history, motions, position_m, velocity = frame
    _, rows = track_rows(history, motions, config)
    loose = slice(STATIC + CAR, None)
    tcpa_s = -np.einsum("ni,ni->n", position_m, velocity) / np.einsum("ni,ni->n", velocity, velocity)
    np.testing.assert_allclose(rows.times.tcpa_s[loose], tcpa_s[loose], rtol=1e-5)


def test_no_result_is_a_nan_beside_a_reason_and_a_result_is_never_one(frame):
    history, motions, *_ = frame
    for config in (TWO_FRAME, THREE_FRAME, MULTI_FRAME):
        states, rows = track_rows(history, motions, config)
        np.testing.assert_array_equal(np.isfinite(rows.times.tcpa_s), states.has_value)
        assert len({len(v) for v in (rows.track_id, rows.cluster_id, rows.xy_px, rows.n_frames, rows.status)}) == 1
        np.testing.assert_array_equal(rows.n_frames, 9)


def test_a_track_at_the_epipole_of_its_group_takes_the_time_of_its_surroundings():
    """A car that comes straight at us: its middle keeps its bearing."""
    rng = np.random.default_rng(102)
    position_m = np.concatenate([[[0.0, 0.0, 15.0]], box_of_points(rng, 24, (0.0, 0.0, 15.0), (1.6, 1.0, 0.0))])
    velocity = np.array([0.0, 0.0, -6.0])
    history = history_of(position_m, velocity, 0.05 * np.arange(9))
    e = unit(velocity)
    cov = 1e-8 * np.diag([1.0, 1.0, 0.0])
    n, car = len(position_m), ClusterMotion(1, np.arange(25), e, cov, Status.ok, "consensus")
    ok = np.zeros(n, np.int64)
    motions = FrameMotions(np.ones(n, np.int64), ok, (car,), 60.0, np.ones(n, dtype=bool))
    _, rows = track_rows(history, motions, TWO_FRAME)
    assert rows.status[0] == Status.ok
    assert rows.times.ttc_z_s[0] == pytest.approx(2.5, rel=1e-6)
    alone = replace(motions, cluster_id=np.full(n, NO_CLUSTER))
    _, rows = track_rows(history, alone, TWO_FRAME)
    assert rows.status[0] == Status.at_epipole


def test_the_scene_comes_first_and_objects_have_times_motion_and_rank(frame):
    history, motions, position_m, _ = frame
    states, _ = track_rows(history, motions, TWO_FRAME)
    (scene, car), _ = cluster_rows(history, motions, states, CAMERA, {})
    assert (scene.cluster_id, scene.role, scene.n_tracks, scene.urgency_rank) == (0, "scene", STATIC, None)
    assert np.isnan(scene.times.ttc_z_s[0])
    assert (car.cluster_id, car.role, car.n_tracks, car.urgency_rank) == (4, "object", CAR, 1)
    assert (scene.motion_id, car.motion_id) == (0, 1)
    assert car.motion_state == MotionState.approaching
    assert car.times.ttc_z_s[0] == pytest.approx(2.5, rel=1e-6)
    assert car.expansion_hz == pytest.approx(1.0 / 2.5, rel=1e-6)
    xy_px = pixels(position_m[STATIC : STATIC + CAR])
    np.testing.assert_allclose(car.box_px, [*xy_px.min(axis=0), *xy_px.max(axis=0)])


def test_the_pixel_of_a_point_without_a_ray_has_no_part_in_the_size_of_its_object(frame):
    history, motions, *_ = frame
    unseen = np.arange(STATIC, STATIC + CAR // 2)
    rays, far_px = history.rays.copy(), history.xy_px.copy()
    rays[-1, unseen], far_px[unseen] = np.nan, far_px[unseen] + 2000.0 * np.arange(len(unseen))[:, None]
    history = replace(history, rays=rays, common_error_px=0.3)
    states, _ = track_rows(history, motions, TWO_FRAME)
    both = history, replace(history, xy_px=far_px)
    near, far = (cluster_rows(one, motions, states, CAMERA, {})[0][1] for one in both)
    np.testing.assert_array_equal(near.state_cov, far.state_cov)


def test_who_moved_otherwise_a_moment_ago_is_less_sure_in_all_that_the_row_says(frame):
    history, motions, *_ = frame
    states, _ = track_rows(history, motions, MULTI_FRAME)
    (_, sure), past = cluster_rows(history, motions, states, CAMERA, {})
    (now,) = past[4]
    before = replace(now, t_s=float(history.t_s[2]), abc_hz=0.95 * now.abc_hz)
    (_, unsure), past = cluster_rows(history, motions, states, CAMERA, {4: (before,)})
    assert unsure.state_cov[2, 2] > 4.0 * sure.state_cov[2, 2]
    assert unsure.direction_cov[0, 0] > 4.0 * sure.direction_cov[0, 0]
    assert unsure.times.ttc_z_lo_s[0] < sure.times.ttc_z_lo_s[0] < sure.times.ttc_z_hi_s[0] < unsure.times.ttc_z_hi_s[0]
    assert [one.t_s for one in past[4]] == [history.t_s[2], history.t_s[-1]]


def test_objects_are_seen_where_the_camera_rests(frame):
    history, _, position_m, velocity = frame
    cluster = np.repeat([0, 4, NO_CLUSTER], [STATIC, CAR, LOOSE])
    resting = np.where((cluster == 0)[:, None], 0.0, velocity)
    history = history_of(position_m, resting, history.t_s)
    motions = motions_of(history, cluster, known=(False, True))
    states, rows = track_rows(history, motions, TWO_FRAME)
    assert (rows.status[:STATIC] == Status.no_parallax).all()
    (scene, car), _ = cluster_rows(history, motions, states, CAMERA, {})
    assert scene.motion_state == MotionState.no_relative_motion
    assert scene.epipole_px is None
    assert car.times.ttc_z_s[0] == pytest.approx(2.5, rel=1e-6)


def test_a_frame_without_tracks_has_empty_rows():
    rows = no_tracks()
    assert len(rows.track_id) == len(rows.times.tcpa_s) == len(rows.status) == 0
    assert rows.xy_px.shape == (0, 2)


def row_of_a_thing_straight_ahead(seed, size_m, distance_m, time_s, sigma_px):
    """The row of a thing that heads for us, flat, with 14 tracks."""
    rng, n = np.random.default_rng(seed), 14
    position_m = box_of_points(rng, n, (0.3, 0.0, distance_m), (*size_m, 0.0))
    e = unit([-0.3, 0.0, -distance_m])
    history = history_of(position_m, distance_m / time_s * e, 0.05 * np.arange(15), sigma_px=sigma_px, rng=rng)
    thing = ClusterMotion(1, np.arange(n), e, 1e-3 * (np.eye(3) - np.outer(e, e)), Status.ok, "whole-tracks")
    motions = FrameMotions(np.ones(n, np.int64), np.zeros(n, np.int64), (thing,), 60.0, np.ones(n, dtype=bool))
    states, _ = track_rows(history, motions, MULTI_FRAME)
    (row,), _ = cluster_rows(history, motions, states, CAMERA, {})
    return row


@pytest.mark.parametrize(
    ("size_m", "distance_m", "time_s", "sigma_px"),
    [((0.5, 1.6), 40.0, 4.0, 0.2), ((0.5, 1.6), 40.0, 4.0, 0.5), ((1.7, 1.2), 50.0, 7.0, 0.5)],
    ids=["walker", "walker, noisy", "car, noisy and far"],
)
def test_what_heads_for_us_has_times_that_are_neither_too_short_nor_too_sure(size_m, distance_m, time_s, sigma_px):
    """A turn of a third of a degree per second moves its epipole by more than it is high; it hardly changes its growth.

    Of its tracks none may be surely nearing by itself, and those that seem to are those that noise has brought nearer.
    """
    rows = [row_of_a_thing_straight_ahead(seed, size_m, distance_m, time_s, sigma_px) for seed in range(40)]
    rows = [row for row in rows if row.status == Status.ok]
    assert len(rows) >= 34
    latest_hz, soonest_hz = (
        1.0 / np.array([getattr(row.times, f"ttc_z_{end}_s")[0] for row in rows]) for end in ("hi", "lo")
    )
    assert np.mean((latest_hz < 1.0 / time_s) & (soonest_hz > 1.0 / time_s)) >= 0.75
    assert np.median([time_s / row.times.ttc_z_s[0] for row in rows]) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize(
    ("n_tracks", "has_state", "platform", "is_told"),
    [
        (4, False, Platform.vehicle, False),
        (5, False, Platform.vehicle, True),
        (4, True, Platform.vehicle, True),
        (4, False, Platform.static, True),
    ],
)
def test_what_is_left_of_an_object_is_none(frame, n_tracks, has_state, platform, is_told):
    """Without times, and with fewer tracks than a surface needs."""
    history, motions, *_ = frame
    states, tracks = track_rows(history, motions, MULTI_FRAME)
    (scene, car), _ = cluster_rows(history, motions, states, CAMERA, {})
    car = car.changed(n_tracks=n_tracks, state_abc_hz=car.state_abc_hz if has_state else None)
    told, clusters = without_remnants(tracks, (scene, car), platform)
    assert clusters == ((scene, car) if is_told else (scene,))
    expected = tracks.cluster_id if is_told else np.where(tracks.cluster_id == 4, NO_CLUSTER, tracks.cluster_id)
    np.testing.assert_array_equal(told.cluster_id, expected)
