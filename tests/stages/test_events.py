"""Warnings in time: after a danger has lasted, until it is over, with one number each."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import CAMERA
from watched_rows import CONFIG, FRAME_S, HARMLESS, HIT, WIDTH_M, WITHOUT_STATE, drive, first_warned, row_of, watched

from ttcvid.model import SCENE_MOTION, MotionState
from ttcvid.stages.segmentation.own_turn import OwnBend
from ttcvid.stages.segmentation.road import Road
from ttcvid.stages.warnings.course import Viewpoint
from ttcvid.stages.warnings.events import EventMemory, update_events


def test_a_collision_course_is_warned_of_once_it_has_lasted():
    active, _ = watched(drive(*HIT, 2.5))
    # 3 s away from the start: the condition holds at once, the warning stands 0.35 s later.
    assert first_warned(active) == 7
    (event,) = active[7]
    assert (event.event_id, event.cluster_id, event.start_frame) == (1, 1, 7)
    assert event.confidence == pytest.approx(1.0)
    assert event.start_s == pytest.approx(0.35)
    assert event.kind == "constant_bearing"
    assert all(len(events) == 1 for events in active[8:])
    last = active[-1][0]
    assert last.end_frame == len(active) - 1
    assert last.min_ttc_z_s == pytest.approx((30.0 - 10.0 * last.end_s) / 10.0)
    assert last.min_tcpa_s == pytest.approx(last.min_ttc_z_s)


@pytest.mark.parametrize("first_frame", [54, 131])
@pytest.mark.parametrize("n_frames", [3, 4, 6])
def test_what_is_gathered_does_not_hang_on_rounding(first_frame, n_frames):
    config = CONFIG.model_copy(update={"persistence_s": n_frames * FRAME_S})
    rows = drive(*HIT, 2.0) + [HARMLESS] * 10
    at_first, later = (watched(rows, config, first_frame=number)[0] for number in (0, first_frame))
    assert [len(events) for events in at_first] == [len(events) for events in later]


def test_a_short_blip_is_not_warned_of():
    hit = drive(*HIT, 2.5)
    for n_frames in (1, 2, 3):
        frames = [HARMLESS] * 5 + hit[5 : 5 + n_frames] + [HARMLESS] * 20
        assert first_warned(watched(frames)[0]) is None


def test_frames_that_speak_against_it_count_as_much_as_those_that_speak_for_it():
    hit = drive(*HIT, 2.5)
    half, most = ([row if i % every else HARMLESS for i, row in enumerate(hit)] for every in (2, 5))
    assert first_warned(watched(half)[0]) is None
    assert first_warned(watched(most)[0]) > first_warned(watched(hit)[0])


def warned_at_s(times_s, step_s):
    """Times at which a body that will hit us is warned of, looked at at these times and usually every `step_s`."""
    memory, warned = EventMemory(), []
    for frame, t_s in enumerate(times_s):
        row = row_of(np.asarray(HIT[0]) + np.asarray(HIT[1]) * t_s, HIT[1])
        events, memory = update_events(memory, frame, t_s, (row,), Viewpoint(CAMERA), CONFIG, step_s=step_s)
        warned += [t_s] if events else []
    return warned


@pytest.mark.parametrize("step_s", [1.0, 0.5, 1.0 / 3.0, 0.2])
def test_what_is_looked_at_seldom_is_warned_of_at_the_first_look_after_the_persistence(step_s):
    times_s = np.arange(0.0, 2.4, step_s)
    assert warned_at_s(times_s, step_s) == [t_s for t_s in times_s if t_s >= CONFIG.persistence_s]


def test_a_gap_longer_than_the_persistence_counts_for_nothing():
    assert warned_at_s([0.0, 0.1, 0.2, 0.6, 0.7, 0.8, 0.95, 1.0], 0.1) == [0.8, 0.95, 1.0]


def test_a_warning_outlives_a_short_gap_and_keeps_its_number():
    hit = drive(*HIT, 2.5)
    frames = [*hit[:20], HARMLESS, None, HARMLESS, *hit[23:]]
    active, _ = watched(frames)
    assert {e.event_id for events in active for e in events} == {1}
    assert all(len(events) == 1 for events in active[8:])
    assert active[22][0].end_frame == 19
    assert active[23][0].end_frame == 23


def test_a_warning_starts_at_one_probability_and_ends_at_another():
    """Even odds start none, and end none: a miss by just the limit, or by a little more than the limit of the time."""
    even, beyond = (
        row_of((widths * WIDTH_M, 0.0, 18.0), (0.0, 0.0, -10.0), relative_sigma=0.005) for widths in (1.0, 1.25)
    )
    hit = drive(*HIT, 1.0)
    assert first_warned(watched([even] * 30)[0]) is None
    assert len(watched(hit + [even] * 30)[0][-1]) == 1
    assert watched(hit + [beyond] * 30)[0][-1] == ()
    slower = row_of((0.0, 0.0, 46.0), (0.0, 0.0, -10.0))
    assert first_warned(watched([slower] * 30)[0]) is None
    assert len(watched(hit + [slower] * 30)[0][-1]) == 1


@pytest.mark.parametrize(
    ("after", "n_frames"), [(HARMLESS, 6), (None, 18), (WITHOUT_STATE, 18)], ids=["harmless", "hidden", "no value"]
)
def test_a_warning_ends_when_it_is_over_and_later_when_what_it_is_of_is_hidden(after, n_frames):
    hit = drive(*HIT, 1.0)
    active, _ = watched(hit + [after] * 30)
    n_after = sum(bool(events) for events in active[len(hit) :])
    assert n_after == n_frames
    last = [e for events in active for e in events][-1]
    assert last.end_frame == len(hit) - 1
    assert last.end_s == pytest.approx((len(hit) - 1) * FRAME_S)


def test_a_frame_in_which_it_is_hidden_or_without_a_value_is_not_the_end_of_what_is_gathered():
    hit = drive(*HIT, 1.0)
    assert first_warned(watched([*hit[:3], None, *hit[4:]])[0]) == 8
    assert first_warned(watched([*hit[:3], WITHOUT_STATE, *hit[4:]])[0]) == 7
    assert first_warned(watched([*hit[:3], HARMLESS, *hit[4:]])[0]) > 8


UNKNOWN = replace(drive(*HIT, 0.1)[0], motion_state=MotionState.unknown)
"""Where it goes is open."""


@pytest.mark.parametrize("is_open", [UNKNOWN, WITHOUT_STATE], ids=["unknown", "no value"])
def test_frames_in_which_it_is_open_where_a_thing_goes_say_nothing_by_themselves(is_open):
    hit = drive(*HIT, 2.5)
    # Three times the persistence at the most: then all begins anew.
    assert first_warned(watched([*hit[:2], *[is_open] * 20, *hit[22:]])[0]) in (29, 30)
    # Nor do two frames far apart.
    assert first_warned(watched([*hit[:2], *[is_open] * 8])[0]) is None
    assert first_warned(watched([hit[0], *[is_open] * 6, hit[7], *[is_open] * 6])[0]) is None


@pytest.mark.parametrize("is_open", [UNKNOWN, WITHOUT_STATE], ids=["unknown", "no value"])
def test_a_warning_ends_sooner_where_harmless_frames_speak_for_open_ones(is_open):
    hit = drive(*HIT, 1.0)
    active, _ = watched(hit + [is_open, HARMLESS] * 15)
    assert sum(bool(events) for events in active[len(hit) :]) == 5


def test_open_frames_before_a_thing_was_hidden_are_not_spoken_for():
    hit = drive(*HIT, 2.5)
    hidden = [*hit[:2], *[UNKNOWN] * 4, *[None] * 8, *hit[14:]]
    assert first_warned(watched(hidden)[0]) == first_warned(watched([*hit[:2], *[None] * 12, *hit[14:]])[0])


def test_frames_without_a_road_are_not_spoken_for():
    """What stands is not known to be in our way there; where it goes is known."""
    standing = [replace(row, motion_id=SCENE_MOTION) for row in drive(*HIT, 2.5)]
    memory, n_events = EventMemory(), 0
    for frame, row in enumerate(standing[:38]):
        road = Road(np.array([0.0, 0.0, 10.0])) if frame % 4 == 0 else None
        bend = OwnBend(heading=np.array([0.0, 0.0, 1.0]), turn_rad_s=0.0, road=road)
        events, memory = update_events(
            memory, frame, frame * FRAME_S, (row,), Viewpoint(CAMERA, on_ground=True, bend=bend), CONFIG
        )
        n_events += len(events)
    assert n_events == 0


@pytest.mark.parametrize("is_open", [UNKNOWN, WITHOUT_STATE], ids=["unknown", "no value"])
def test_the_next_frame_speaks_for_open_ones_up_to_half_a_persistence(is_open):
    """It takes seven frames where each tells. A thing that is hidden was not seen."""
    hit = drive(*HIT, 2.5)
    by_turns = [row if frame % 2 == 0 else is_open for frame, row in enumerate(hit)]
    assert first_warned(watched(by_turns)[0]) == 8
    assert first_warned(watched([*hit[:2], *[is_open] * 8, *hit[10:]])[0]) == 13
    assert first_warned(watched([*hit[:2], *[None] * 8, *hit[10:]])[0]) == 15


def test_the_next_frame_speaks_for_open_ones_of_what_gets_another_number_too():
    before, after = drive(*HIT, 2.5), drive(*HIT, 2.5, cluster_id=5)
    assert first_warned(watched([*before[:2], *[UNKNOWN] * 8, *after[10:]])[0]) == 13


def test_what_is_not_surely_going_to_hit_us_takes_longer():
    """Its best estimate is a hit, or a miss, by a little."""
    hit, likely = drive(*HIT, 2.5), row_of((0.9 * WIDTH_M, 0.0, 25.0), (0.0, 0.0, -10.0))
    likely_miss = row_of((1.1 * WIDTH_M, 0.0, 25.0), (0.0, 0.0, -10.0))
    assert first_warned(watched([likely] * 30)[0]) is None
    assert first_warned(watched([*hit[:3], *[likely] * 3, *hit[6:]])[0]) > 9
    assert first_warned(watched([*hit[:3], *[likely_miss] * 3, *hit[6:]])[0]) > 9


def test_what_comes_out_behind_a_post_with_another_number_is_warned_of_at_once():
    before, after = drive(*HIT, 1.0), drive((0.1, 0.0, 19.0), (0.0, 0.0, -10.0), 0.5, cluster_id=5)
    active, _ = watched([*before, None, None, *after])
    assert [(e.event_id, e.cluster_id) for e in active[len(before) + 1]] == [(1, 1)]
    assert [(e.event_id, e.cluster_id) for e in active[len(before) + 2]] == [(2, 5)]


def test_what_comes_back_with_a_smaller_number_is_not_warned_of_twice():
    before, after = drive(*HIT, 1.0, cluster_id=5), drive((0.1, 0.0, 19.0), (0.0, 0.0, -10.0), 0.5, cluster_id=1)
    active, _ = watched([*before, None, None, *after])
    assert [(e.event_id, e.cluster_id) for e in active[len(before) + 2]] == [(2, 1)]


def test_another_thing_that_appears_elsewhere_has_to_persist_by_itself():
    before, after = drive(*HIT, 1.0), drive((4.0, 0.0, 19.0), (-2.1, 0.0, -10.0), 0.5, cluster_id=5)
    active, _ = watched([*before, None, None, *after])
    assert [e.cluster_id for e in active[len(before) + 2]] == [1]
    assert [e.cluster_id for e in active[len(before) + 2 + 7]] == [1, 5]


def test_both_numbers_are_watched_while_both_are_there():
    one = drive(*HIT, 1.0)
    other = [None] * 8 + drive((0.1, 0.0, 26.0), (0.0, 0.0, -10.0), 0.6, cluster_id=5)
    frames = [tuple(row for row in pair if row is not None) for pair in zip(one, other, strict=True)]
    active, _ = watched(frames)
    assert [e.cluster_id for e in active[11]] == [1]
    assert [e.cluster_id for e in active[15]] == [1, 5]


def test_a_second_approach_is_a_second_warning():
    hit = drive(*HIT, 1.0)
    active, _ = watched([*hit, *[HARMLESS] * 10, *hit])
    assert [e.event_id for e in active[19]] == [1]
    assert [e.event_id for e in active[-1]] == [2]


def test_warnings_of_two_objects_count_on_and_stand_side_by_side():
    one, other = drive(*HIT, 2.0), drive((0.5, 0.0, 25.0), (-0.2, 0.0, -10.0), 2.0, cluster_id=7)
    frames = [(one[i],) if i < 4 else (one[i], other[i]) for i in range(len(one))]
    active, _ = watched(frames)
    assert [(e.event_id, e.cluster_id) for e in active[-1]] == [(1, 1), (2, 7)]


def test_a_cut_ends_all_warnings_but_gives_no_number_twice():
    hit = drive(*HIT, 1.0)
    _, memory = watched(hit)
    memory = EventMemory(next_event_id=memory.next_event_id)
    active, _ = watched(hit, memory=memory, first_frame=100)
    assert active[0] == ()
    assert [e.event_id for e in active[-1]] == [2]


def test_rows_without_a_state_are_left_alone():
    assert first_warned(watched([WITHOUT_STATE] * 10)[0]) is None


@pytest.mark.parametrize("confidence", [0.6, 0.8, 0.95, 0.99, 0.999])
@pytest.mark.parametrize("persistence_s", [0.1, 0.25, 1.0, 2.0])
def test_what_surely_hits_us_is_warned_of_with_any_confidence_and_persistence(confidence, persistence_s):
    config = CONFIG.model_copy(update={"confidence": confidence, "persistence_s": persistence_s})
    first = first_warned(watched(drive((0.0, 0.0, 39.0), (0.0, 0.0, -10.0), 3.8, relative_sigma=0.005), config)[0])
    assert first is not None
    assert first * FRAME_S < 1.6 * persistence_s + 3 * FRAME_S
