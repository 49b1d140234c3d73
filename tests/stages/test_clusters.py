"""One row a cluster: its place, its state with an honest covariance, how it moves and how urgent it is."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX, box_of_points, direction_noise, flows_of, pixels, unit

from ttcvid.geometry.paper.expansion import expansion_rate
from ttcvid.model import ClusterRow, MotionState, Status
from ttcvid.stages.objects.clusters import (
    ON_HORIZON,
    ClusterMotion,
    epipole_pixels,
    motion_ids,
    ranked,
    rows_of,
    surfaces_of,
    with_epipole_pixels,
    with_times,
)
from ttcvid.stages.objects.paper_track_states import two_frame_states
from ttcvid.stages.tracking.groups import TrackSets

LINK_PX = 32.0
PLATE_M = (2.5, 1.2, 0.0)


def motion_of(cluster_id, direction, sigma_rad=1e-3, n=10, status=Status.ok):
    direction = None if direction is None else unit(direction)
    cov = None if direction is None else sigma_rad**2 * (np.eye(3) - np.outer(direction, direction))
    return ClusterMotion(cluster_id, np.arange(n), direction, cov, status, "consensus")


def row_of(position_m, velocity_m_s, sigma_px=0.05, direction=None, cov=None, rng=None, cluster_id=1, n_others=0):
    """Row of an object whose tracks come after those of `n_others` others."""
    n = len(position_m)
    direction = unit(velocity_m_s) if direction is None else direction
    cov = 1e-12 * np.eye(3) if cov is None else cov
    away = np.tile([[0.0, -5.0, 30.0]], (n_others, 1))
    position_m = np.concatenate([away, position_m])
    flows = flows_of(position_m, np.asarray(velocity_m_s, float), sigma_px=sigma_px, rng=rng)
    states = two_frame_states(flows, np.tile(direction, (n + n_others, 1)), np.tile(cov, (n + n_others, 1, 1)))
    motion = ClusterMotion(cluster_id, n_others + np.arange(n), direction, cov, Status.ok, "consensus")
    expansion_hz, _ = expansion_rate(flows.first[motion.members], flows.second[motion.members], 0.4)
    return only_row(motion, states, pixels(position_m), float(expansion_hz))


def only_row(motion, states, xy_px, expansion_hz=np.nan):
    """Row of one cluster by itself."""
    members = TrackSets.of([motion.members])
    joint = surfaces_of([motion], members, states, xy_px, LINK_PX)
    (row,) = rows_of([motion], members, joint, states, xy_px, np.array([expansion_hz]))
    return row


def timed(row):
    return with_times(with_epipole_pixels([row], CAMERA), CAMERA)[0]


def assert_inside(ref_px, xy_px):
    """The reference point lies among the given tracks, in the middle half of their box."""
    low, high = xy_px.min(axis=0), xy_px.max(axis=0)
    assert (np.abs(ref_px - 0.5 * (low + high)) < 0.25 * (high - low)).all()


def test_a_row_is_exact_without_noise():
    rng = np.random.default_rng(71)
    position_m, velocity = box_of_points(rng, 30, (3.0, 0.5, 15.0), PLATE_M), np.array([-3.0, 0.5, -6.0])
    row = timed(row_of(position_m, velocity, n_others=7))
    xy_px = pixels(position_m)
    assert (row.cluster_id, row.motion_id, row.n_tracks, row.role) == (1, 1, 30, "object")
    assert row.status == Status.ok
    np.testing.assert_allclose(row.box_px, [*xy_px.min(axis=0), *xy_px.max(axis=0)])
    assert_inside(row.ref_px, xy_px)
    np.testing.assert_allclose(row.state_abc_hz, velocity / 15.0, rtol=1e-9)
    assert row.times.ttc_z_s[0] == pytest.approx(2.5, rel=1e-9)
    point = 15.0 * np.append((np.array(row.ref_px) - (CAMERA.cx_px, CAMERA.cy_px)) / FOCAL_PX, 1.0)
    speed2 = velocity @ velocity
    assert row.times.tcpa_s[0] == pytest.approx(-point @ velocity / speed2, rel=1e-9)
    assert row.times.miss_s[0] == pytest.approx(np.linalg.norm(np.cross(point, velocity)) / speed2, rel=1e-9)
    assert row.expansion_hz == pytest.approx(1.0 / 2.5, rel=1e-9)
    assert row.epipole_px[0] == pytest.approx(CAMERA.cx_px + FOCAL_PX * 0.5)
    assert row.epipole_px[1] == pytest.approx(CAMERA.cy_px - FOCAL_PX / 12.0)


@pytest.mark.parametrize("velocity", [(-3.0, 0.5, -6.0), (5.0, 0.0, -3.0), (2.0, 0.3, 5.0)])
def test_covariance_of_the_joint_state_is_what_repetition_shows(velocity):
    """Own noise averages out over the tracks, the error of the common epipole does not."""
    rng = np.random.default_rng(72)
    velocity, trials = np.array(velocity), 150
    position_m = box_of_points(rng, 25, (3.0, 0.5, 15.0), PLATE_M)
    errors, covariances = [], []
    for _ in range(trials):
        direction, cov = direction_noise(rng, unit(velocity), np.radians(0.7))
        row = row_of(position_m, velocity, 0.2, direction, cov, rng)
        errors.append(row.state_abc_hz - velocity / 15.0)
        covariances.append(row.state_cov)
    errors, predicted = np.array(errors), np.mean(covariances, axis=0)
    for axis in (*np.eye(3), unit(velocity)):
        measured = np.mean((errors @ axis) ** 2)
        assert measured == pytest.approx(axis @ predicted @ axis, rel=0.4)


def test_noise_of_the_surfaces_own_tracks_is_not_understated():
    """Only tracks near the surface's rate are averaged: cutting tails off makes the mean less sure than its count."""
    rng = np.random.default_rng(81)
    velocity, square = np.array([0.0, 0.0, -6.0]), []
    for _ in range(250):
        row = row_of(box_of_points(rng, 30, (3.0, 0.5, 15.0), PLATE_M), velocity, 0.3, rng=rng)
        square.append((row.state_abc_hz[2] + 0.4) ** 2 / row.state_cov[2, 2])
    assert 0.75 < np.mean(square) < 1.2


def test_times_of_an_object_hold_the_truth_in_nine_of_ten():
    rng = np.random.default_rng(73)
    velocity, trials = np.array([-3.0, 0.5, -6.0]), 200
    position_m = box_of_points(rng, 25, (3.0, 0.5, 15.0), PLATE_M)
    held = np.zeros(3)
    for _ in range(trials):
        direction, cov = direction_noise(rng, unit(velocity), np.radians(0.7))
        row = timed(row_of(position_m, velocity, 0.2, direction, cov, rng))
        point = 15.0 * np.append((np.array(row.ref_px) - (CAMERA.cx_px, CAMERA.cy_px)) / FOCAL_PX, 1.0)
        tcpa_s = -point @ velocity / (velocity @ velocity)
        miss_s = np.linalg.norm(np.cross(point, velocity)) / (velocity @ velocity)
        times = row.times
        held += [
            times.ttc_z_lo_s[0] <= 2.5 <= times.ttc_z_hi_s[0],
            times.tcpa_lo_s[0] <= tcpa_s <= times.tcpa_hi_s[0],
            times.miss_lo_s[0] <= miss_s <= times.miss_hi_s[0],
        ]
    in_z, in_tcpa, in_miss = held / trials
    assert 0.85 <= in_z <= 0.95
    assert 0.93 <= in_tcpa <= 0.99
    assert 0.93 <= in_miss <= 0.99


def test_the_interval_of_what_crosses_holds_what_a_focal_length_not_given_may_be():
    row = row_of(box_of_points(np.random.default_rng(75), 25, (3.0, 0.5, 15.0), PLATE_M), np.array([-3.0, 0.0, -5.0]))
    given, assumed = (with_times([row], camera)[0].times for camera in (CAMERA, replace(CAMERA, origin="assumed")))
    assert assumed.tcpa_hi_s[0] - assumed.tcpa_lo_s[0] > 5.0 * (given.tcpa_hi_s[0] - given.tcpa_lo_s[0])
    assert assumed.ttc_z_hi_s[0] == given.ttc_z_hi_s[0]


@pytest.mark.parametrize("velocity", [(0.3, 0.0, -5.0), (0.3, 0.0, 5.0), (5.0, 0.0, 0.0), (-5.0, 0.0, 0.5)])
def test_an_objects_times_are_those_of_its_nearest_surface_whether_it_comes_goes_or_crosses(velocity):
    rng = np.random.default_rng(74)
    face, roof = (
        box_of_points(rng, 25, (0.5, 0.8, 10.0), (1.7, 0.6, 0.0)),
        box_of_points(rng, 40, (0.5, 0.3, 12.0), (1.6, 0.4, 1.0)),
    )
    row = timed(row_of(np.concatenate([face, roof]), np.array(velocity), 0.05, rng=rng))
    assert row.n_tracks == 65
    np.testing.assert_allclose(row.state_abc_hz, np.array(velocity) / 10.0, rtol=0.02, atol=1e-3)
    assert_inside(row.ref_px, pixels(face))


def test_an_object_without_a_supported_surface_has_a_reason_and_no_times():
    rng = np.random.default_rng(75)
    position_m = box_of_points(rng, 12, (3.0, 0.5, 15.0), PLATE_M)
    row = timed(row_of(position_m, [0.0, 0.0, -0.01], sigma_px=0.5))
    assert row.status == Status.no_parallax
    assert row.state_abc_hz is None
    assert row.motion_state == MotionState.unknown
    assert np.isnan(row.times.ttc_z_s[0])


def test_an_object_of_few_tracks_that_all_have_times_has_none_and_not_for_want_of_parallax():
    position_m = box_of_points(np.random.default_rng(77), 4, (3.0, 0.5, 15.0), PLATE_M)
    row = timed(row_of(position_m, [0.0, 0.0, -6.0]))
    assert row.status == Status.not_rigid
    assert row.state_abc_hz is None


def test_the_scene_has_an_epipole_and_no_times():
    xy_px = np.array([[10.0, 20.0], [600.0, 300.0], [5.0, 350.0]])
    states = two_frame_states(flows_of(np.ones((3, 3)), np.zeros(3)), np.zeros((3, 3)), np.zeros((3, 3, 3)))
    row = with_epipole_pixels([only_row(motion_of(0, (0, 0, -1), n=3), states, xy_px)], CAMERA)[0]
    assert (row.role, row.motion_id, row.n_tracks, row.box_px) == ("scene", 0, 3, (5.0, 20.0, 600.0, 350.0))
    np.testing.assert_allclose(row.epipole_px, (CAMERA.cx_px, CAMERA.cy_px))
    assert np.isnan(row.times.tcpa_s[0])
    still = motion_of(0, None, n=3, status=Status.no_parallax)
    resting = with_epipole_pixels([only_row(still, states, xy_px)], CAMERA)[0]
    assert resting.motion_state == MotionState.no_relative_motion
    assert resting.epipole_px is None


@pytest.mark.parametrize(
    ("from_plane_deg", "has_pixel"), [(0.0, False), (0.9, False), (1.1, True), (-1.1, True), (45, True)]
)
def test_an_epipole_within_a_degree_of_the_picture_plane_has_no_pixel(from_plane_deg, has_pixel):
    angle = np.radians(from_plane_deg)
    pixel = epipole_pixels(np.array([[np.cos(angle), 0.0, np.sin(angle)]]), CAMERA)[0]
    assert np.isfinite(pixel).all() == has_pixel
    if has_pixel:
        np.testing.assert_allclose(pixel, (CAMERA.cx_px + FOCAL_PX / np.tan(angle), CAMERA.cy_px))


def test_coming_and_going_have_the_same_epipole_pixel():
    direction = unit([0.2, -0.1, 1.0])
    pixels_ = epipole_pixels(np.array([direction, -direction]), CAMERA)
    np.testing.assert_allclose(pixels_, np.tile((319.5 + 144.0, 179.5 - 72.0), (2, 1)))


def numbers_of(clusters):
    """Numbers of the motions of clusters, as of rows that have the directions of their motions."""
    known = [motion.direction is not None for motion in clusters]
    direction, cov = np.full((len(clusters), 3), np.nan), np.full((len(clusters), 3, 3), np.nan)
    direction[known] = np.reshape([m.direction for m in clusters if m.direction is not None], (-1, 3))
    cov[known] = np.reshape([m.direction_cov for m in clusters if m.direction is not None], (-1, 3, 3))
    return motion_ids(np.array([m.cluster_id == 0 or m.is_static for m in clusters], dtype=bool), direction, cov)


def test_movers_with_one_epipole_share_a_motion_and_only_what_stands_has_the_scenes():
    clusters = (
        motion_of(0, (0, 0, -1)),
        motion_of(1, (1, 0, -1)),
        motion_of(2, (0.001, 0, -1)),
        replace(motion_of(8, (0.001, 0, -1)), is_static=True),
        motion_of(3, (1.001, 0, -1)),
        motion_of(4, (-1, 0, 1)),
        motion_of(7, None, status=Status.no_epipole),
        motion_of(9, None, status=Status.no_epipole),
    )
    assert numbers_of(clusters) == [0, 1, 2, 0, 1, 3, 4, 5]


def test_directions_that_could_be_any_are_not_said_to_be_one():
    clusters = (motion_of(1, (1, 0, -1)), motion_of(2, (1, 0.3, -1), sigma_rad=np.radians(20.0)))
    assert numbers_of(clusters) == [1, 2]


def test_objects_count_their_motions_from_one_where_the_scene_rests_or_is_not_seen():
    objects = (motion_of(1, (1, 0, 0)), motion_of(2, (0, 0, -1)))
    assert numbers_of(objects) == [1, 2]
    assert numbers_of((motion_of(0, None, status=Status.no_parallax), *objects)) == [0, 1, 2]
    assert numbers_of(()) == []


def test_equal_motions_are_told_to_be_equal_at_the_stated_confidence():
    rng = np.random.default_rng(76)
    same = 0
    for _ in range(1000):
        pair = [direction_noise(rng, unit([1.0, 0.2, -2.0]), np.radians(1.0)) for _ in range(2)]
        clusters = tuple(ClusterMotion(i + 1, np.arange(5), e, cov, Status.ok, "") for i, (e, cov) in enumerate(pair))
        same += numbers_of(clusters) == [1, 1]
    assert same / 1000 == pytest.approx(0.99, abs=0.011)


def stated(abc_hz, cov=1e-8, cluster_id=1, xy=(0.0, 0.0), *, is_timed=True):
    """A row with a known state at a point, and its times."""
    ref_px = (CAMERA.cx_px + FOCAL_PX * xy[0], CAMERA.cy_px + FOCAL_PX * xy[1])
    row = ClusterRow(
        cluster_id=cluster_id,
        motion_id=1,
        n_tracks=20,
        box_px=(300.0, 160.0, 340.0, 200.0),
        status=Status.ok,
        epipole_status=Status.ok,
        method="consensus",
        ref_px=ref_px,
        state_abc_hz=np.asarray(abc_hz, dtype=float),
        state_cov=np.asarray(cov) * np.eye(3),
    )
    return timed(row) if is_timed else row


@pytest.mark.parametrize(
    ("abc_hz", "xy", "state"),
    [
        ((0.0, 0.0, -0.5), (0.0, 0.0), "constant_bearing"),
        ((-0.1, 0.05, -0.5), (0.2, -0.1), "constant_bearing"),
        ((0.3, 0.0, -0.5), (0.0, 0.0), "approaching"),
        ((-0.5, 0.0, 0.0), (0.5, 0.0), "approaching"),
        ((0.0, 0.0, 0.5), (0.1, 0.0), "receding"),
        ((0.5, 0.0, 0.0), (0.5, 0.0), "receding"),
        ((0.0, 0.0, 0.0), (0.3, 0.0), "no_relative_motion"),
        ((0.5, 0.0, 0.0), (0.0, 0.0), "unknown"),
    ],
)
def test_how_an_object_moves(abc_hz, xy, state):
    assert stated(abc_hz, xy=xy).motion_state == MotionState(state)


def test_motion_is_seen_in_noise_as_often_as_stated():
    """Rates along the ray and across it are the quantiles of their distributions: their shares are exact."""
    rng = np.random.default_rng(77)
    trials, sigma_hz, xy = 3000, 0.02, (0.2, 0.1)
    shares = (np.arange(trials) + 0.5) / trials
    along = rng.permutation([NormalDist().inv_cdf(share) for share in shares])
    across = rng.permutation(np.sqrt(-2.0 * np.log(shares)))
    angle = rng.uniform(0.0, 2.0 * np.pi, trials)
    ray = unit([*xy, 1.0])
    side = unit(np.cross(ray, [0.0, 1.0, 0.0]))
    noise = along[:, None] * ray + across[:, None] * (
        np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(ray, side)
    )
    rows = [stated(sigma_hz * noise[k], sigma_hz**2, k, xy, is_timed=False) for k in range(trials)]
    found = [row.motion_state for row in with_times(rows, CAMERA)]
    # One side of 99.9 % each for nearer and farther: 3 of 3000. 95 % of a length of two components for across.
    assert sum(s in (MotionState.approaching, MotionState.constant_bearing) for s in found) == 3
    assert found.count(MotionState.receding) == 3
    assert found.count(MotionState.no_relative_motion) / trials == pytest.approx(0.95, abs=0.005)


def test_constant_bearing_is_seen_as_such_and_as_an_approach_in_95_of_100():
    rng = np.random.default_rng(78)
    trials, sigma_hz = 2000, 0.02
    abc_hz = (0.0, 0.0, -0.5) + sigma_hz * rng.normal(size=(trials, 3))
    rows = [stated(abc_hz[k], sigma_hz**2, k, is_timed=False) for k in range(trials)]
    found = [row.motion_state for row in with_times(rows, CAMERA)]
    assert found.count(MotionState.constant_bearing) / trials == pytest.approx(0.95, abs=0.02)


def test_a_near_car_at_our_own_speed_is_harmless_and_a_far_one_that_closes_fast_is_not():
    near_but_slow = stated((0.0, 0.0, -0.2 / 5.0), cluster_id=1)
    far_but_fast = stated((0.0, 0.0, -25.0 / 60.0), cluster_id=2)
    passes_far_off = stated((0.0, 0.0, -25.0 / 60.0), cluster_id=3, xy=(1.0, 0.0))
    goes_away = stated((0.0, 0.0, 0.5), cluster_id=4)
    rows = ranked([near_but_slow, far_but_fast, passes_far_off, goes_away])
    assert [row.urgency_rank for row in rows] == [3, 1, 2, None]


def test_ranks_count_from_one_without_holes_and_do_not_depend_on_order():
    rng = np.random.default_rng(79)
    rows = [stated((0.0, 0.0, -rng.uniform(0.1, 1.0)), cluster_id=k) for k in range(1, 9)]
    by_id = {row.cluster_id: row.urgency_rank for row in ranked(rows)}
    assert sorted(by_id.values()) == list(range(1, 9))
    assert {row.cluster_id: row.urgency_rank for row in ranked(rows[::-1])} == by_id
    soonest = min(rows, key=lambda row: row.times.tcpa_s[0])
    assert by_id[soonest.cluster_id] == 1


def test_rows_without_a_state_pass_through():
    row = replace(stated((0, 0, -1.0)), state_abc_hz=None, state_cov=None)
    assert with_times([row], CAMERA) == [row]
    assert with_times([], CAMERA) == []
    assert ranked([]) == []


@pytest.mark.parametrize("off_deg", [0.05, 20.0])
def test_an_object_has_the_direction_of_its_state(off_deg):
    """One estimate: times and direction come from the same velocity, whatever straight tracks say."""
    position_m, velocity = (
        box_of_points(np.random.default_rng(76), 30, (0.5, 0.5, 10.0), PLATE_M),
        unit((1.0, 0.0, -3.0)),
    )
    turn = np.radians(off_deg)
    believed = (
        np.array([np.cos(turn), 0.0, np.sin(turn)]) * velocity[0]
        + np.array([-np.sin(turn), 0.0, np.cos(turn)]) * (velocity[2])
    )
    cov = 1e-6 * (np.eye(3) - np.outer(believed, believed))
    motion = replace(motion_of(1, believed, n=30), direction_cov=cov)
    flows = flows_of(position_m, velocity, sigma_px=0.05)
    states = two_frame_states(flows, np.tile(velocity, (30, 1)), np.tile(1e-6 * np.eye(3), (30, 1, 1)))
    row = only_row(motion, states, pixels(position_m))
    np.testing.assert_allclose(row.direction, velocity, atol=1e-9)
    assert np.allclose(row.direction_cov @ row.direction, 0.0, atol=1e-12)
    # A horizon says more than the state does, wherever on it the epipole lies.
    on_horizon = replace(motion, method="whole-tracks" + ON_HORIZON)
    np.testing.assert_allclose(only_row(on_horizon, states, pixels(position_m)).direction, believed, atol=1e-9)
    # What stands still moves along our own direction.
    stands = replace(motion, is_static=True)
    np.testing.assert_allclose(only_row(stands, states, pixels(position_m)).direction, believed, atol=1e-9)


def test_a_row_is_changed_in_what_it_has_alone():
    row = ClusterRow(1, 1, 5, (0.0, 0.0, 1.0, 1.0), Status.ok, Status.ok, "multi-frame")
    changed = row.changed(urgency_rank=2, motion_state=MotionState.receding)
    assert changed == replace(row, urgency_rank=2, motion_state=MotionState.receding)
    assert row.urgency_rank is None
    with pytest.raises(TypeError, match="urgency_rang"):
        row.changed(urgency_rang=2)
