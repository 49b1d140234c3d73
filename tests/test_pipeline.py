"""All stages together on exact tracks: what changes nothing, what gives a status, and what the truth is."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_clips import HEIGHT, WIDTH, approach, swaying

from ttcvid.config import CollisionTimesConfig, EgomotionConfig, PipelineConfig, TrackingConfig
from ttcvid.model import Camera, Frame, FrameStatus, ImageSize, Platform, PointSet
from ttcvid.pipeline import analyze_frames
from ttcvid.simulate import TrackOptions, build_world, camera_of, load_scene, simulate_tracks

SCENES = Path(__file__).resolve().parent.parent / "sample_configs" / "scenes"
VEHICLE = PipelineConfig(egomotion=EgomotionConfig(platform=Platform.vehicle))
NO_NUMBERS = (FrameStatus.bad_dt, FrameStatus.duplicate, FrameStatus.dark)
PICTURE_CAMERA = Camera(180.0, 180.0, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, ImageSize(WIDTH, HEIGHT))


@cache
def scene(name, n_frames=12):
    whole = load_scene(SCENES / f"{name}.yaml")
    return whole.model_copy(update={"camera": whole.camera.model_copy(update={"n_frames": n_frames})})


@cache
def table(name, n_frames=12, sigma_px=0.1, n_tracks=180, min_per_object=8):
    """Frames of point tracks of a sample scene, and its camera."""
    options = TrackOptions(n_tracks, min_per_object=min_per_object, sigma_px=sigma_px)
    tracks = simulate_tracks(scene(name, n_frames), options)
    frames = []
    for index in range(n_frames):
        here = tracks.frame == index
        points = PointSet(tracks.track_id[here], tracks.xy_px[here])
        frames.append(Frame(index, float(tracks.t_s[here][0]), points=points))
    return tuple(frames), camera_of(scene(name, n_frames))


def results_of(frames, camera, config=VEHICLE, **options):
    return [result for _, result in analyze_frames(frames, camera, config, **options)]


@cache
def plain_run(name):
    return results_of(*table(name))


def statuses(results):
    return [str(result.status) for result in results]


def scene_row(result):
    return next((row for row in result.clusters if row.cluster_id == 0), None)


def assert_same(one, other, rtol=0.0, atol=0.0):
    """Two results with the same numbers, arrays and all."""
    for a, b in zip(one, other, strict=True):
        assert a.status == b.status
        assert (a.rotation_rad is None) == (b.rotation_rad is None)
        if a.rotation_rad is not None:
            np.testing.assert_allclose(a.rotation_rad, b.rotation_rad, rtol, atol)
        np.testing.assert_array_equal(a.tracks.track_id, b.tracks.track_id)
        np.testing.assert_array_equal(a.tracks.cluster_id, b.tracks.cluster_id)
        np.testing.assert_array_equal(a.tracks.status, b.tracks.status)
        np.testing.assert_allclose(a.tracks.times.ttc_z_s, b.tracks.times.ttc_z_s, rtol, atol)
        assert [row.cluster_id for row in a.clusters] == [row.cluster_id for row in b.clusters]


def has_no_numbers(result):
    return (
        len(result.tracks.track_id) == 0
        and result.clusters == ()
        and result.rotation_rad is None
        and result.rotation_sigma_rad is None
        and result.min_ttc_z_s is None
    )


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
    results = plain_run("resting_six_movers")
    assert statuses(results) == ["first", *["rotation_only"] * 11]
    assert max(np.degrees(np.linalg.norm(result.rotation_rad)) for result in results[1:]) < 0.03
    assert len(results[-1].clusters) >= 5
    assert all(row.direction is None for row in map(scene_row, results[1:]))


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


# --- estimates from both sides --------------------------------------------------------------------------------------

SMOOTH = VEHICLE.model_copy(update={"collision_times": CollisionTimesConfig(smooth=True, max_frames=10)})
CAUSAL = VEHICLE.model_copy(update={"collision_times": CollisionTimesConfig(max_frames=10)})


@cache
def long_runs(name):
    """The causal results, and those from both sides."""
    frames, camera = table(name, 30)
    return results_of(frames, camera, CAUSAL), results_of(frames, camera, SMOOTH)


@pytest.mark.parametrize("name", ["crossing_collision", "lead_car_brakes", "resting_six_movers"])
def test_smoothing_takes_nothing_back_that_was_found_out_on_the_way(name):
    causal, smooth = long_runs(name)
    for one, other in zip(causal, smooth, strict=True):
        assert (one.frame, one.t_s, one.status, one.events) == (other.frame, other.t_s, other.status, other.events)
        np.testing.assert_array_equal(one.rotation_rad, other.rotation_rad)
        np.testing.assert_array_equal(one.tracks.track_id, other.tracks.track_id)
        np.testing.assert_array_equal(one.tracks.xy_px, other.tracks.xy_px)
        in_object = one.tracks.cluster_id > 0
        np.testing.assert_array_equal(one.tracks.cluster_id[in_object], other.tracks.cluster_id[in_object])
        assert {row.cluster_id for row in one.clusters} <= {row.cluster_id for row in other.clusters}
    assert_same(causal[-1:], smooth[-1:])
    middle = slice(8, 20)
    changed = [
        not np.array_equal(one.tracks.times.ttc_z_s, other.tracks.times.ttc_z_s, equal_nan=True)
        for one, other in zip(causal[middle], smooth[middle], strict=True)
    ]
    assert all(changed)


def test_objects_are_known_half_a_window_before_they_are_found():
    causal, smooth = long_runs("crossing_collision")

    def first_frames(results):
        seen = [(row.cluster_id, result.frame) for result in results[::-1] for row in result.clusters]
        return {cluster_id: frame for cluster_id, frame in seen if cluster_id}

    found, known = first_frames(causal), first_frames(smooth)
    assert found.keys() == known.keys()
    earlier = [found[cluster_id] - known[cluster_id] for cluster_id in found]
    assert 0 < max(earlier) <= SMOOTH.collision_times.max_frames // 2
    assert min(earlier) >= 0


def test_smoothed_warnings_are_those_of_the_causal_analysis():
    frames, camera = table("crossing_collision", 50, n_tracks=200, min_per_object=30)
    causal, smooth = results_of(frames, camera, CAUSAL), results_of(frames, camera, SMOOTH)
    assert any(result.events for result in causal)
    assert [result.events for result in causal] == [result.events for result in smooth]


def test_smoothed_results_wait_for_half_a_window_and_no_longer():
    frames, camera = table("crossing_collision", 30)
    read = []

    def source():
        for frame in frames:
            read.append(frame.index)
            yield frame

    stream = analyze_frames(source(), camera, SMOOTH)
    for n in range(1, 20):
        next(stream)
        assert len(read) == n + SMOOTH.collision_times.max_frames // 2


def test_smoothed_results_do_not_look_over_a_cut():
    frames, camera = table("crossing_collision")
    n_ids = 1 + max(frame.points.track_id.max() for frame in frames)
    again = [
        replace(f, index=f.index + 12, t_s=f.t_s + 1.0, points=replace(f.points, track_id=f.points.track_id + n_ids))
        for f in frames
    ]
    alone, both = results_of(frames, camera, SMOOTH), results_of([*frames, *again], camera, SMOOTH)
    assert both[12].status == FrameStatus.cut
    assert_same(alone, both[:12])


def test_frames_without_numbers_keep_their_place_among_smoothed_ones():
    frames, camera = table("crossing_collision", 30)
    bad = replace(frames[5], index=99, t_s=frames[5].t_s)
    results = results_of([*frames[:6], bad, *frames[6:]], camera, SMOOTH)
    assert [result.frame for result in results[:8]] == [0, 1, 2, 3, 4, 5, 99, 6]
    assert has_no_numbers(results[6])
    # The frames before it wait for as many frames as ever, one of which gives them no view.
    assert_same(results[7:], long_runs("crossing_collision")[1][6:])


@pytest.mark.parametrize("n_frames", [1, 2, 3])
def test_a_clip_shorter_than_the_wait_is_smoothed_all_the_same(n_frames):
    frames, camera = table("crossing_collision", 12)
    results = results_of(frames[:n_frames], camera, SMOOTH)
    assert [result.frame for result in results] == list(range(n_frames))


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


# --- pictures -------------------------------------------------------------------------------------------------------


def pictures_of(pictures, dt_s=0.1):
    return [Frame(index, index * dt_s, grey=grey) for index, grey in enumerate(pictures)]


SMALL = PipelineConfig(tracking=TrackingConfig(max_tracks=120))


@cache
def approach_run():
    return results_of(pictures_of(approach(10)), PICTURE_CAMERA, SMALL)


def test_a_wall_that_comes_straight_on_has_the_time_it_was_given():
    """The wall is all there is: it is the scene, its tracks have times, and the clip began 4 s before contact."""
    results = approach_run()
    assert statuses(results) == ["first", *["ok"] * 9]
    last = results[-1]
    ttc_z_s = last.tracks.times.ttc_z_s
    assert np.isfinite(ttc_z_s).mean() > 0.5
    assert np.nanmedian(ttc_z_s) == pytest.approx(4.0 - 0.9, rel=0.06)
    assert scene_row(last).direction[2] < -0.99


def test_dark_and_doubled_pictures_give_a_status_and_no_number():
    clip = approach(10)
    black = np.full((HEIGHT, WIDTH), 2, np.uint8)
    clip[4], clip[7] = black, clip[6]
    results = results_of(pictures_of(clip), PICTURE_CAMERA, SMALL)
    assert statuses(results) == ["first", "ok", "ok", "ok", "dark", "ok", "ok", "duplicate", "ok", "ok"]
    assert has_no_numbers(results[4])
    assert has_no_numbers(results[7])
    # Rates come from the times of the pictures that were used: the gap costs nothing.
    assert np.nanmedian(results[-1].tracks.times.ttc_z_s) == pytest.approx(4.0 - 0.9, rel=0.08)


@pytest.mark.parametrize("black", [0, 16])
def test_a_black_clip_is_dark_all_through(black):
    """Also where the video says 16 for black."""
    results = results_of(pictures_of([np.full((HEIGHT, WIDTH), black, np.uint8)] * 3), PICTURE_CAMERA, SMALL)
    assert statuses(results) == ["dark"] * 3
    assert all(has_no_numbers(result) for result in results)


def test_a_cut_between_pictures_restarts_the_tracks():
    other = [255 - np.flipud(grey) // 2 for grey in swaying(4)]
    results = results_of(pictures_of([*approach(5), *other]), PICTURE_CAMERA, SMALL)
    assert statuses(results)[:6] == ["first", "ok", "ok", "ok", "ok", "cut"]
    assert (results[5].tracks.n_frames == 1).all()
    assert results[5].tracks.track_id.min() > results[4].tracks.track_id.max()


def test_nothing_is_analysed_under_the_mask():
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[80:] = 0
    for result in results_of(pictures_of(approach(5)), PICTURE_CAMERA, SMALL, mask=mask):
        assert len(result.tracks.track_id) > 20
        assert (result.tracks.xy_px[:, 1] < 80).all()


def test_work_done_ahead_changes_nothing():
    """Pictures prepared in one go, as other threads do, instead of one by one."""
    frames = pictures_of(approach(10))
    ahead = results_of(frames, PICTURE_CAMERA, SMALL, map_ahead=lambda work, items: iter([work(i) for i in items]))
    assert_same(ahead, approach_run())


def test_text_burned_into_the_pictures_belongs_to_nothing():
    """A station's logo: corners that never move look like constant bearing, and must not warn of anything."""
    clip = [grey.copy() for grey in swaying(34)]
    for grey in clip:
        grey[6:26, 6:76] = 20
        cv2.putText(grey, "TTC 42", (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 250, 1)
    last = results_of(pictures_of(clip), PICTURE_CAMERA, SMALL)[-1]
    x, y = last.tracks.xy_px.T
    on_text = (x > 7) & (x < 75) & (y > 8) & (y < 25) & (last.tracks.n_frames > 25)
    assert np.count_nonzero(on_text) >= 4
    assert (last.tracks.cluster_id[on_text] == -1).mean() > 0.8
    assert last.events == ()
