"""What is on collision course: what will hit us, soon and surely, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from relative_motion import CAMERA, FOCAL_PX
from scipy.special import ndtr
from watched_rows import CONFIG, FRAME_S, HIT, WIDTH_M, drive, first_warned, row_of, watched

from ttcvid.config import EventsConfig
from ttcvid.geometry.camera.pinhole import pixels_from_rays
from ttcvid.model import SCENE_MOTION, MotionState
from ttcvid.stages.objects.clusters import with_times
from ttcvid.stages.segmentation.own_turn import OwnBend
from ttcvid.stages.segmentation.road import Road
from ttcvid.stages.warnings.course import Viewpoint, course_of


def is_course(row, camera=CAMERA, config=CONFIG, **known):
    """Whether a row is on collision course with the probability that a warning asks for."""
    course = course_of(row, Viewpoint(camera, **known), config)
    return course is not None and course.probability >= config.confidence


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
    # 4 s away at frame 80; it came at us all the while before.
    assert first_warned(active) in (80, 81)


def test_what_comes_later_than_it_is_warned_of_is_watched_until_its_time_has_run_down():
    soon, later, never = (row_of((0.0, 0.0, z_m), (0.0, 0.0, -10.0), relative_sigma=0.01) for z_m in (39.0, 46.0, 70.0))
    assert first_warned(watched([later] * 30)[0]) is None
    assert first_warned(watched([later] * 10 + [soon] * 10)[0]) < 12
    assert first_warned(watched([never] * 10 + [soon] * 10)[0]) > 13


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
        assert is_course(seen, camera) == is_hit


@pytest.mark.parametrize(("start_m", "is_hit"), [((0.0, 5.0, 0.5), True), ((0.0, 5.0, 10.0), False)])
def test_what_goes_straight_up_shows_its_whole_width(start_m, is_hit):
    """Asked for at less than even chance: whether it comes nearer in depth is open."""
    config = EventsConfig(max_ttc_s=4.0, max_miss_widths=1.0, confidence=0.4)
    row = replace(row_of(start_m, (0.0, -5.0, 0.0), relative_sigma=0.001), motion_state=MotionState.approaching)
    assert is_course(row, config=config) == is_hit


@pytest.mark.parametrize(("aside_m", "is_hit"), [(4.0, True), (12.0, False)])
def test_which_end_of_a_lorry_is_the_reference_changes_nothing(aside_m, is_hit):
    """The lorry is seen from its side, 9 m long."""
    row = row_of((aside_m, 0.0, 20.0), (0.0, 0.0, -10.0), relative_sigma=0.001, width_m=9.0)
    assert row.ref_px is not None
    row = replace(row, motion_state=MotionState.approaching)
    for x_px in (row.box_px[0], row.ref_px[0], row.box_px[2]):
        seen = replace(row, ref_px=(x_px, row.ref_px[1]))
        assert is_course(seen) == is_hit


def test_what_reaches_beyond_a_right_angle_off_the_axis_is_wide():
    fisheye = replace(CAMERA, distortion_model="fisheye", distortion=(0.0, 0.0, 0.0, 0.0))
    place = np.array([np.tan(np.radians(60.0)), 0.0, 1.0])
    row = replace(row_of(10.0 * place, -3.0 * place, relative_sigma=0.001), motion_state=MotionState.approaching)
    x_px = CAMERA.cx_px + FOCAL_PX * np.radians([30.0, 60.0, 100.0])
    seen = replace(row, ref_px=(x_px[1], CAMERA.cy_px), box_px=(x_px[0], 0.0, x_px[2], 300.0))
    seen = with_times([seen], fisheye)[0]
    assert is_course(replace(seen, motion_state=row.motion_state), fisheye)


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


def test_one_look_alone_warns_of_nothing():
    slow = CONFIG.model_copy(update={"persistence_s": FRAME_S})
    row = row_of((0.0, 0.0, 16.0), (0.0, 0.0, -5.0), relative_sigma=0.001)
    assert first_warned(watched([row] * 2, slow)[0]) == 1


def test_a_car_that_has_just_begun_to_brake_is_warned_of_by_its_time_at_constant_velocity():
    """At our own speed, 16 m ahead, with 5 m/s^2: 0.8 s after it began, of 2.53 s until the contact."""
    t_s = np.arange(FRAME_S, 1.5, FRAME_S)
    rows = [row_of((0.0, 0.0, 16.0 - 2.5 * t**2), (0.0, 0.0, -5.0 * t)) for t in t_s]
    assert first_warned(watched(rows)[0]) == 16


def slowing(deceleration_m_s2, ahead_m=20.0, speed_m_s=8.0, jitter=0.0, seconds=1.6):
    """Rows of what stands still in our way while we slow down, each by our present velocity; its times jitter."""
    rng, rows = np.random.default_rng(3), []
    for t_s in np.arange(0.0, seconds, FRAME_S):
        z_m, now_m_s = ahead_m - speed_m_s * t_s + 0.5 * deceleration_m_s2 * t_s**2, speed_m_s - deceleration_m_s2 * t_s
        seen_m_s = now_m_s * (1.0 + jitter * rng.normal())
        rows.append(row_of((0.0, 0.0, z_m), (0.0, 0.0, -seen_m_s), relative_sigma=0.01, width_m=4.0))
    return rows


@pytest.mark.parametrize("jitter", [0.0, 0.05])
def test_what_is_reached_before_we_have_stopped_is_warned_of(jitter):
    """Brakes of 1.6 m/s^2 end at it."""
    for deceleration_m_s2 in (0.0, 0.8, 1.3):
        assert first_warned(watched(slowing(deceleration_m_s2, jitter=jitter))[0]) in (6, 7)


def bus_on_a_bend(yaw_rate_rad_s, heading_off_rad, n_frames=10, speed_m_s=8.0, seed=0):
    """Rows of a bus 24 m ahead that comes at us on a bend, each by its present velocity, as tracks err."""
    rng, place, heading, rows = np.random.default_rng(seed), np.array([0.0, 24.0]), heading_off_rad, []
    for _ in range(n_frames):
        velocity = speed_m_s * np.array([np.sin(heading), -np.cos(heading)])
        seen = velocity + 0.002 * speed_m_s * rng.normal(size=2)
        rows.append(row_of((place[0], 0.0, place[1]), (seen[0], 0.0, seen[1]), relative_sigma=0.002, width_m=4.0))
        place, heading = place + velocity * FRAME_S, heading + yaw_rate_rad_s * FRAME_S
    return rows


@pytest.mark.parametrize("seed", range(8))
def test_what_comes_straight_on_or_turns_towards_us_is_warned_of_as_soon_as_without_errors(seed):
    assert first_warned(watched(bus_on_a_bend(0.0, 0.06, seed=seed))[0]) == 7
    assert first_warned(watched(bus_on_a_bend(-0.1, 0.12, seed=seed))[0]) == 7


@pytest.mark.parametrize("seed", range(4))
def test_whoever_asks_for_hardly_any_confidence_is_told_of_no_fewer(seed):
    """Below even odds nothing would have to be gathered: a warning asks for more, whatever is configured."""
    config = CONFIG.model_copy(update={"confidence": 1e-6})
    assert first_warned(watched(bus_on_a_bend(0.0, 0.06, seed=seed), config)[0]) is not None


def low_part(offset_m, z_m=15.0):
    """Row of the legs of somebody 0.5 m wide who stands on the road, 1.5 m below us, and comes straight at us."""
    row = row_of((offset_m, 1.0, z_m), (0.0, 0.0, -8.0), width_m=0.5)
    x_px, y_px = row.ref_px
    half_px, low_px = 0.25 * FOCAL_PX / z_m, 0.5 * FOCAL_PX / z_m
    return replace(row, box_px=(x_px - half_px, y_px - low_px, x_px + half_px, y_px + low_px))


@pytest.mark.parametrize("road", [None, Road(np.array([0.0, 0.0, 8.0 / 1.5]))])
def test_what_passes_below_the_camera_on_the_road_hits_our_car(road):
    """Of somebody who walks onto the road only the legs may be told from the background; an aircraft passes below."""
    bend = OwnBend(heading=np.array([0.0, 0.0, 1.0]), turn_rad_s=0.0, road=road)
    assert is_course(low_part(0.0), on_ground=True, bend=bend)
    assert not is_course(low_part(0.0))
    assert not is_course(low_part(2.5), on_ground=True, bend=bend)


def side_of_lorry(offset_m, z_m=30.0, length_m=9.0):
    """Row of a lorry that shows its side, and whose middle passes us by ``offset_m``; our camera is 1.5 m high."""
    row = row_of((offset_m, 0.0, z_m), (0.0, 0.0, -10.0), width_m=length_m, relative_sigma=0.005)
    x_px, y_px = row.ref_px
    half_px, foot_px = 0.5 * length_m * FOCAL_PX / z_m, 1.5 * FOCAL_PX / z_m
    return replace(row, box_px=(x_px - half_px, y_px - foot_px, x_px + half_px, y_px + foot_px))


def test_on_the_road_half_a_lorry_and_half_our_width_are_what_it_must_not_come_closer_by():
    assert is_course(side_of_lorry(4.5 + 0.7), on_ground=True)
    assert not is_course(side_of_lorry(4.5 + 3.9), on_ground=True)
    # Where nothing tells how large it is, its own width has to do.
    assert is_course(side_of_lorry(4.5 + 3.9))


def car_ahead(offset_m, z_m=20.0, camera_height_m=1.3):
    """Row of a car 1.8 m wide and 1.5 m high that we approach, its middle so far aside of the camera."""
    row = row_of((offset_m, 0.0, z_m), (0.0, 0.0, -10.0), relative_sigma=0.003)
    x0_px, _, x1_px, _ = row.box_px
    top_px, bottom_px = (
        CAMERA.cy_px + FOCAL_PX * below_m / z_m for below_m in (camera_height_m - 1.5, camera_height_m)
    )
    return replace(row, box_px=(x0_px, top_px, x1_px, bottom_px))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_car_in_the_next_lane_is_not_hit_and_one_that_overlaps_with_ours_is(side):
    """Both are 1.8 m wide. The room of a whole camera's height beside us reached into the next lane."""
    assert is_course(car_ahead(side * 1.4), on_ground=True)
    assert not is_course(car_ahead(side * 2.2), on_ground=True)


def test_a_camera_at_rest_is_hit_by_what_comes_over_it_alone():
    """A car whose middle passes by its whole width beside a mast: two of them side by side, seen as one, do so."""
    for aside_m, is_hit in ((0.5, True), (1.6, False)):
        assert is_course(car_ahead(aside_m), at_rest=True) == is_hit
        assert is_course(car_ahead(aside_m))


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("aside_m", "is_hit"), [(0.0, True), (0.9, True), (1.5, False)])
def test_who_walks_on_the_road_is_hit_by_half_of_our_car_beside_the_camera(side, aside_m, is_hit):
    """A walker 0.6 m wide, 1.4 m below our camera: our car is 1.7 m wide, and hits him within 1.15 m of his middle."""
    walker = standing(0.6, 1.75, ref_below_m=0.5, centre_below_m=0.53, position_m=(side * aside_m, 0.0, 16.0))
    assert is_course(walker, on_ground=True) == is_hit
    assert is_course(walker) == (aside_m == 0.0)


@pytest.mark.parametrize("roll_deg", [-3.0, 3.0])
@pytest.mark.parametrize(("x_m", "across_m_s"), [(-2.0, 1.4), (2.0, -1.4), (-4.0, 1.4)])
@pytest.mark.parametrize("z_m", [4.0, 8.0, 12.0])
def test_who_crosses_before_us_while_we_creep_is_not_hit(roll_deg, x_m, across_m_s, z_m):
    """A level way that looks inclined before a rolled camera: from it alone the road could lie any depth below us."""
    roll = np.radians(roll_deg)
    up_m_s, creeping_m_s = across_m_s * np.sin(roll), -0.05
    walker = row_of((x_m, 0.5, z_m), (across_m_s * np.cos(roll), up_m_s, creeping_m_s), relative_sigma=0.003)
    half_px = 0.5 * FOCAL_PX / z_m * np.array([0.6, 1.75])
    centre_px = FOCAL_PX / z_m * np.array([x_m, 0.53]) + (CAMERA.cx_px, CAMERA.cy_px)
    walker = replace(walker, box_px=(*(centre_px - half_px).tolist(), *(centre_px + half_px).tolist()))
    assert not is_course(walker, on_ground=True)


def test_confidence_is_the_probability_of_the_approach_and_as_high_as_asked_for():
    """A harder confidence warns of less, and later: an approach known to 32 % is told at 95 % but not at 99.99 %."""
    hit = drive(*HIT, 1.5, relative_sigma=0.2, width_m=8.0)
    wide = CONFIG.model_copy(update={"max_miss_widths": 100.0})
    active, _ = watched(hit, wide)
    frame = first_warned(active)
    # The rate is 1 / 0.2 of its standard deviations away from none.
    assert active[frame][0].confidence == pytest.approx(1.0, abs=1e-6)
    harder = wide.model_copy(update={"confidence": 0.9999})
    assert first_warned(watched(hit, harder)[0]) > frame
    less_known = drive(*HIT, 1.5, relative_sigma=0.32, width_m=8.0)
    assert first_warned(watched(less_known, wide)[0]) is not None
    assert first_warned(watched(less_known, harder)[0]) is None


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
    assert is_course(walker)
    beside = standing(0.6, 1.75, ref_below_m=1.3, centre_below_m=0.53, position_m=(1.2, 0.0, 16.0))
    assert not is_course(beside)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_what_ends_far_below_or_begins_far_above_is_not_hit(side):
    assert not is_course(standing(0.6, 0.4, 1.5 * side, 1.5 * side))


@pytest.mark.parametrize("motion_id", [SCENE_MOTION, 1])
@pytest.mark.parametrize("road", [None, Road(np.array([0.0, 0.0, 10.0]))])
def test_on_the_road_what_stands_is_warned_of_where_a_road_is_found(motion_id, road):
    """A bridge or trees beside the road come at us like a wall as long as nobody knows where the road is."""
    row = replace(row_of((0.0, 0.0, 20.0), (0.0, 0.0, -10.0), relative_sigma=0.005), motion_id=motion_id)
    bend = OwnBend(heading=np.array([0.0, 0.0, 1.0]), turn_rad_s=0.0, road=road)
    is_told = motion_id != SCENE_MOTION or road is not None
    assert is_course(row, on_ground=True, bend=bend) == is_told
    assert is_course(row, on_ground=False, bend=bend)


def test_on_the_road_nothing_that_stands_is_warned_of_before_it_is_known_how_we_drive():
    row = replace(row_of((0.0, 0.0, 20.0), (0.0, 0.0, -10.0), relative_sigma=0.005), motion_id=SCENE_MOTION)
    assert not is_course(row, on_ground=True, bend=None)


def test_what_stands_far_ahead_may_be_steered_past_and_what_drives_before_us_follows_the_road():
    """At 10 m/s: 0.15 heights of the camera / s^2 take us aside by 1.4 m in 3.8 s, by 0.4 m in 2 s, about as likely."""
    bend = OwnBend(heading=np.array([0.0, 0.0, 1.0]), turn_rad_s=0.0, road=Road(np.array([0.0, 0.0, 10.0 / 1.3])))
    far, near = (
        course_of(
            replace(car_ahead(0.0, z_m), motion_id=SCENE_MOTION), Viewpoint(CAMERA, on_ground=True, bend=bend), CONFIG
        ).probability
        for z_m in (38.0, 20.0)
    )
    # Half of our width, 0.7 heights, and half of the car's, 0.9 m.
    both_m, sigma_m = 0.7 * 1.3 + 0.9, 0.5 * 0.15 * 3.8**2 * 1.3
    assert far == pytest.approx(2.0 * ndtr(both_m / sigma_m) - 1.0, abs=0.03)
    assert near > 0.99
    assert is_course(car_ahead(0.0, 38.0), on_ground=True, bend=bend)


@pytest.mark.parametrize("box_px", [(400.0, 100.0, 500.0, np.nan)])
@pytest.mark.parametrize("velocity_m_s", [(0.0, 0.0, -10.0), (-10.0, 0.0, 0.0)])
def test_a_foot_that_is_not_seen_and_what_does_not_come_nearer_have_a_probability(box_px, velocity_m_s):
    bend = OwnBend(heading=np.array([0.0, 0.0, 1.0]), turn_rad_s=0.0, road=Road(np.array([0.0, 0.0, 8.0])))
    row = row_of((3.0, 0.0, 20.0), velocity_m_s, relative_sigma=0.005)
    for box in (box_px, row.box_px):
        known = replace(row, motion_id=SCENE_MOTION, motion_state=MotionState.approaching, box_px=box)
        course = course_of(known, Viewpoint(CAMERA, on_ground=True, bend=bend), CONFIG)
        assert 0.0 <= course.probability <= 1.0
