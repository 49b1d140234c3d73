"""All stages together on pictures: darkness, doubled pictures, cuts, masks, burned-in text."""

from functools import cache

import cv2
import numpy as np
import pytest
from moving_clips import HEIGHT, WIDTH, approach, swaying
from pipeline_runs import PICTURE_CAMERA, assert_same, has_no_numbers, results_of, scene_row, statuses

from ttcvid.config import EgomotionConfig, PipelineConfig, TrackingConfig
from ttcvid.model import Frame, Platform


def pictures_of(pictures, dt_s=0.1):
    return [Frame(index, index * dt_s, grey=grey) for index, grey in enumerate(pictures)]


SMALL = PipelineConfig(tracking=TrackingConfig(max_tracks=120))
AHEAD = SMALL.model_copy(update={"egomotion": EgomotionConfig(platform=Platform.vehicle)})


@cache
def approach_run():
    return results_of(pictures_of(approach(10)), PICTURE_CAMERA, AHEAD)


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
    results = results_of(pictures_of(clip), PICTURE_CAMERA, AHEAD)
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
    results = results_of(pictures_of([*approach(5), *other]), PICTURE_CAMERA, AHEAD)
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
    ahead = results_of(frames, PICTURE_CAMERA, AHEAD, map_ahead=lambda work, items: iter([work(i) for i in items]))
    assert_same(ahead, approach_run())


def test_text_burned_into_the_pictures_belongs_to_nothing():
    """A station's logo: corners that never move look like constant bearing, and must not warn of anything."""
    clip, rng = [grey.copy() for grey in swaying(34)], np.random.default_rng(0)
    for grey in clip:
        grey[6:26, 6:76] = 20
        cv2.putText(grey, "TTC 42", (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 250, 1)
        # As a codec sends it. What it copies instead is no observation, and belongs to nothing, too.
        grey[6:26, 6:76] += rng.integers(0, 3, (20, 70), dtype=np.uint8)
    last = results_of(pictures_of(clip), PICTURE_CAMERA, SMALL)[-1]
    x, y = last.tracks.xy_px.T
    on_text = (x > 7) & (x < 75) & (y > 8) & (y < 25) & (last.tracks.n_frames > 25)
    assert np.count_nonzero(on_text) >= 4
    # A window at the rim of the logo sees what sways behind it, too.
    assert (last.tracks.cluster_id[on_text] == -1).mean() > 0.7
    assert (last.tracks.cluster_id[on_text] <= 0).all()
    assert last.events == ()
