"""What a new picture is to the last one: its continuation, a cut, a copy, or darkness; for both trackers."""

from itertools import pairwise

import numpy as np
import pytest
from wave_pictures import HEIGHT, WIDTH, Warp, wave_picture

from ttcvid.config import TrackingConfig
from ttcvid.model import FrameStatus
from ttcvid.stages.tracking.klt import KltMemory
from ttcvid.stages.tracking.tracker import TrackerMemory, follow_points, prepare_picture

KLT = TrackingConfig(max_tracks=150)
AKAZE = TrackingConfig(tracker="akaze", max_tracks=150)
BLACK = np.full((HEIGHT, WIDTH), 3, np.uint8)
both_trackers = pytest.mark.parametrize("config", [KLT, AKAZE], ids=["klt", "akaze"])


def follow_all(pictures, config, allowed=None):
    """Points and status of each picture."""
    memory, out = TrackerMemory(), []
    for grey in pictures:
        points, status, memory = follow_points(memory, prepare_picture(grey, allowed, config), allowed, config)
        out.append((points, status))
    return out


def statuses(pictures, config):
    return [str(status) for _, status in follow_all(pictures, config)]


def bright(grey):
    return (90 + grey.astype(float) * 0.6).astype(np.uint8)


@both_trackers
def test_first_picture_is_first_and_the_next_goes_on(config):
    assert statuses([wave_picture(), wave_picture(Warp(scale=1.01))], config) == ["first", "ok"]


@both_trackers
def test_a_hard_cut_is_a_cut_and_everything_begins_anew(config):
    here = [wave_picture(Warp(shift_px=(x, 0.0))) for x in (0.0, 1.0, 2.0)]
    there = [bright(wave_picture(Warp(shift_px=(x, 0.0)), seed=5)) for x in (0.0, 1.0)]
    results = follow_all(here + there, config)
    assert [str(status) for _, status in results] == ["first", "ok", "ok", "cut", "ok"]
    before = np.concatenate([points.track_id for points, _ in results[:3]])
    assert results[3][0].track_id.min() > before.max()
    shared = np.isin(results[4][0].track_id, results[3][0].track_id)
    assert shared.mean() > 0.5


@both_trackers
def test_a_cut_between_pictures_of_the_same_look_is_a_cut(config):
    cuts = [statuses([wave_picture(), wave_picture(seed=seed)], config)[1] for seed in range(1, 6)]
    assert cuts == ["cut"] * 5


@both_trackers
def test_a_fast_pan_is_no_cut(config):
    """A tenth of the picture's width from frame to frame."""
    pan = [wave_picture(Warp(shift_px=(-0.1 * WIDTH * step, 0.0))) for step in range(5)]
    results = follow_all(pan, config)
    assert [str(status) for _, status in results] == ["first", *["ok"] * 4]
    assert np.isin(results[4][0].track_id, results[3][0].track_id).mean() > 0.4


@both_trackers
def test_a_change_of_exposure_by_a_tenth_is_no_cut(config):
    flash = np.clip(1.1 * wave_picture(Warp(shift_px=(1.0, 0.0))).astype(float), 0, 255).astype(np.uint8)
    assert statuses([wave_picture(), flash], config) == ["first", "ok"]


@pytest.mark.parametrize("gain", [0.6, 0.75, 1.35])
def test_a_lamp_that_flickers_or_the_end_of_a_tunnel_is_no_cut_either(gain):
    """Of Lucas-Kanade: in a darker picture AKAZE finds other features."""
    here, there, later = (0.6 * wave_picture(Warp(shift_px=(x, 0.0))).astype(float) for x in (0.0, 2.0, 4.0))
    pictures = [np.clip(grey, 0, 255).astype(np.uint8) for grey in (here, gain * there, gain * later)]
    results = follow_all(pictures, KLT)
    assert [str(status) for _, status in results] == ["first", "ok", "ok"]
    for (before, _), (after, _) in pairwise(results):
        _, one, other = np.intersect1d(before.track_id, after.track_id, return_indices=True)
        assert len(one) > 0.6 * len(before.track_id)
        moved_px = after.xy_px[other] - before.xy_px[one]
        assert np.abs(np.median(moved_px, axis=0) - [2.0, 0.0]).max() < 0.1


@both_trackers
def test_darkness_gives_no_points_and_the_tracks_go_on_after_it(config):
    pictures = [wave_picture(), wave_picture(Warp(scale=1.005)), BLACK, BLACK, wave_picture(Warp(scale=1.01))]
    results = follow_all(pictures, config)
    assert [str(status) for _, status in results] == ["first", "ok", "dark", "dark", "ok"]
    assert len(results[2][0].track_id) == 0
    assert np.isin(results[4][0].track_id, results[1][0].track_id).mean() > 0.6


def test_a_clip_that_begins_in_darkness_begins_with_its_first_picture():
    assert statuses([BLACK, BLACK, wave_picture(), wave_picture(Warp(scale=1.01))], KLT) == [
        "dark",
        "dark",
        "first",
        "ok",
    ]


@both_trackers
def test_the_same_picture_again_is_a_duplicate_without_points(config):
    results = follow_all([wave_picture(), wave_picture(), wave_picture(Warp(shift_px=(0.5, 0)))], config)
    assert [str(status) for _, status in results] == ["first", "duplicate", "ok"]
    assert len(results[1][0].track_id) == 0
    assert np.isin(results[2][0].track_id, results[0][0].track_id).mean() > 0.6


def test_a_picture_that_differs_in_one_grey_level_is_no_duplicate():
    other = wave_picture()
    other[50, 50] ^= 1
    assert statuses([wave_picture(), other], KLT) == ["first", "ok"]


def as_sent(grey, seed):
    """The picture as another codec frame brings it: with a little noise of its own."""
    noise = np.random.default_rng(seed).normal(0.0, 1.0, grey.shape)
    return np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8)


def drive_of(shifts_px):
    return [as_sent(wave_picture(Warp(shift_px=(x, 0.0))), seed) for seed, x in enumerate(shifts_px)]


@both_trackers
@pytest.mark.parametrize("times", [1, 5])
def test_pictures_sent_again_are_duplicates_though_a_codec_changed_them(config, times):
    shifts_px = [0, 4, 8, *[12] * (1 + times), 16, 20]
    results = follow_all(drive_of(shifts_px), config)
    expected = ["first", "ok", "ok", "ok", *["duplicate"] * times, "ok", "ok"]
    assert [str(status) for _, status in results] == expected
    assert len(results[4][0].track_id) == 0
    assert np.isin(results[-2][0].track_id, results[3][0].track_id).mean() > 0.6


def test_a_camera_that_has_stopped_is_no_repeated_picture_for_long():
    assert statuses(drive_of([0, 4, 8, *[12] * 9]), KLT)[4:] == [*["duplicate"] * 5, *["ok"] * 3]


def test_a_camera_that_comes_to_rest_or_rests_repeats_nothing():
    assert "duplicate" not in statuses(drive_of([0, 4, 6, 7, 7.5, 7.8, 7.9, *[7.9] * 4]), KLT)
    assert "duplicate" not in statuses(drive_of([0] * 5), KLT)


@pytest.mark.parametrize("gap", ["dark", "frozen", "left out"])
def test_the_first_picture_after_a_gap_and_the_next_are_none_that_were_sent_again(gap):
    """A slow pan goes on in between, and makes one long step."""
    before, after = drive_of(1.5 * np.arange(5)), drive_of(6.0 + 18.0 + 1.5 * np.arange(4))
    between = {"dark": [np.zeros_like(before[0])] * 3, "frozen": [before[-1]] * 3, "left out": []}[gap]
    found = statuses([*before, *between, *after], KLT)
    assert found[len(before) + len(between) :] == ["ok"] * 4


def test_what_moves_before_a_camera_at_rest_shows_that_a_picture_is_no_repeated_one():
    """A panning camera stops, and somebody walks on through a fifth of its picture."""
    pictures = drive_of([0, 4, 8, 8, 8])
    for step, grey in enumerate(pictures):
        grey[:, : WIDTH // 5] = as_sent(wave_picture(Warp(shift_px=(3.0 * step, 0.0)), seed=3), 9)[:, : WIDTH // 5]
    assert statuses(pictures, KLT) == ["first", *["ok"] * 4]


def test_a_plain_bright_picture_is_not_dark_but_has_no_points():
    results = follow_all([np.full((HEIGHT, WIDTH), 120, np.uint8)], KLT)
    assert results[0][1] == FrameStatus.first
    assert len(results[0][0].track_id) == 0


@both_trackers
def test_track_numbers_are_never_given_out_twice(config):
    """Over cuts, darkness and copies: a number that has gone does not come back."""
    pictures = []
    for scene in range(4):
        for step in range(3):
            grey = wave_picture(Warp(shift_px=(6.0 * step, 0.0)), seed=scene)
            pictures.append(grey if scene % 2 == 0 else bright(grey))
        pictures.append(pictures[-1])
        pictures.append(BLACK)
    last_seen, order = {}, []
    for index, (points, status) in enumerate(follow_all(pictures, config)):
        if status in (FrameStatus.dark, FrameStatus.duplicate):
            continue
        order.append(index)
        for number in points.track_id.tolist():
            assert last_seen.get(number, index) in (index, *order[-2:-1])
            last_seen[number] = index
    assert len(order) == 12


@both_trackers
def test_nothing_is_tracked_where_the_mask_forbids(config):
    allowed = np.full((HEIGHT, WIDTH), 255, np.uint8)
    allowed[100:] = 0
    pictures = [wave_picture(Warp(shift_px=(0.0, 4.0 * step))) for step in range(4)]
    for points, _ in follow_all(pictures, config, allowed):
        assert len(points.track_id) > 10
        assert (points.xy_px[:, 1] < 100).all()


def test_a_memory_of_the_other_tracker_is_refused():
    memory = follow_points(TrackerMemory(), prepare_picture(wave_picture(), None, KLT), None, KLT)[2]
    other = prepare_picture(wave_picture(Warp(scale=1.01)), None, AKAZE)
    points, _, after = follow_points(memory, other, None, KLT)
    assert len(points.track_id) > 0
    assert isinstance(after.tracks, KltMemory)


def seen_at(times_s, shown_s):
    """Points of pictures that show a step of 60 px/s at ``shown_s``, and are said to be of ``times_s``."""
    memory, points = TrackerMemory(), []
    for t_s, at_s in zip(times_s, shown_s, strict=True):
        prepared = prepare_picture(wave_picture(Warp(shift_px=(60.0 * at_s, 0.0))), None, KLT)
        found, _, memory = follow_points(memory, prepared, None, KLT, t_s=t_s)
        points.append(found)
    return points


@pytest.mark.parametrize(
    ("times_s", "shown_s"),
    [
        # Dropped pictures, and times that are wrong: 0.1 s from picture to picture in truth.
        ((0.0, 0.1, 0.2, 0.7), (0.0, 0.1, 0.2, 0.7)),
        ((0.0, 0.1, 0.101, 0.3, 0.4), (0.0, 0.1, 0.2, 0.3, 0.4)),
        ((0.0, 0.1, 0.11, 0.3, 0.9), (0.0, 0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_points_are_expected_at_their_speed_unless_the_times_are_wrong(times_s, shown_s):
    points = seen_at(times_s, shown_s)
    for (before, now), step_s in zip(pairwise(points), np.diff(shown_s), strict=True):
        _, one, other = np.intersect1d(before.track_id, now.track_id, return_indices=True)
        assert len(one) > 0.7 * len(before.track_id) * (1.0 - 60.0 * step_s / WIDTH)
        step_px = now.xy_px[other, 0] - before.xy_px[one, 0]
        assert np.mean(np.abs(step_px - 60.0 * step_s) < 0.5) > 0.9
