"""All stages together on exact tracks: what changes nothing, what gives a status, and what the truth is."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pipeline_runs import VEHICLE, assert_same, has_no_numbers, plain_run, results_of, scene, scene_row, statuses, table

from ttcvid.model import NO_CLUSTER, Frame, FrameStatus, PointSet, Status
from ttcvid.pipeline import analyze_frames
from ttcvid.simulate import build_world
from ttcvid.stages import analyzed_frames

# --- what is true ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["crossing_collision", "parked_street", "turning_jitter"])
def test_own_motion_of_a_drive_is_the_true_one(name):
    path = build_world(scene(name)).path
    turn_deg, away_deg = [], []
    for index, result in enumerate(plain_run(name)[4:], start=4):
        true_R = path.cam_R_road[index] @ path.cam_R_road[index - 1].T
        own_R = cv2.Rodrigues(result.rotation_rad)[0]
        turn_deg.append(np.degrees(np.linalg.norm(cv2.Rodrigues(own_R @ true_R.T)[0])))
        true_dir = -path.cam_R_road[index] @ (path.position_m[index] - path.position_m[index - 1])
        row = scene_row(result)
        away_deg.append(np.degrees(np.arccos(row.direction @ true_dir / np.linalg.norm(true_dir))))
    assert np.median(turn_deg) < 0.03
    assert np.median(away_deg) < 0.6


def test_a_resting_camera_neither_turns_nor_travels_and_sees_its_movers():
    results = results_of(*table("resting_six_movers", n_tracks=240, min_per_object=16))
    assert statuses(results) == ["first", *["rotation_only"] * 11]
    assert max(np.degrees(np.linalg.norm(result.rotation_rad)) for result in results[1:]) < 0.03
    assert len(results[-1].clusters) >= 5
    assert all(row.direction is None for row in map(scene_row, results[1:]))


def test_a_car_ahead_that_keeps_its_distance_stays_an_object():
    """It stays on its pixels within half a pixel, but for its noise. What is burned in does without any."""
    results = results_of(*table("lead_car_brakes", n_frames=16, min_per_object=20))
    objects = [{row.cluster_id: row for row in result.clusters if row.cluster_id > 0} for result in results]
    first = next(index for index, found in enumerate(objects) if found)
    (number,) = objects[first]
    assert first <= 10
    assert all(set(found) == {number} for found in objects[first:])
    assert {found[number].status for found in objects[first:]} == {Status.no_parallax}
    assert all(result.events == () for result in results)


def test_rows_are_complete_and_in_order():
    for frame, result in zip(table("crossing_collision")[0], plain_run("crossing_collision"), strict=True):
        assert (result.frame, result.t_s) == (frame.index, frame.t_s)
        np.testing.assert_array_equal(result.tracks.track_id, frame.points.track_id)
        np.testing.assert_array_equal(result.tracks.xy_px, frame.points.xy_px)
        ids = [row.cluster_id for row in result.clusters]
        assert ids == sorted(set(ids))
        for row in result.clusters:
            assert row.n_tracks == np.count_nonzero(result.tracks.cluster_id == row.cluster_id)


# --- what changes nothing -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["crossing_collision", "resting_six_movers"])
def test_the_same_frames_again_give_the_same_numbers(name):
    assert_same(plain_run(name), results_of(*table(name)))


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_order_of_the_tracks_does_not_matter(seed):
    """The same points under shuffled numbers: the same own motion, and the same tracks move with the scene."""
    frames, camera = table("crossing_collision")
    new_of = np.random.default_rng(seed).permutation(1 + max(f.points.track_id.max() for f in frames))
    shuffled = []
    for frame in frames:
        ids = new_of[frame.points.track_id]
        order = np.argsort(ids)
        shuffled.append(replace(frame, points=PointSet(ids[order], frame.points.xy_px[order])))
    for one, other in zip(plain_run("crossing_collision"), results_of(shuffled, camera), strict=True):
        assert one.status == other.status
        if one.rotation_rad is None:
            continue
        np.testing.assert_allclose(other.rotation_rad, one.rotation_rad, atol=1e-7)
        np.testing.assert_allclose(scene_row(other).direction, scene_row(one).direction, atol=1e-5)
        place = np.searchsorted(other.tracks.track_id, new_of[one.tracks.track_id])
        in_scene, other_in_scene = one.tracks.cluster_id == 0, other.tracks.cluster_id[place] == 0
        assert np.mean(in_scene == other_in_scene) > 0.99
        both = in_scene & other_in_scene & np.isfinite(one.tracks.times.ttc_z_s)
        np.testing.assert_allclose(
            1 / other.tracks.times.ttc_z_s[place][both], 1 / one.tracks.times.ttc_z_s[both], atol=1e-4
        )


def test_twice_the_time_makes_all_times_twice_as_long():
    frames, camera = table("crossing_collision")
    slow = results_of([replace(frame, t_s=2.0 * frame.t_s) for frame in frames], camera)
    for one, other in zip(plain_run("crossing_collision"), slow, strict=True):
        for name in ("tcpa_s", "tcpa_lo_s", "miss_s", "miss_hi_s", "ttc_z_s", "ttc_z_lo_s", "ttc_z_hi_s"):
            ratio = getattr(other.tracks.times, name) / getattr(one.tracks.times, name)
            ratio = ratio[np.isfinite(ratio)]
            # Up to what is believed of accelerations and rotation rates, which is in seconds.
            assert not len(ratio) or np.median(ratio) == pytest.approx(2.0, rel=0.03)
        assert np.mean(one.tracks.cluster_id == other.tracks.cluster_id) > 0.98


def test_a_mirrored_clip_gives_mirrored_results():
    frames, camera = table("crossing_collision")
    width = camera.image_size.width_px
    turned = [
        replace(f, points=PointSet(f.points.track_id, np.column_stack([width - 1, 0]) + f.points.xy_px * [-1, 1]))
        for f in frames
    ]
    for one, other in zip(plain_run("crossing_collision"), results_of(turned, camera), strict=True):
        if one.rotation_rad is None:
            continue
        np.testing.assert_allclose(other.rotation_rad, one.rotation_rad * [1, -1, -1], atol=1e-7)
        np.testing.assert_allclose(scene_row(other).direction, scene_row(one).direction * [-1, 1, 1], atol=1e-5)


def test_results_do_not_wait_for_the_end_of_the_clip():
    frames, camera = table("crossing_collision")
    stream = analyze_frames(iter(frames), camera, VEHICLE)
    first = [next(stream)[1] for _ in range(6)]
    assert_same(first, plain_run("crossing_collision")[:6])


# --- what gives a status and no number ------------------------------------------------------------------------------


@pytest.mark.parametrize("t_s", [0.25, 0.2, -1.0, 0.0], ids=["same", "earlier", "negative", "start"])
def test_a_time_that_does_not_move_on_gives_a_status_and_no_number(t_s):
    """The frame is passed over: those after it are as if it had not been there."""
    frames, camera = table("crossing_collision")
    bad = replace(frames[5], index=99, t_s=min(t_s, frames[5].t_s))
    results = results_of([*frames[:6], bad, *frames[6:]], camera)
    assert results[6].status == FrameStatus.bad_dt
    assert results[6].dt_s <= 0
    assert has_no_numbers(results[6])
    assert_same([*results[:6], *results[7:]], plain_run("crossing_collision"))


@pytest.mark.parametrize("jump_s", [0.8, 3.0, 100.0])
def test_over_a_jump_of_the_clock_all_begins_anew(jump_s):
    """Tracks that go on over it would tell speeds that nothing has, and surely."""
    frames, camera = table("stopped_car_ahead", n_frames=30, min_per_object=20)
    jumps = [replace(frame, t_s=frame.t_s + jump_s * (frame.index >= 15)) for frame in frames]
    results = results_of(jumps, camera)
    assert results[15].status == FrameStatus.cut
    assert results[15].rotation_rad is None
    assert np.isnan(results[15].tracks.times.ttc_z_s).all()
    alone = results_of(jumps[15:], camera)
    for with_past, without in zip(results[16:], alone[1:], strict=True):
        np.testing.assert_allclose(with_past.rotation_rad, without.rotation_rad, atol=1e-9)
        assert [row.status for row in with_past.clusters] == [row.status for row in without.clusters]


def test_a_clip_of_few_pictures_a_second_or_of_uneven_steps_has_no_gap():
    frames, camera = table("stopped_car_ahead", n_frames=12, min_per_object=20)
    slow = [replace(frame, t_s=2.0 * frame.index) for frame in frames]
    assert "cut" not in statuses(results_of(slow, camera))
    uneven = [replace(frame, t_s=frame.t_s + 0.4 * (frame.index >= 6)) for frame in frames]
    assert "cut" not in statuses(results_of(uneven, camera))


def test_a_doubled_frame_of_a_table_gives_a_status_and_no_number():
    frames, camera = table("crossing_collision")
    middle_s = 0.5 * (frames[5].t_s + frames[6].t_s)
    results = results_of([*frames[:6], replace(frames[5], index=99, t_s=middle_s), *frames[6:]], camera)
    assert results[6].status == FrameStatus.duplicate
    assert has_no_numbers(results[6])
    assert results[6].dt_s == pytest.approx(middle_s - frames[5].t_s)
    assert_same([*results[:6], *results[7:]], plain_run("crossing_collision"), rtol=1e-9)


def test_few_tracks_are_said_to_be_few_and_own_motion_is_left_open():
    frames, camera = table("crossing_collision")
    few = [replace(f, points=PointSet(f.points.track_id[:8], f.points.xy_px[:8])) for f in frames]
    results = results_of(few, camera)
    assert statuses(results)[0] == "first"
    assert set(statuses(results)[1:]) <= {"few_tracks", "cut"}
    assert all(result.rotation_rad is None for result in results)
    assert all(np.isnan(result.tracks.times.ttc_z_s).all() for result in results)


def test_a_frame_without_any_track_is_survived():
    frames, camera = table("crossing_collision")
    nothing = PointSet(np.empty(0, np.int64), np.empty((0, 2)))
    results = results_of([*frames[:6], replace(frames[6], points=nothing), *frames[7:]], camera)
    assert len(results[6].tracks.track_id) == 0
    assert results[-1].status == FrameStatus.ok
    assert scene_row(results[-1]).direction is not None


def test_a_frame_with_neither_picture_nor_points_is_an_error():
    with pytest.raises(ValueError, match="frame 3: expected a picture or points"):
        results_of([Frame(3, 0.0)], table("crossing_collision")[1])


# --- cuts -----------------------------------------------------------------------------------------------------------


def test_a_cut_restarts_everything_and_numbers_go_on():
    frames, camera = table("resting_six_movers")
    n_ids = 1 + max(frame.points.track_id.max() for frame in frames)
    again = [
        replace(f, index=f.index + 12, t_s=f.t_s + 1.0, points=replace(f.points, track_id=f.points.track_id + n_ids))
        for f in frames
    ]
    results = results_of([*frames, *again], camera)
    assert results[12].status == FrameStatus.cut
    assert results[12].rotation_rad is None
    assert (results[12].tracks.n_frames == 1).all()
    assert np.isnan(results[12].tracks.times.ttc_z_s).all()
    before = {row.cluster_id for result in results[:12] for row in result.clusters} - {0}
    after = {row.cluster_id for result in results[12:] for row in result.clusters} - {0}
    assert before
    assert after
    assert not before & after
    # Nothing else is carried over: the second half is the first once more, noise estimates and all.
    for one, other in zip(results[:12], results[12:], strict=True):
        np.testing.assert_array_equal(one.tracks.n_frames, other.tracks.n_frames)
        if one.rotation_rad is not None:
            np.testing.assert_allclose(other.rotation_rad, one.rotation_rad, atol=1e-12)


def test_what_is_left_of_an_object_is_not_among_the_results(monkeypatch):
    """As if a surface needed 1000 tracks, an object without times is none, and its tracks are of none."""

    def have_times(results):
        return [row.state_abc_hz is not None for result in results for row in result.clusters if row.role == "object"]

    as_they_are = have_times(plain_run("roundabout"))
    monkeypatch.setattr(analyzed_frames, "LEAST_TRACKS", 1000)
    found = results_of(*table("roundabout"))
    assert not all(as_they_are)
    assert have_times(found) == [True] * sum(as_they_are)
    for result in found:
        assert set(result.tracks.cluster_id.tolist()) <= {NO_CLUSTER, *(row.cluster_id for row in result.clusters)}
