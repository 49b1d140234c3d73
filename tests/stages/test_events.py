"""Warnings: of what will hit us, after it has lasted, until it is over, and of nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX

from ttcvid.config import EventsConfig
from ttcvid.geometry.camera import pixels_from_rays
from ttcvid.geometry.closing import Closing
from ttcvid.model import ClusterRow, MotionState, Status
from ttcvid.stages.clusters import with_times
from ttcvid.stages.events import EventMemory, is_collision_course, restarted_events, update_events

CONFIG = EventsConfig(max_ttc_s=4.0, max_miss_widths=1.0, persistence_s=0.3)
FRAME_S = 0.05
WIDTH_M = 1.8


def row_of(position_m, velocity_m_s, cluster_id=1, relative_sigma=0.02, width_m=WIDTH_M):
    """Cluster row of a body of a given width, with its rates known to a part of their size."""
    position_m, velocity_m_s = np.asarray(position_m, float), np.asarray(velocity_m_s, float)
    abc_hz = velocity_m_s / position_m[2]
    ref_px = FOCAL_PX * position_m[:2] / position_m[2] + (CAMERA.cx_px, CAMERA.cy_px)
    half_px = 0.5 * FOCAL_PX * width_m / position_m[2]
    row = ClusterRow(
        cluster_id=cluster_id,
        motion_id=1,
        n_tracks=20,
        box_px=(ref_px[0] - half_px, ref_px[1] - half_px, ref_px[0] + half_px, ref_px[1] + half_px),
        status=Status.ok,
        epipole_status=Status.ok,
        method="consensus",
        ref_px=(float(ref_px[0]), float(ref_px[1])),
        state_abc_hz=abc_hz,
        state_cov=(relative_sigma * np.linalg.norm(abc_hz)) ** 2 * np.eye(3),
    )
    return with_times([row], CAMERA)[0]


def drive(position_m, velocity_m_s, seconds, **options):
    """Rows of a body, frame after frame, from `position_m` on; until it is at 1 m depth."""
    rows = []
    for t_s in np.arange(0.0, seconds, FRAME_S):
        now = np.asarray(position_m, float) + np.asarray(velocity_m_s, float) * t_s
        if now[2] < 1.0:
            break
        rows.append(row_of(now, velocity_m_s, **options))
    return rows


def watched(frames, config=CONFIG, memory=None, first_frame=0, closings=None):
    """Events active in each frame; a frame is a tuple of rows, or one row, or None.

    ``closings``: of each frame, how the depth of all objects changes.
    """
    memory, active = memory or EventMemory(), []
    for number, rows in enumerate(frames, first_frame):
        rows = () if rows is None else rows if isinstance(rows, tuple) else (rows,)
        closing = None if closings is None else closings[number]
        events, memory = update_events(
            memory, number, number * FRAME_S, rows, CAMERA, config, closing_of={1: closing}.get
        )
        active.append(events)
    return active, memory


def first_warned(active):
    """Frame in which the first warning stands."""
    return next((number for number, events in enumerate(active) if events), None)


HIT = ((0.0, 0.0, 30.0), (0.0, 0.0, -10.0))
HARMLESS = row_of((0.0, 0.0, 30.0), (0.0, 0.0, 8.0))
WITHOUT_STATE = ClusterRow(1, 1, 5, (0.0, 0.0, 9.0, 9.0), Status.no_parallax, Status.ok, "consensus")


def test_a_collision_course_is_warned_of_once_it_has_lasted():
    active, _ = watched(drive(*HIT, 2.5))
    # 3 s away from the start: the condition holds at once, the warning stands 0.3 s later.
    assert first_warned(active) == 6
    (event,) = active[6]
    assert (event.event_id, event.cluster_id, event.start_frame) == (1, 1, 6)
    assert event.confidence == pytest.approx(1.0)
    assert event.start_s == pytest.approx(0.3)
    assert event.kind == "constant_bearing"
    assert all(len(events) == 1 for events in active[6:])
    last = active[-1][0]
    assert last.end_frame == len(active) - 1
    assert last.min_ttc_z_s == pytest.approx((30.0 - 10.0 * last.end_s) / 10.0)
    assert last.min_tcpa_s == pytest.approx(last.min_ttc_z_s)


@pytest.mark.parametrize("first_frame", [0, 54, 131])
@pytest.mark.parametrize("n_frames", [3, 4, 6])
def test_how_long_a_condition_has_lasted_does_not_hang_on_rounding(first_frame, n_frames):
    # The difference of two rounded times falls short of the persistence by its last bit now and then, or exceeds it.
    config = CONFIG.model_copy(update={"persistence_s": n_frames * FRAME_S})
    rows = drive(*HIT, 2.0)
    assert first_warned(watched(rows, config, first_frame=first_frame)[0]) == n_frames
    # It stands until the condition has been gone for longer than that.
    warned = [*rows[: n_frames + 1], *[HARMLESS] * n_frames]
    assert watched(warned, config, first_frame=first_frame)[0][-1]


def test_a_near_miss_inside_a_width_is_a_collision_course():
    active, _ = watched(drive((1.2, 0.0, 20.0), (0.0, 0.0, -8.0), 2.0, relative_sigma=0.003))
    (event,) = active[-1]
    assert event.kind == "collision_course"
    assert event.miss_s == pytest.approx(1.2 / 8.0, rel=1e-6)
    assert (
        watched(drive((1.2, 0.0, 10.0), (0.0, 0.0, -8.0), 1.0, relative_sigma=0.003))[0][-1][0].kind
        == "collision_course"
    )


def test_it_is_not_warned_of_before_it_is_near_in_time():
    active, _ = watched(drive((0.0, 0.0, 80.0), (0.0, 0.0, -10.0), 7.0))
    # 4 s away at frame 80.
    assert first_warned(active) in (86, 87)


@pytest.mark.parametrize("widths", [3.0, 5.0])
@pytest.mark.parametrize("speed_m_s", [2.0, 20.0])
def test_a_passing_car_is_never_warned_of(widths, speed_m_s):
    start_m = (widths * WIDTH_M, 0.0, 6.0 * speed_m_s)
    active, _ = watched(drive(start_m, (0.0, 0.0, -speed_m_s), 6.0))
    assert first_warned(active) is None


@pytest.mark.parametrize(
    ("position_m", "velocity_m_s"),
    [
        ((0.0, 0.0, 10.0), (0.0, 0.0, 5.0)),
        ((0.0, 0.0, 10.0), (0.0, 0.0, -0.1)),
        ((-12.0, 0.0, 20.0), (10.0, 0.0, 0.0)),
        ((-3.0, 0.0, 10.0), (-4.0, 0.0, -4.0)),
    ],
    ids=["recedes", "near at our speed", "crosses ahead", "turns away"],
)
def test_what_does_not_come_near_is_not_warned_of(position_m, velocity_m_s):
    assert first_warned(watched(drive(position_m, velocity_m_s, 1.5))[0]) is None


@pytest.mark.parametrize("off_axis_deg", [0.0, 40.0, 60.0, 75.0])
@pytest.mark.parametrize(("miss_widths", "is_hit"), [(0.4, True), (2.0, False)])
def test_a_width_is_as_wide_through_a_fisheye_off_its_axis_as_without_a_lens(off_axis_deg, miss_widths, is_hit):
    """Off the axis a fisheye crowds a thing into few pixels."""
    fisheye = replace(CAMERA, distortion_model="fisheye", distortion=(0.0, 0.0, 0.0, 0.0))
    place = np.array([np.tan(np.radians(off_axis_deg)), 0.0, 1.0])
    across = np.array([place[2], 0.0, -place[0]]) / np.linalg.norm(place)
    half, to_us = 0.1, 0.3 * (miss_widths * 0.2 * across - place)
    row = replace(row_of(10.0 * place, 10.0 * to_us, relative_sigma=0.001), motion_state=MotionState.approaching)
    for camera in (CAMERA, fisheye):
        middle, left, right = pixels_from_rays(
            camera, place + half * np.array([[0.0], [-1.0], [1.0]]) * (1.0, 0.0, 0.0)
        )
        seen = replace(row, ref_px=tuple(middle), box_px=(left[0], left[1] - 9.0, right[0], right[1] + 9.0))
        assert is_collision_course(seen, camera, CONFIG, is_warned=False) == is_hit


@pytest.mark.parametrize(("start_m", "is_hit"), [((0.0, 5.0, 0.5), True), ((0.0, 5.0, 10.0), False)])
def test_what_goes_straight_up_shows_its_whole_width(start_m, is_hit):
    """Asked for at less than even chance: whether it comes nearer in depth is open."""
    config = EventsConfig(max_ttc_s=4.0, max_miss_widths=1.0, confidence=0.4)
    row = replace(row_of(start_m, (0.0, -5.0, 0.0), relative_sigma=0.001), motion_state=MotionState.approaching)
    assert is_collision_course(row, CAMERA, config, is_warned=False) == is_hit


@pytest.mark.parametrize(("aside_m", "is_hit"), [(4.0, True), (12.0, False)])
def test_which_end_of_a_lorry_is_the_reference_changes_nothing(aside_m, is_hit):
    """The lorry is seen from its side, 9 m long."""
    row = row_of((aside_m, 0.0, 20.0), (0.0, 0.0, -10.0), relative_sigma=0.001, width_m=9.0)
    assert row.ref_px is not None
    row = replace(row, motion_state=MotionState.approaching)
    for x_px in (row.box_px[0], row.ref_px[0], row.box_px[2]):
        seen = replace(row, ref_px=(x_px, row.ref_px[1]))
        assert is_collision_course(seen, CAMERA, CONFIG, is_warned=False) == is_hit


def test_what_reaches_beyond_a_right_angle_off_the_axis_is_wide():
    fisheye = replace(CAMERA, distortion_model="fisheye", distortion=(0.0, 0.0, 0.0, 0.0))
    place = np.array([np.tan(np.radians(60.0)), 0.0, 1.0])
    row = replace(row_of(10.0 * place, -3.0 * place, relative_sigma=0.001), motion_state=MotionState.approaching)
    x_px = CAMERA.cx_px + FOCAL_PX * np.radians([30.0, 60.0, 100.0])
    seen = replace(row, ref_px=(x_px[1], CAMERA.cy_px), box_px=(x_px[0], 0.0, x_px[2], 300.0))
    seen = with_times([seen], fisheye)[0]
    assert is_collision_course(replace(seen, motion_state=row.motion_state), fisheye, CONFIG, is_warned=False)


def test_the_same_geometry_is_judged_alike_at_two_and_at_twenty_metres_a_second():
    """A fixed miss_s would mean 0.6 m at one speed and 6 m at the other; widths mean the same."""
    for lateral_widths in (0.0, 0.5, 0.85, 1.5, 3.0):
        verdicts = {
            speed: first_warned(
                watched(
                    drive((lateral_widths * WIDTH_M, 0.0, 3.0 * speed), (0.0, 0.0, -speed), 2.0, relative_sigma=5e-4)
                )[0]
            )
            for speed in (2.0, 20.0)
        }
        assert (verdicts[2.0] is None) == (verdicts[20.0] is None) == (lateral_widths > 1.0)
    scaled = [
        [
            e.start_frame
            for events in watched(drive((s, 0.0, 30.0 * s), (0.0, 0.0, -10.0 * s), 2.5, width_m=2.0 * s))[0]
            for e in events
        ]
        for s in (1.0, 10.0)
    ]
    assert scaled[0] == scaled[1]
    assert scaled[0]


def test_what_is_not_sure_is_not_warned_of():
    assert first_warned(watched(drive(*HIT, 2.5, relative_sigma=1.0))[0]) is None


def test_a_long_bus_that_crosses_well_before_us_is_not_warned_of():
    # 12 m long, moves to the side along its length; it passes 8 m off.
    frames = drive((-4.0, 0.0, 12.0), (8.0, 0.0, -1.5), 1.5, width_m=12.0)
    assert first_warned(watched(frames)[0]) is None


def changing(row, change):
    """The row of a body whose speed may change by a part of itself soon."""
    along = change**2 * np.outer(row.state_abc_hz, row.state_abc_hz)
    return with_times([replace(row, state_cov=row.state_cov + along, speed_change=change)], CAMERA)[0]


def test_a_car_that_brakes_has_no_sure_time_and_is_warned_of_all_the_same():
    frames = [changing(row, 0.7) for row in drive(*HIT, 1.0)]
    assert not frames[0].times.ttc_z_hi_s[0] > 0.0
    assert first_warned(watched(frames)[0]) == 6
    aside = [changing(row, 0.7) for row in drive((5.4, 0.0, 30.0), HIT[1], 1.0)]
    assert first_warned(watched(aside)[0]) is None


def braking_from_behind(acceleration_sigma_hz2, range_m=16.0, braking_m_s2=5.0, seconds=1.5, aside_m=0.0):
    """Rows of a car at our own speed that has just begun to brake, and the acceleration that its picture shows."""
    rows, closings = [], []
    for t_s in np.arange(FRAME_S, seconds, FRAME_S):
        z_m, speed_m_s = range_m - 0.5 * braking_m_s2 * t_s**2, braking_m_s2 * t_s
        cov = np.diag([0.02, acceleration_sigma_hz2]) ** 2
        rows.append(row_of((aside_m, 0.0, z_m), (0.0, 0.0, -speed_m_s)))
        closings.append(Closing(-speed_m_s / z_m, -braking_m_s2 / z_m, cov))
    return rows, closings


def test_a_car_that_has_just_begun_to_brake_is_warned_of_by_its_acceleration_where_that_is_sure():
    """At constant velocity 4 s are left 0.78 s after it began to; its brakes tell 0.4 s earlier."""
    rows, closings = braking_from_behind(0.05)
    _, unsure = braking_from_behind(0.3)
    assert first_warned(watched(rows)[0]) == 20
    assert first_warned(watched(rows, closings=closings)[0]) < 13
    assert first_warned(watched(rows, closings=unsure)[0]) == 20


def test_an_acceleration_is_not_taken_to_last_for_ever():
    """At 40 m it would be reached in 4 s by going on as now; nobody knows that it does."""
    rows, closings = braking_from_behind(0.02, range_m=40.0, seconds=0.5)
    assert closings[0].contact_s(9.0) < 4.0 < closings[-1].contact_s(1.0)
    assert first_warned(watched(rows, closings=closings)[0]) is None


def test_a_car_that_brakes_beside_our_way_is_not_warned_of():
    rows, closings = braking_from_behind(0.02, aside_m=5.4)
    assert first_warned(watched(rows, closings=closings)[0]) is None


def low_part(offset_m, z_m=15.0):
    """Row of the legs of somebody 0.5 m wide who stands on the road, 1.5 m below us, and comes straight at us."""
    row = row_of((offset_m, 1.0, z_m), (0.0, 0.0, -8.0), width_m=0.5)
    x_px, y_px = row.ref_px
    half_px, low_px = 0.25 * FOCAL_PX / z_m, 0.5 * FOCAL_PX / z_m
    return replace(row, box_px=(x_px - half_px, y_px - low_px, x_px + half_px, y_px + low_px))


def is_course(row, **options):
    """Whether a row is on collision course."""
    return is_collision_course(row, CAMERA, CONFIG, is_warned=False, **options)


def test_what_passes_below_the_camera_on_the_road_hits_our_car():
    """Of somebody who walks onto the road only the legs may be told from the background; an aircraft passes below."""
    assert is_course(low_part(0.0), on_ground=True)
    assert not is_course(low_part(0.0))
    assert not is_course(low_part(2.5), on_ground=True)


def side_of_lorry(offset_m, z_m=30.0, length_m=9.0):
    """Row of a lorry that shows its side, and whose middle passes us by ``offset_m``; our camera is 1.5 m high."""
    row = row_of((offset_m, 0.0, z_m), (0.0, 0.0, -10.0), width_m=length_m, relative_sigma=0.005)
    x_px, y_px = row.ref_px
    half_px, foot_px = 0.5 * length_m * FOCAL_PX / z_m, 1.5 * FOCAL_PX / z_m
    return replace(row, box_px=(x_px - half_px, y_px - foot_px, x_px + half_px, y_px + foot_px))


def test_on_the_road_half_a_lorry_and_half_our_width_are_what_it_must_not_come_closer_by():
    assert is_course(side_of_lorry(4.5 + 0.9), on_ground=True)
    assert not is_course(side_of_lorry(4.5 + 3.9), on_ground=True)
    # Where nothing tells how large it is, its own width has to do.
    assert is_course(side_of_lorry(4.5 + 3.9))


def test_a_small_thing_on_the_road_is_judged_by_its_width_as_before():
    for offset_m in (0.0, 1.2, 1.6, 2.2, 3.5):
        row = row_of((offset_m, 0.0, 20.0), (0.0, 0.0, -10.0), relative_sigma=0.005)
        assert is_course(row, on_ground=True) == is_course(row)


def test_a_short_blip_is_not_warned_of():
    hit = drive(*HIT, 2.5)
    for n_frames in (1, 3, 5):
        frames = [HARMLESS] * 5 + hit[5 : 5 + n_frames] + [HARMLESS] * 20
        assert first_warned(watched(frames)[0]) is None


def test_blips_that_come_again_do_not_add_up():
    hit = drive(*HIT, 2.5)
    frames = [row if i % 5 else HARMLESS for i, row in enumerate(hit)]
    assert first_warned(watched(frames)[0]) is None


def warned_at_s(times_s, step_s):
    """Times at which a body that will hit us is warned of, looked at at these times and usually every `step_s`."""
    memory, warned = EventMemory(), []
    for frame, t_s in enumerate(times_s):
        row = row_of(np.asarray(HIT[0]) + np.asarray(HIT[1]) * t_s, HIT[1])
        events, memory = update_events(memory, frame, t_s, (row,), CAMERA, CONFIG, step_s=step_s)
        warned += [t_s] if events else []
    return warned


@pytest.mark.parametrize("step_s", [1.0, 0.5, 1.0 / 3.0, 0.2])
def test_what_is_looked_at_seldom_is_warned_of_at_the_first_look_after_the_persistence(step_s):
    times_s = np.arange(0.0, 2.4, step_s)
    assert warned_at_s(times_s, step_s) == [t_s for t_s in times_s if t_s >= CONFIG.persistence_s]


def test_what_was_not_looked_at_for_longer_than_usual_has_not_persisted():
    assert warned_at_s([0.0, 0.1, 0.2, 0.6, 0.7, 0.8, 0.95, 1.0], 0.1) == [0.95, 1.0]


def test_a_warning_outlives_a_short_gap_and_keeps_its_number():
    hit = drive(*HIT, 2.5)
    frames = [*hit[:20], HARMLESS, None, HARMLESS, *hit[23:]]
    active, _ = watched(frames)
    assert {e.event_id for events in active for e in events} == {1}
    assert all(len(events) == 1 for events in active[6:])
    assert active[22][0].end_frame == 19
    assert active[23][0].end_frame == 23


def test_a_warning_stands_on_what_is_a_little_beyond_the_threshold():
    """Hysteresis: one and a half times the miss distance would not start a warning, but keeps one."""
    beyond = row_of((1.25 * WIDTH_M, 0.0, 18.0), (0.0, 0.0, -10.0), relative_sigma=0.005)
    far_beyond = row_of((1.8 * WIDTH_M, 0.0, 18.0), (0.0, 0.0, -10.0), relative_sigma=0.005)
    hit = drive(*HIT, 1.0)
    assert first_warned(watched([beyond] * 30)[0]) is None
    assert len(watched(hit + [beyond] * 30)[0][-1]) == 1
    assert watched(hit + [far_beyond] * 30)[0][-1] == ()
    slower = row_of((0.0, 0.0, 46.0), (0.0, 0.0, -10.0))
    assert first_warned(watched([slower] * 30)[0]) is None
    assert len(watched(hit + [slower] * 30)[0][-1]) == 1


@pytest.mark.parametrize(
    ("after", "n_frames"), [(HARMLESS, 6), (None, 18), (WITHOUT_STATE, 18)], ids=["harmless", "hidden", "no value"]
)
def test_a_warning_ends_when_it_is_over_and_later_when_what_it_is_of_is_hidden(after, n_frames):
    """After as long as it took to start, or three times as long."""
    hit = drive(*HIT, 1.0)
    active, _ = watched(hit + [after] * 30)
    n_after = sum(bool(events) for events in active[len(hit) :])
    assert n_after in (n_frames - 1, n_frames)
    last = [e for events in active for e in events][-1]
    assert last.end_frame == len(hit) - 1
    assert last.end_s == pytest.approx((len(hit) - 1) * FRAME_S)


def test_a_frame_without_a_value_is_not_the_end_of_what_persists():
    hit = drive(*HIT, 1.0)
    assert first_warned(watched([*hit[:3], WITHOUT_STATE, *hit[4:]])[0]) == 6
    assert first_warned(watched([*hit[:3], HARMLESS, *hit[4:]])[0]) == 10


def test_what_comes_out_behind_a_post_with_another_number_is_warned_of_at_once():
    before, after = drive(*HIT, 1.0), drive((0.1, 0.0, 19.0), (0.0, 0.0, -10.0), 0.5, cluster_id=5)
    active, _ = watched([*before, None, None, *after])
    assert [(e.event_id, e.cluster_id) for e in active[len(before) + 1]] == [(1, 1)]
    assert [(e.event_id, e.cluster_id) for e in active[len(before) + 2]] == [(2, 5)]


def test_another_thing_that_appears_elsewhere_has_to_persist_by_itself():
    before, after = drive(*HIT, 1.0), drive((4.0, 0.0, 19.0), (-2.1, 0.0, -10.0), 0.5, cluster_id=5)
    active, _ = watched([*before, None, None, *after])
    assert [e.cluster_id for e in active[len(before) + 2]] == [1]
    assert [e.cluster_id for e in active[len(before) + 2 + 6]] == [1, 5]


def test_both_numbers_are_watched_while_both_are_there():
    one = drive(*HIT, 1.0)
    other = [None] * 8 + drive((0.1, 0.0, 26.0), (0.0, 0.0, -10.0), 0.6, cluster_id=5)
    frames = [tuple(row for row in pair if row is not None) for pair in zip(one, other, strict=True)]
    active, _ = watched(frames)
    assert [e.cluster_id for e in active[13]] == [1]
    assert [e.cluster_id for e in active[14]] == [1, 5]


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
    memory = restarted_events(memory)
    active, _ = watched(hit, memory=memory, first_frame=100)
    assert active[0] == ()
    assert [e.event_id for e in active[-1]] == [2]


def test_confidence_is_the_probability_of_the_approach_and_as_high_as_asked_for():
    """A harder confidence warns of less: an approach known to 30 % is sure at 95 % but not at 99.99 %."""
    hit = drive(*HIT, 1.5, relative_sigma=0.3, width_m=8.0)
    wide = CONFIG.model_copy(update={"max_miss_widths": 100.0})
    active, _ = watched(hit, wide)
    assert first_warned(active) == 6
    # The rate is 1 / 0.3 of its standard deviations away from none.
    assert active[6][0].confidence == pytest.approx(0.99957, abs=1e-5)
    assert first_warned(watched(hit, wide.model_copy(update={"confidence": 0.9999}))[0]) is None


def test_rows_without_a_state_are_left_alone():
    assert first_warned(watched([WITHOUT_STATE] * 10)[0]) is None


def standing(width_m, height_m, ref_below_m, centre_below_m, position_m=(0.0, 0.0, 16.0)):
    """Row of an upright thing that comes straight on, its reference point and its middle so far below the camera."""
    x_m, _, z_m = position_m
    row = row_of((x_m, ref_below_m, z_m), (0.0, 0.0, -8.0), relative_sigma=0.003)
    half_px = 0.5 * FOCAL_PX / z_m * np.array([width_m, height_m])
    centre_px = FOCAL_PX / z_m * np.array([x_m, centre_below_m]) + (CAMERA.cx_px, CAMERA.cy_px)
    return replace(row, box_px=(*(centre_px - half_px).tolist(), *(centre_px + half_px).tolist()))


def test_a_thing_is_hit_over_its_whole_height():
    # Somebody 1.75 m tall, 0.6 m wide, whose feet are seen best, 1.4 m below the camera.
    walker = standing(0.6, 1.75, ref_below_m=1.3, centre_below_m=0.53)
    assert is_collision_course(walker, CAMERA, CONFIG, is_warned=False)
    beside = standing(0.6, 1.75, ref_below_m=1.3, centre_below_m=0.53, position_m=(1.2, 0.0, 16.0))
    assert not is_collision_course(beside, CAMERA, CONFIG, is_warned=False)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_what_ends_far_below_or_begins_far_above_is_not_hit(side):
    assert not is_collision_course(standing(0.6, 0.4, 1.5 * side, 1.5 * side), CAMERA, CONFIG, is_warned=False)
