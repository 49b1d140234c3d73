"""Scene and movers as rigid bodies, from exact simulated tracks to the body of each track."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from relative_motion import box_of_points
from rigid_worlds import DT_S, FOCAL_PX, Thing, bodies_of, car, world

from ttcvid.geometry.estimation.rigid_motion import fit_on_paths
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Platform
from ttcvid.stages.segmentation import labels
from ttcvid.stages.segmentation.labels import restarted_bodies
from ttcvid.stages.tracking.tracker import COMMON_ERROR_PX

N_FRAMES, AHEAD, SLOWLY, STILL = 16, (0.0, 0.0, 10.0), (0.0, 0.0, 4.0), (0.0, 0.0, 0.0)
# A new mover needs three views of its tracks; with few it is sure some frames later.
FOUND_FRAMES, NAMED_FRAMES = 6, 9


def crossing(rng, n=30):
    return car(rng, (6.0, 0.5, 32.0), (-5.0, 0.0, 0.0), n)


def scene_part(frame, number=0):
    return np.mean(frame.key[frame.truth == number] == 0)


def assert_one_mover_each(frames, *numbers, since=NAMED_FRAMES, part=0.9):
    """Each of these things has one key of its own from a frame on, and the static points belong to the scene."""
    own = [{frame.keys_of(number)[0] for frame in frames[since:]} for number in numbers]
    for number, keys in zip(numbers, own, strict=True):
        assert len(keys) == 1, (number, keys)
        assert 0 not in keys, number
        assert min(frame.keys_of(number)[1] for frame in frames[since:]) >= part, number
    assert len(set.union(*own)) == len(numbers)
    assert min(scene_part(frame) for frame in frames[since:]) > 0.97


@pytest.mark.parametrize("seed", range(4))
def test_a_crossing_car_is_found_soon_and_keeps_its_key_and_number(seed):
    rng = np.random.default_rng(seed)
    frames = bodies_of(world(rng, AHEAD, N_FRAMES, crossing(rng)), N_FRAMES, seed=seed)
    assert scene_part(frames[FOUND_FRAMES], 1) < 0.2
    assert_one_mover_each(frames, 1, since=FOUND_FRAMES)
    named = [frame.cluster_ids[frame.keys_of(1)[0]] for frame in frames[FOUND_FRAMES - 1 :]]
    assert set(named) == {1}


def test_without_movers_everything_is_the_scene():
    rng = np.random.default_rng(1)
    frames = bodies_of(world(rng, AHEAD, N_FRAMES), N_FRAMES)
    assert all(not frame.mover_keys for frame in frames)
    assert max(np.median(frame.found.seen.redchi) for frame in frames) < 1.5


@given(seed=st.integers(0, 2**32 - 1), sigma_px=st.sampled_from([0.05, 0.2, 0.5]))
@settings(max_examples=12)
def test_noise_alone_gives_no_movers(seed, sigma_px):
    rng = np.random.default_rng(seed)
    frames = bodies_of(world(rng, AHEAD, 10), 10, sigma_px=sigma_px, seed=seed)
    assert all(not frame.mover_keys for frame in frames)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("stop_s", [1.6, 2.5])
def test_we_brake_to_a_stop_and_nothing_becomes_a_mover(seed, stop_s):
    """From 10 m/s on a road that always has new tracks near us: only older ones tell that we are slower."""
    rng = np.random.default_rng(seed)
    way_m, n_frames = 5.0 * stop_s, round(stop_s / DT_S) + 12

    def road(n, from_m, to_m, first):
        x_m, z_m = rng.uniform(-4.0, 4.0, n), 1.0 / rng.uniform(1.0 / to_m, 1.0 / from_m, n)
        return Thing(np.column_stack([x_m, np.full(n, 1.4), z_m]), frames=(first, 10**9))

    new = [road(40, 3.0 + way_m, 8.0 + way_m, first) for first in range(4, n_frames, 3)]
    things = [*world(rng, AHEAD, 1, n=150, depth_m=(15.0 + way_m, 90.0)), road(120, 5.0 + way_m, 40.0 + way_m, 0), *new]
    frames = bodies_of(things, n_frames, AHEAD, stop_s=stop_s, seed=seed)
    assert all(not frame.mover_keys for frame in frames)
    assert max(np.median(frame.found.seen.redchi) for frame in frames) < 2.0


@pytest.mark.parametrize("yaw_rad_s", [0.15, -0.3])
def test_a_turning_camera_makes_no_movers_and_loses_none(yaw_rad_s):
    rng = np.random.default_rng(2)
    quiet = bodies_of(world(rng, AHEAD, N_FRAMES), N_FRAMES, yaw_rad_s=yaw_rad_s)
    assert all(not frame.mover_keys for frame in quiet)
    frames = bodies_of(world(rng, AHEAD, N_FRAMES, crossing(rng)), N_FRAMES, yaw_rad_s=yaw_rad_s)
    assert_one_mover_each(frames, 1)


def test_two_cars_far_apart_with_the_same_motion_are_two_movers():
    rng = np.random.default_rng(3)
    left, right = car(rng, (-4.0, 0.5, 34.0), (-3.0, 0.0, 0.0)), car(rng, (8.0, 0.5, 34.0), (-3.0, 0.0, 0.0))
    frames = bodies_of(world(rng, AHEAD, N_FRAMES, left, right), N_FRAMES)
    # In one of ten such worlds up to a fourth of a car starts a mover of its own.
    assert_one_mover_each(frames, 1, 2, part=0.75)


def test_cars_that_meet_are_two_movers():
    rng = np.random.default_rng(4)
    one, other = car(rng, (-8.0, 0.5, 34.0), (4.0, 0.0, 0.0)), car(rng, (8.0, 0.5, 38.0), (-4.0, 0.0, 0.0))
    frames = bodies_of(world(rng, AHEAD, N_FRAMES, one, other), N_FRAMES)
    assert_one_mover_each(frames, 1, 2)


def test_parts_that_hang_together_no_more_stay_one_mover():
    rng = np.random.default_rng(16)
    velocity, height = (-4.0, 0.0, 0.0), (0.5, 30.0)
    front, rear = (car(rng, (x, *height), velocity, 24, (2.0, 1.8, 1.5)) for x in (2.0, 8.0))
    middle = car(rng, (5.0, *height), velocity, 60, (6.5, 1.8, 1.5), frames=(0, 10))
    frames = bodies_of(world(rng, SLOWLY, N_FRAMES, front, rear, middle), N_FRAMES, camera_m_s=SLOWLY)
    assert {frames[8].keys_of(number)[0] for number in (1, 2, 3)} == {frames[8].keys_of(1)[0]} != {0}
    assert frames[8].keys_of(1)[0] == frames[-1].keys_of(1)[0] == frames[-1].keys_of(2)[0]


@pytest.mark.parametrize("seed", range(2))
def test_two_things_that_move_alike_are_two_where_the_street_is_seen_between_them(seed):
    rng = np.random.default_rng(seed)
    velocity = (0.0, 0.0, -1.4)
    left, right = (car(rng, (x, 0.3, 8.0), velocity, 30, (0.5, 1.6, 0.05)) for x in (-0.6, 0.6))
    things = world(rng, STILL, N_FRAMES, left, right, n=1200)
    frames = bodies_of(things, N_FRAMES, camera_m_s=STILL, platform=Platform.free)
    for frame in frames[NAMED_FRAMES:]:
        assert frame.keys_of(1)[0] != frame.keys_of(2)[0]


def test_a_crowd_before_a_camera_on_a_mast_is_not_the_noise_of_the_street():
    """Most tracks go each its own way, and no motion explains them: a car that crosses is found all the same."""
    rng = np.random.default_rng(8)
    crowd = [
        Thing(box_of_points(rng, 1, (0.0, 1.5, 20.0), (12.0, 3.0, 4.0)), tuple(rng.uniform(-2.0, 2.0, 3)))
        for _ in range(150)
    ]
    passing = car(rng, (5.0, -2.0, 25.0), (-5.0, 0.0, 0.0))
    things = world(rng, STILL, N_FRAMES, passing, n=60)
    frames = bodies_of([*things, *crowd], N_FRAMES, camera_m_s=STILL, platform=Platform.static)
    assert max(frame.found.seen.median_redchi for frame in frames) < 2.0
    assert min(frame.keys_of(1)[1] for frame in frames[NAMED_FRAMES:] if frame.keys_of(1)[0]) > 0.9
    assert all(frame.keys_of(1)[0] for frame in frames[NAMED_FRAMES:])


def test_two_cars_side_by_side_that_drive_apart_are_two_from_the_start():
    rng = np.random.default_rng(17)
    left, right = car(rng, (-2.2, 0.5, 34.0), (-5.0, 0.0, 0.0)), car(rng, (2.2, 0.5, 34.0), (5.0, 0.0, 0.0))
    frames = bodies_of(world(rng, AHEAD, N_FRAMES, left, right), N_FRAMES)
    assert_one_mover_each(frames, 1, 2, since=FOUND_FRAMES)


@pytest.mark.parametrize("yaw_rad_s", [0.3, -0.4])
def test_a_car_that_turns_stays_one_mover(yaw_rad_s):
    rng = np.random.default_rng(6)
    turning = car(rng, (5.0, 0.5, 30.0), (-5.0, 0.0, 0.0), 40, yaw_rad_s=yaw_rad_s)
    frames = bodies_of(world(rng, SLOWLY, 24, turning), 24, camera_m_s=SLOWLY)
    assert_one_mover_each(frames, 1)


@pytest.mark.parametrize("platform", [Platform.static, Platform.vehicle])
def test_a_lorry_that_comes_nearer_to_a_camera_at_rest_is_not_the_scene(platform):
    rng = np.random.default_rng(7)
    lorry = car(rng, (1.0, 0.0, 36.0), (0.0, 0.0, -9.0), 60, (2.5, 3.0, 3.0))
    frames = bodies_of(world(rng, STILL, N_FRAMES, lorry), N_FRAMES, camera_m_s=STILL, platform=platform)
    assert_one_mover_each(frames, 1)


def test_a_car_ahead_that_is_faster_than_we_are_is_a_mover():
    """It goes away: no static point before the camera does."""
    rng = np.random.default_rng(8)
    ahead = car(rng, (1.0, 0.5, 14.0), (0.0, 0.0, 16.0), 30, (1.8, 1.4, 1.0))
    frames = bodies_of(world(rng, AHEAD, N_FRAMES, ahead), N_FRAMES)
    assert_one_mover_each(frames, 1)


def test_a_car_ahead_that_leaves_our_direction_a_little_is_found_by_its_whole_track():
    """Slower than we are, and 0.4 m/s to the side: a pixel a frame."""
    rng = np.random.default_rng(15)
    ahead = car(rng, (0.3, 0.5, 28.0), (0.4, 0.0, 6.0), 30, (1.8, 1.4, 3.0))
    frames = bodies_of(world(rng, AHEAD, N_FRAMES, ahead), N_FRAMES)
    assert_one_mover_each(frames, 1)


def test_far_static_points_around_a_mover_stay_with_the_scene():
    rng = np.random.default_rng(9)
    mover = crossing(rng)
    frames = bodies_of(world(rng, AHEAD, N_FRAMES, mover, n=500, depth_m=(80.0, 400.0)), N_FRAMES)
    assert_one_mover_each(frames, 1)


def test_what_is_seen_far_away_through_a_mover_stays_with_the_scene():
    """Any path explains a far point, and all of its neighbours are on the lorry."""
    rng = np.random.default_rng(18)
    lorry = car(rng, (0.5, 0.0, 30.0), (0.3, 0.0, -6.0), 70, (3.0, 3.0, 2.0))
    far = Thing(np.array([[8.0, 0.0, 400.0], [2.0, 6.0, 400.0], [8.0, -8.0, 400.0]]))
    frames = bodies_of([*world(rng, STILL, N_FRAMES, lorry), far], N_FRAMES, camera_m_s=STILL)
    assert_one_mover_each(frames, 1)
    assert np.mean([scene_part(frame, 2) for frame in frames[NAMED_FRAMES:]]) > 0.9


def test_other_identities_of_the_tracks_change_nothing():
    rng = np.random.default_rng(10)
    things = world(rng, AHEAD, 12, crossing(rng))
    order = rng.permutation(sum(len(thing.points) for thing in things))
    plain, shuffled = bodies_of(things, 12), bodies_of(things, 12, order=order)
    for one, other in zip(plain, shuffled, strict=True):
        keys = dict(zip(other.track_id.tolist(), other.key.tolist(), strict=True))
        same = [keys[order[track]] == key for track, key in zip(one.track_id, one.key, strict=True)]
        assert np.mean(same) > 0.99
        assert one.mover_keys == other.mover_keys


def test_a_mover_that_vanishes_is_forgotten_and_its_key_never_used_again():
    rng = np.random.default_rng(11)
    first = crossing(rng)
    second = car(rng, (-7.0, 0.5, 34.0), (5.0, 0.0, 0.0), frames=(13, 99))
    things = world(rng, SLOWLY, 24, first, second)
    things[1] = replace(first, frames=(0, 11))
    frames = bodies_of(things, 24, camera_m_s=SLOWLY)
    key = frames[9].keys_of(1)[0]
    assert key != 0
    gone = [frame for frame in frames if frame.t_s > 10 * DT_S + 1.0]
    assert len(gone) == 3
    assert all(key not in frame.found.movers.key for frame in gone)
    assert_one_mover_each(frames, 2, since=20)
    ids = [number for frame in frames for number in frame.cluster_ids.values() if number != NO_CLUSTER]
    assert frames[-1].cluster_ids[frames[-1].keys_of(2)[0]] == 2
    assert set(ids) == {1, 2}


@pytest.mark.parametrize("n_hidden", [1, 2, 3, 5])
@pytest.mark.parametrize("same_tracks", [True, False])
def test_a_car_that_a_post_hides_for_some_frames_keeps_its_key_and_number(n_hidden, same_tracks):
    """A track table may know its tracks again; a tracker of pictures follows new ones."""
    rng = np.random.default_rng(11)
    whole, out_at = crossing(rng), 14 + n_hidden
    before = replace(whole, frames=(0, 14))
    # Ever so little: the same points are other tracks.
    after = replace(whole, points=whole.points + 1e-9, frames=(out_at, 99))
    if same_tracks:
        before = replace(whole, hidden=range(14, out_at))
        after = replace(after, frames=(99, 99))
    things = world(rng, SLOWLY, 26, whole)
    frames = bodies_of([things[0], before, after], 26, camera_m_s=SLOWLY)
    number = 1 if same_tracks else 2
    key = frames[12].keys_of(1)[0]
    again = [frame for frame in frames if frame.t_s >= (out_at + (0 if same_tracks else 3)) * DT_S - 1e-9]
    assert {frame.keys_of(number)[0] for frame in again} == {key}
    assert {frame.cluster_ids[key] for frame in again} == {1}
    assert min(frame.keys_of(number)[1] for frame in again) > 0.8
    assert all(set(frame.cluster_ids) == {key} for frame in again)


def test_the_path_of_a_car_ahead_that_brakes_keeps_up_with_its_tracks(monkeypatch):
    redchi_of, really = [], labels.stepped_movers

    def noted(movers, scene, points, n_steps, rate_hz):
        paths, now_hz = really(movers, scene, points, n_steps, rate_hz)
        redchi_of.append(np.median(fit_on_paths(points, paths, now_hz[points.thing]).redchi))
        return paths, now_hz

    monkeypatch.setattr(labels, "stepped_movers", noted)
    rng = np.random.default_rng(1)
    ahead = car(rng, (0.5, 0.5, 22.0), AHEAD, acceleration_m_s2=(0.0, 0.0, -5.0))
    bodies_of(world(rng, AHEAD, 24, ahead), 24, camera_m_s=AHEAD)
    assert len(redchi_of) > 12
    assert max(redchi_of[6:]) < 1.3


def test_what_comes_out_elsewhere_or_moves_otherwise_is_another_thing():
    rng = np.random.default_rng(11)
    first = replace(crossing(rng), frames=(0, 14))
    x_m = 6.0 - 5.0 * 1.7
    for place_m, velocity_m_s in (((x_m + 9.0, 0.5, 32.0), (-5.0, 0.0, 0.0)), ((x_m, 0.5, 32.0), (5.0, 0.0, 0.0))):
        start_m = np.array(place_m) - 1.7 * np.array(velocity_m_s)
        other = car(rng, start_m, velocity_m_s, frames=(17, 99))
        frames = bodies_of(world(rng, SLOWLY, 26, first, other), 26, camera_m_s=SLOWLY)
        assert frames[-1].keys_of(2)[0] not in (0, frames[12].keys_of(1)[0])


def test_after_a_restart_no_number_is_given_out_twice():
    rng = np.random.default_rng(12)
    things = world(rng, AHEAD, N_FRAMES, crossing(rng))
    before = bodies_of(things, N_FRAMES)
    memory = restarted_bodies(before[-1].memory)
    assert memory.scene is None
    assert not len(memory.movers)
    after = bodies_of(things, N_FRAMES, memory=memory)
    numbers = [
        {number for frame in frames for number in frame.cluster_ids.values() if number != NO_CLUSTER}
        for frames in (before, after)
    ]
    keys = [{key for frame in frames for key in frame.found.movers.key} for frames in (before, after)]
    assert numbers[0]
    assert numbers[1]
    assert numbers[0].isdisjoint(numbers[1])
    assert keys[0].isdisjoint(keys[1])


def test_too_few_tracks_make_no_mover():
    rng = np.random.default_rng(13)
    things = world(rng, AHEAD, 10, crossing(rng, 3))
    assert all(not frame.mover_keys for frame in bodies_of(things, 10))


def test_the_first_two_frames_and_a_frame_of_two_tracks_are_no_errors():
    rng = np.random.default_rng(14)
    frames = bodies_of(world(rng, AHEAD, 3, n=2), 3)
    assert all(not frame.mover_keys for frame in frames)


def test_a_bus_that_turns_is_found_whole():
    found = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        bus = car(rng, (-6.0, -0.5, 24.0), (5.0, 0.0, -4.0), 90, (11.0, 2.6, 2.4), yaw_rad_s=-0.45)
        own = [frame.keys_of(1) for frame in bodies_of(world(rng, SLOWLY, 26, bus), 26, SLOWLY, seed=seed)[10:]]
        assert {key for key, _ in own} == {own[0][0]} - {SCENE_CLUSTER}
        found.append(min(part for _, part in own))
    assert np.mean(found) > 0.87


class Slipping(Thing):
    """Points that lie a little to the side from a moment on, as where a codec moves their block."""

    def at(self, t_s):
        from_s, aside_m = 0.8, self.velocity_m_s[0]
        return self.points + np.where(t_s >= from_s - 1e-9, (aside_m, 0.0, 0.0), 0.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("slip_px", "is_one"), [(1.0, False), (3.0, True)])
def test_what_slips_by_no_more_than_tracks_err_in_common_is_no_mover(seed, slip_px, is_one):
    rng = np.random.default_rng(seed)
    depth_m = 20.0
    points = np.column_stack([rng.uniform(2.0, 3.0, 20), rng.uniform(-1.5, -0.5, 20), np.full(20, depth_m)])
    block = Slipping(points, (slip_px * depth_m / FOCAL_PX, 0.0, 0.0))
    things = world(rng, (0.0, 0.0, 5.0), 16, block)
    options = {"sigma_px": 0.05, "seed": seed, "platform": Platform.free}
    frames = bodies_of(things, 16, (0.0, 0.0, 5.0), common_error_px=COMMON_ERROR_PX, **options)
    assert any(frame.mover_keys for frame in frames) == is_one
    # Tracks that err each by itself tell of a smaller step.
    alone = bodies_of(things, 16, (0.0, 0.0, 5.0), **options)
    assert any(frame.mover_keys for frame in alone)
