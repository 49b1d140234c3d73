"""What a run says of a clip whose pictures repeat."""

import numpy as np
import pytest
from frame_results import no_tracks

from ttcvid.jobs.runs.provenance import Tally
from ttcvid.model import FrameResult, FrameStatus


def tally_of(is_repeated, dt_s=0.04, moving=FrameStatus.ok):
    """Of frames ``dt_s`` apart, each repeated or not."""
    tally, last_s = Tally(), None
    for frame, again in enumerate(is_repeated):
        t_s = frame * dt_s
        status = FrameStatus.duplicate if again else moving if frame else FrameStatus.first
        tally.add(FrameResult(frame, t_s, None if last_s is None else t_s - last_s, status, no_tracks(), ()))
        if not again:
            last_s = t_s
    return tally


def test_a_clip_whose_every_fifth_picture_repeats_is_said_to_be_off_by_a_quarter():
    complaint = tally_of([False, False, False, False, True] * 60).complaint_about_repeats()
    assert complaint.startswith("60 of 300 pictures repeat the one before, at uneven distances")
    assert "by 25 %" in complaint
    assert "\n" not in complaint


@pytest.mark.parametrize("n_frames", range(298, 306))
def test_24_pictures_a_second_sent_as_60_are_noticed_wherever_the_clip_ends(n_frames):
    film = ([False, True, False, True, True] * 61)[:n_frames]
    assert "by " in tally_of(film, dt_s=1.0 / 60.0).complaint_about_repeats()


@pytest.mark.parametrize("is_repeated", [[False] * 60, [False, True] * 30, [False] * 30 + [True] + [False] * 29])
def test_a_clip_whose_pictures_repeat_evenly_or_hardly_ever_is_right(is_repeated):
    assert tally_of(is_repeated).complaint_about_repeats() == ""


def test_pictures_of_a_clip_in_which_nothing_moves_may_repeat_as_they_like():
    is_repeated = [False, False, True, False, True, True, False, False, False, True] * 6
    assert tally_of(is_repeated, moving=FrameStatus.rotation_only).complaint_about_repeats() == ""
    assert tally_of(is_repeated, moving=FrameStatus.ok).complaint_about_repeats() != ""


def test_times_that_stand_still_or_run_back_are_told():
    tally = Tally()
    for frame, t_s in enumerate([0.0, 0.1, 0.1, 0.2]):
        status = FrameStatus.bad_dt if frame == 2 else FrameStatus.ok
        tally.add(FrameResult(frame, t_s, None, status, no_tracks(), ()))
    assert tally.complaint_about_times().startswith("1 of 4 frames have a time that is not later")
    assert tally_of([False] * 5).complaint_about_times() == ""


def test_uneven_times_without_repeated_pictures_are_right():
    rng, t_s, tally = np.random.default_rng(1), 0.0, Tally()
    for frame in range(60):
        step_s = rng.choice([0.04, 0.08])
        t_s += step_s
        status = FrameStatus.ok if frame else FrameStatus.first
        tally.add(FrameResult(frame, t_s, step_s if frame else None, status, no_tracks(), ()))
    assert tally.complaint_about_repeats() == ""


def test_times_in_milliseconds_are_told():
    assert "in seconds?" in tally_of([False] * 20, dt_s=50.0).complaint_about_times()
    assert tally_of([False] * 20, dt_s=1.0).complaint_about_times() == ""


@pytest.mark.parametrize(("n_unseen", "is_told"), [(10, False), (11, True)])
@pytest.mark.parametrize("status", [FrameStatus.few_tracks, FrameStatus.dark])
def test_a_clip_most_of_which_shows_too_little_is_told(n_unseen, is_told, status):
    tally = Tally()
    for frame in range(20):
        shown = status if frame < n_unseen else FrameStatus.ok
        tally.add(FrameResult(frame, 0.1 * frame, 0.1, shown, no_tracks(), ()))
    assert bool(tally.complaint_about_sight()) == is_told
