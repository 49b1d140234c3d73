"""The annotated picture: what it says, and where it puts it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from frame_results import event, frame_result, no_tracks, object_cluster, scene_cluster, some_tracks, times_of

from ttcvid.draw import OverlayPainter
from ttcvid.draw.boxes import box_in_pixels
from ttcvid.draw.directions import epipole_ellipses_px
from ttcvid.draw.lettering import Lettering, cap_height_px
from ttcvid.draw.palette import (
    BLACK,
    OBJECT_COLOURS,
    SCENE,
    UNASSIGNED,
    WARNING,
    WHITE,
    ObjectColours,
    colours_of_tracks,
)
from ttcvid.draw.shown import ShownObjects
from ttcvid.draw.trails import Trails
from ttcvid.draw.wording import Urgency, by_urgency, interval_text, seconds, time_text, urgency_of
from ttcvid.model import Camera, CollisionTimes, FrameStatus, ImageSize, MotionState, Status, TrackRows

SIZE = ImageSize(320, 200)
CAMERA = Camera(300.0, 300.0, 160.0, 100.0, SIZE, origin="focal_px")
GREY = 90


def blank(size=SIZE):
    return np.full((size.height_px, size.width_px, 3), GREY, dtype=np.uint8)


def painted(*results, camera=CAMERA, trail_frames=4):
    painter = OverlayPainter(camera, camera.image_size, trail_frames)
    for result in results:
        picture = painter.paint(blank(camera.image_size), result)
    return picture


@pytest.fixture
def words(monkeypatch):
    """What is written into a picture, in order: text, x, y."""
    written = []
    draw = Lettering.draw

    def drawn(self, bgr, text, x, y, ink):
        written.append((text, x, y))
        draw(self, bgr, text, x, y, ink)

    monkeypatch.setattr(Lettering, "draw", drawn)
    return written


def object_colour(cluster_id):
    """The colour of an object that is in view alone, or beside others with lower numbers."""
    return ObjectColours().follow([cluster_id])[cluster_id]


def has_colour(picture, colour):
    return bool(np.any(np.all(picture == colour, axis=-1)))


def tracks_at(xy_px, track_id=None, cluster_id=None):
    n = len(xy_px)
    return TrackRows(
        np.arange(n) if track_id is None else np.asarray(track_id),
        np.zeros(n, dtype=np.int64) if cluster_id is None else np.asarray(cluster_id),
        np.asarray(xy_px, dtype=float),
        np.ones(n, dtype=np.int64),
        np.zeros(n),
        CollisionTimes.missing(n),
        np.zeros(n, dtype=np.int64),
    )


def timed(ttc_s, lo_s, hi_s, state=MotionState.approaching, **changes):
    times = times_of(ttc_z_s=[ttc_s], ttc_z_lo_s=[lo_s], ttc_z_hi_s=[hi_s])
    return object_cluster(times=times, motion_state=state, **changes)


@pytest.mark.parametrize(
    ("cluster", "time", "interval"),
    [
        (timed(2.4, 2.1, 2.8), "2.4 s", "2.1-2.8"),
        (timed(2.4, 1.5, 4.6), "1.5-4.6 s", ""),
        (timed(8.0, 6.0, -30.0), ">6.0 s", ""),
        (timed(14.2, 13.5, 15.0), "14 s", "14-15"),
        (timed(2000.0, 1900.0, 2100.0), "99+ s", "99+-99+"),
        (timed(5.0, 4.9, np.inf), "4.9-99+ s", ""),
        (timed(2.4, np.nan, np.nan), "2.4 s", ""),
        (timed(np.nan, np.nan, np.nan), "-", ""),
        (timed(-3.0, -4.0, -2.0), "-", ""),
        (timed(-3.0, -4.0, -2.0, MotionState.receding), "away", ""),
        (timed(np.nan, np.nan, np.nan, MotionState.no_relative_motion), "same speed", ""),
        (timed(np.nan, np.nan, np.nan, MotionState.unknown), "?", ""),
        (timed(3.0, 2.8, 3.2, MotionState.constant_bearing), "3.0 s", "2.8-3.2"),
    ],
)
def test_a_time_stands_alone_only_where_its_interval_is_tight(cluster, time, interval):
    assert time_text(cluster) == time
    assert interval_text(cluster) == interval


@pytest.mark.parametrize(
    ("value_s", "text"), [(0.04, "0.0"), (9.94, "9.9"), (9.96, "10"), (99.0, "99"), (99.1, "99+"), (np.inf, "99+")]
)
def test_seconds_take_three_signs_at_most(value_s, text):
    assert seconds(value_s) == text


def test_red_is_for_warnings_and_amber_for_certain_near_approaches():
    near, far, uncertain = timed(2.4, 2.1, 2.8), timed(6.0, 5.0, 7.0), timed(2.0, 1.5, -9.0)
    assert urgency_of(near, (event(cluster_id=1),)) is Urgency.warned
    assert urgency_of(near, (event(cluster_id=2),)) is Urgency.close
    assert urgency_of(far, ()) is Urgency.calm
    assert urgency_of(uncertain, ()) is Urgency.calm
    assert urgency_of(timed(2.4, 2.1, 2.8, MotionState.receding), ()) is Urgency.calm


def test_objects_come_by_rank_and_those_without_rank_last():
    clusters = [object_cluster(4, urgency_rank=None), object_cluster(2, urgency_rank=2), scene_cluster(),
                object_cluster(3, urgency_rank=1), object_cluster(1, urgency_rank=None)]  # fmt: skip
    assert [row.cluster_id for row in by_urgency(frame_result(1, clusters=clusters))] == [3, 2, 1, 4]


def test_what_may_or_may_not_approach_is_drawn_quietly():
    vague = object_cluster(motion_state=MotionState.unknown)
    assert urgency_of(vague, ()) is Urgency.untold
    assert urgency_of(vague, (event(cluster_id=1),)) is Urgency.warned
    loud = object_cluster(motion_state=MotionState.receding)
    n_coloured = [
        int(np.all(painted(frame_result(1, clusters=[row])) == OBJECT_COLOURS[0], axis=-1).sum())
        for row in (replace(vague, direction=None), replace(loud, direction=None))
    ]
    assert 0 < n_coloured[0] < 0.7 * n_coloured[1]


def test_the_legend_leaves_out_what_may_or_may_not_approach(words):
    told = timed(5.0, 4.9, 5.1, cluster_id=2, box_px=(200.0, 100.0, 250.0, 140.0))
    painted(frame_result(1, clusters=[object_cluster(motion_state=MotionState.unknown), told]))
    assert [text for text, x, y in words if x < 60 and y < 40] == ["#2", "5.0 s  4.9-5.1"]


def test_objects_that_are_warned_of_come_first():
    calm, warned = timed(2.0, 1.9, 2.1, urgency_rank=1), timed(3.0, 2.9, 3.1, cluster_id=2, urgency_rank=2)
    result = frame_result(1, clusters=[calm, warned], events=(event(cluster_id=2),))
    assert [row.cluster_id for row in by_urgency(result)] == [1, 2]
    assert [one.row.cluster_id for one in ShownObjects().follow(result)] == [2, 1]


def test_the_banner_names_kind_object_and_time(words):
    painted(frame_result(3, clusters=[timed(2.4, 2.3, 2.5)], events=(event(cluster_id=1),)))
    assert "COLLISION COURSE #1  2.4 s" in [text for text, _, _ in words]


def test_the_banner_names_an_object_with_a_box_rather_than_a_hidden_one(words):
    hidden, seen = timed(1.0, 0.9, 1.1), timed(2.4, 2.3, 2.5, cluster_id=2)
    both = (event(1, cluster_id=1), event(2, cluster_id=2))
    painted(frame_result(3, clusters=[hidden]), frame_result(4, clusters=[seen], events=both))
    assert "COLLISION COURSE #2  2.4 s" in [text for text, _, _ in words]


def test_a_warning_of_a_hidden_object_is_shown_where_it_was_seen_last(words):
    """Its red dashes stand around its last box, and its label beside them."""
    box_px = (100.0, 80.0, 160.0, 130.0)
    warned = (event(cluster_id=1),)
    seen = frame_result(3, clusters=[timed(2.4, 2.3, 2.5, box_px=box_px)], events=warned)
    picture = painted(seen, frame_result(4, events=warned), frame_result(5, events=warned))
    assert "COLLISION COURSE #1  seen 0.2 s ago" in [text for text, _, _ in words]
    last_label = [place for place in words if place[0] == "#1 seen 0.2 s ago"]
    assert last_label
    assert abs(last_label[0][1] - box_px[0]) < 20
    assert abs(last_label[0][2] - box_px[1]) < 40
    is_red = np.all(picture == WARNING, axis=-1)
    assert is_red[80:130, 85:100].any()
    assert is_red[80:130, 161:175].any()


def test_a_warning_that_has_ended_leaves_nothing_behind(words):
    seen = frame_result(3, clusters=[timed(2.4, 2.3, 2.5)], events=(event(cluster_id=1),))
    painted(seen, frame_result(4))
    assert not [text for text, _, _ in words if "ago" in text]


def test_a_banner_that_would_hide_its_object_stands_on_top():
    low, high = (100.0, 160.0, 200.0, 199.0), (100.0, 90.0, 200.0, 130.0)
    for box_px, is_on_top in ((low, True), (high, False)):
        row = timed(2.4, 2.3, 2.5, box_px=box_px, direction=None)
        picture = painted(frame_result(1, clusters=[row], events=(event(cluster_id=1),)))
        is_reddish = (picture[:, 310, 2] > 180) & (picture[:, 310, 1] < 60)
        assert is_reddish[:30].any() == is_on_top
        assert is_reddish[140:].any() != is_on_top


def test_every_object_that_is_warned_of_has_a_label_even_without_room(words):
    boxes = [(100.0 + i, 2.0 + i, 300.0, 198.0) for i in range(6)]
    rows = [timed(2.4, 2.3, 2.5, cluster_id=i + 1, box_px=box) for i, box in enumerate(boxes)]
    events = tuple(event(i, cluster_id=i) for i in range(1, 7))
    painted(frame_result(1, clusters=rows, events=events))
    assert {f"#{i} 2.4 s" for i in range(1, 7)} <= {text for text, _, _ in words}


def colours_over(*frames):
    """The colours of the objects of each frame, by number."""
    colours = ObjectColours()
    return [colours.follow(cluster_ids) for cluster_ids in frames]


def test_two_objects_in_view_never_share_a_colour():
    n = len(OBJECT_COLOURS)
    crowds = [[1, 1 + n, 1 + 2 * n], range(1, 60), [3, 3 + n, 7, 7 + 5 * n]]
    for colours, crowd in zip(colours_over(*crowds), crowds, strict=True):
        assert len(set(colours.values())) == len(crowd)
        assert not set(colours.values()) & {SCENE, UNASSIGNED, WARNING, BLACK, WHITE}


def test_an_object_keeps_its_colour_whoever_comes_and_goes():
    n = len(OBJECT_COLOURS)
    frames = colours_over([1 + n], [1, 1 + n], [1, 1 + n, 1 + 2 * n], [1 + n], [1, 1 + n])
    assert len({colours[1 + n] for colours in frames}) == 1
    assert frames[1][1] == frames[2][1] == frames[4][1]


def test_a_new_object_takes_the_colour_that_was_used_longest_ago():
    n = len(OBJECT_COLOURS)
    *_, last = colours_over([2], [3], [4, 5, 6], [1], [1, 1 + n])
    assert last[1 + n] == OBJECT_COLOURS[1]


def test_tracks_have_the_colours_of_their_objects():
    colours = colours_of_tracks(np.array([7, 0, -1, 5]), {7: (1, 2, 3)})
    assert colours.tolist() == [[1, 2, 3], [*SCENE], [*UNASSIGNED], [*UNASSIGNED]]


def box_of(xy_px):
    return box_in_pixels(object_cluster(box_px=(0.0, 0.0, 1.0, 1.0)), np.asarray(xy_px, dtype=float))


def test_the_box_leaves_out_strays():
    grid_px = np.stack(np.meshgrid(np.arange(100, 150, 10), np.arange(60, 100, 10)), axis=-1).reshape(-1, 2)
    body = (100, 60, 140, 90)
    assert box_of(grid_px) == body
    assert box_of([*grid_px, [120, 160]]) == body
    assert box_of([*grid_px, [60, 70], [190, 70]]) == body


def test_the_box_keeps_long_ends_and_few_tracks():
    """Wing tips are not strays: others lie between; of a few tracks, each one counts."""
    wing_px = [[x, 50] for x in (0, 12, 24, 36, *range(48, 110, 2), 122, 134, 146)]
    assert box_of(wing_px) == (0, 50, 146, 50)
    assert box_of([[0, 0], [5, 5], [9, 3], [80, 4]]) == (0, 0, 80, 5)
    assert box_of(np.zeros((0, 2))) == (0, 0, 1, 1)


@pytest.mark.parametrize("size", [(1242, 375), (640, 360), (1920, 1080), (360, 640), (3840, 2160)])
def test_letters_can_be_read_when_the_picture_fills_a_phone(size):
    cap_px = cap_height_px(ImageSize(*size))
    assert cap_px >= 0.034 * size[1] or cap_px >= 0.04 * size[0]  # of the height, of the width where that is small
    assert Lettering(cap_px).width_px("#3 2.1-2.8 s") < 0.5 * size[0]


def test_letters_are_cut_off_at_the_edges_and_unknown_ones_have_a_width():
    letters = Lettering(12)
    for x, y in product((-500, -5, 100, 315, 900), (-500, -5, 50, 195, 900)):
        letters.draw(blank(), "12.3 s größe \u6f22", x, y, WHITE)
    assert letters.width_px("\u6f22") > 0
    assert letters.width_px("") == 0
    letters.draw(blank(), "", 0, 0, WHITE)


def test_letters_are_white_where_they_cover_and_leave_the_rest():
    picture = blank()
    Lettering(30).draw(picture, "I", 20, 20, WHITE)
    assert picture.max() >= 250
    assert (picture[:15] == GREY).all()
    assert (picture[70:] == GREY).all()


def test_the_number_sign_is_legible():
    """Its four strokes leave the ground open between them, in the middle and on all sides."""
    picture = blank()
    letters = Lettering(14)
    letters.draw(picture, "#", 20, 20, WHITE)
    sign = picture[20:34, 20 : 20 + letters.width_px("#"), 0].astype(float)
    ink = (sign - GREY) / (255.0 - GREY)
    across, down = ink.mean(axis=0), ink.mean(axis=1)
    is_stroke = down > 0.7
    assert np.count_nonzero(np.diff(is_stroke.astype(int)) == 1) == 2  # two strokes across
    between = ink[np.flatnonzero(is_stroke)[0] : np.flatnonzero(is_stroke)[-1] + 1].min(axis=1)
    assert between.min() < 0.2
    assert across.max() > 0.5


def test_trails_follow_each_track_by_its_number():
    trails = Trails(2)
    trails.follow(tracks_at([[0, 0], [10, 10]], track_id=[3, 7]))
    trails.follow(tracks_at([[1, 0], [50, 50], [11, 10]], track_id=[3, 5, 7]))
    trails.follow(tracks_at([[51, 50], [12, 10]], track_id=[5, 7]))
    assert trails.positions_px.tolist() == [[[51, 50], [50, 50], [50, 50]], [[12, 10], [11, 10], [10, 10]]]


def test_trails_survive_frames_without_tracks():
    trails = Trails(2)
    trails.follow(tracks_at([[0, 0]]))
    trails.follow(no_tracks())
    trails.follow(tracks_at([[5, 5]]))
    assert trails.positions_px.tolist() == [[[5, 5]] * 3]


def test_scene_tracks_are_grey_and_object_tracks_have_the_colour_of_the_object():
    picture = painted(frame_result(1, tracks_at([[100, 50], [200, 60]], cluster_id=[0, 2])))
    assert tuple(picture[50, 100]) == SCENE
    assert tuple(picture[60, 200]) == object_colour(2)


def trail_over(*places_px, cluster_id=2, stroke_px=1):
    picture, trails = blank(), Trails(4)
    for place_px in places_px:
        tracks = tracks_at([place_px], cluster_id=[cluster_id])
        trails.follow(tracks)
    trails.draw(picture, tracks, {2: OBJECT_COLOURS[1]}, stroke_px)
    return (picture != GREY).any(axis=-1)


@pytest.mark.parametrize("end_px", [(140.0, 90.0), (105.0, 60.0), (70.0, 80.0)])
def test_a_trail_is_a_line_without_gaps_from_the_oldest_place_to_the_track(end_px):
    start_px = np.array([100.0, 100.0])
    is_drawn = trail_over(*(start_px + part * (end_px - start_px) for part in np.linspace(0.0, 1.0, 5)))
    low, high = np.sort([start_px, end_px], axis=0).astype(int)
    for axis in range(2):
        is_covered = is_drawn.any(axis=axis)
        assert is_covered[low[axis] : high[axis] + 1].all()
    assert is_drawn.sum() < (high - low).max() + 5


def test_a_thick_trail_lies_evenly_about_its_line():
    is_drawn = trail_over((100.0, 50.0), (110.0, 50.0), (120.0, 50.0), stroke_px=2)
    assert np.flatnonzero(is_drawn[:, 110]).tolist() == [49, 50, 51]


@pytest.mark.parametrize("place_px", [(1e12, 50.0), (-40.0, -40.0)])
def test_a_trail_to_far_away_is_left_out_and_one_over_the_edge_cut_off(place_px):
    assert not trail_over(place_px, place_px).any()
    assert trail_over(place_px, (10.0, 10.0), (20.0, 20.0), (30.0, 30.0)).sum() < 100


def test_a_trail_of_the_scene_is_shorter_than_that_of_an_object():
    places_px = [(100.0 + 10.0 * k, 50.0) for k in range(5)]
    assert trail_over(*places_px, cluster_id=0).any(axis=0).sum() < 0.6 * trail_over(*places_px).any(axis=0).sum()


def test_the_cross_stands_on_the_epipole_and_the_arrow_at_the_edge_when_it_is_outside():
    inside = object_cluster(epipole_px=np.array([60.0, 150.0]), box_px=(200.0, 20.0, 250.0, 60.0), ref_px=(225.0, 40.0))
    assert tuple(painted(frame_result(1, clusters=[inside]))[150, 60]) == object_colour(1)
    outside = replace(inside, epipole_px=np.array([900.0, 100.0]))
    assert tuple(painted(frame_result(1, clusters=[outside]))[100, 314]) == object_colour(1)
    infinite = replace(inside, epipole_px=None, direction=np.array([-1.0, 0.0, 0.0]))
    assert tuple(painted(frame_result(1, clusters=[infinite]))[100, 5]) == object_colour(1)


def test_ellipse_is_the_90_percent_region_of_the_direction():
    """A direction along the optical axis with sigma rad across has its epipole at the principal point, sigma f wide."""
    sigma_rad = np.array([0.02, 0.01])
    cluster = object_cluster(direction=np.array([0.0, 0.0, -1.0]), direction_cov=np.diag([*sigma_rad**2, 0.0]))
    (ellipse_px,) = epipole_ellipses_px(CAMERA, [cluster])
    half_axes_px = np.sqrt(-2 * np.log(0.1)) * sigma_rad * 300.0
    assert np.ptp(ellipse_px, axis=0) / 2 == pytest.approx(half_axes_px, rel=0.01)
    assert ellipse_px.mean(axis=0) == pytest.approx([160.0, 100.0], abs=1e-6)


def test_an_epipole_that_may_lie_anywhere_is_left_out():
    """Its region is wider than 40 % of the picture: 128 px, sigma 0.1 rad or 30 px."""
    x, y = 160, 150
    row = object_cluster(box_px=(20.0, 20.0, 50.0, 60.0), ref_px=(35.0, 40.0), epipole_px=np.array([x, y]))
    for sigma_rad, is_drawn in ((0.03, True), (0.1, False)):
        vague = replace(row, direction_cov=np.diag([sigma_rad**2, sigma_rad**2, 0.0]))
        picture = painted(frame_result(1, clusters=[vague]))
        assert (tuple(picture[y, x]) == object_colour(1)) == is_drawn


def test_ellipse_is_missing_without_covariance_or_behind_the_camera():
    unknown = object_cluster(direction_cov=None)
    sideways = object_cluster(direction=np.array([1.0, 0.0, 0.02]), direction_cov=np.diag([0.0, 0.1, 0.1]))
    ellipses_px = epipole_ellipses_px(CAMERA, [unknown, sideways])
    assert np.isnan(ellipses_px[0]).all()
    assert np.isnan(ellipses_px[1]).any()


def test_picture_is_painted_in_place_and_another_size_is_refused():
    painter = OverlayPainter(CAMERA, SIZE, 4)
    picture = blank()
    assert painter.paint(picture, frame_result(0)) is picture
    assert not (picture == GREY).all()
    with pytest.raises(ValueError, match="expected a picture of 320x200"):
        painter.paint(np.zeros((100, 100, 3), np.uint8), frame_result(1))


@pytest.mark.parametrize("changes", [{"origin": "assumed"}, {"origin": "found", "focal_sigma_px": 9.0}])
def test_a_field_of_view_that_nobody_gave_is_said_in_the_picture(changes):
    result = frame_result(1)
    given, assumed = painted(result), painted(result, camera=replace(CAMERA, **changes))
    changed = np.argwhere((given != assumed).any(axis=-1))
    assert len(changed) > 100
    assert changed[:, 0].min() > 150  # at the bottom


def test_a_camera_that_rests_is_no_fault(words):
    painted(frame_result(1, status=FrameStatus.static))
    assert "static" not in [text for text, *_ in words]
    painted(frame_result(1, status=FrameStatus.rotation_only))
    assert "rotation only" in [text for text, *_ in words]


def test_the_picture_says_what_the_clip_tells_of_the_platform(words):
    OverlayPainter(CAMERA, SIZE, 4, told_platform="vehicle").paint(blank(), frame_result(3))
    assert "0.30 s  frame 3  vehicle, told by the clip" in [text for text, *_ in words]


def test_frame_status_and_warning_are_visible():
    calm = painted(frame_result(1))
    assert not np.array_equal(calm, painted(frame_result(1, status=FrameStatus.few_tracks)))
    warned = painted(frame_result(1, events=(event(),)))
    reddish = (warned[..., 2] > 180) & (warned[..., 1] < 60)
    assert reddish.sum() > 0.05 * reddish.size
    assert not has_colour(calm, object_colour(1))


def test_every_object_has_a_box_in_its_colour():
    boxes = [(20.0, 90.0, 60.0, 140.0), (200.0, 90.0, 250.0, 140.0)]
    clusters = [object_cluster(i + 1, box_px=box, urgency_rank=i + 1) for i, box in enumerate(boxes)]
    picture = painted(frame_result(1, clusters=clusters))
    assert tuple(picture[140, 40]) == object_colour(1)
    assert tuple(picture[140, 225]) == object_colour(2)


def test_horizon_is_drawn_where_it_lies():
    picture = painted(frame_result(1, horizon_px=(80.0, 90.0)))
    rows = np.argwhere((picture != GREY).any(axis=-1))[:, 0]
    assert {80, 85, 90} <= set(rows.tolist())
    assert not {70, 100} & set(rows.tolist())


@pytest.mark.parametrize("size", [(320, 200), (64, 48), (48, 64), (16, 16), (2, 2)])
def test_every_combination_of_content_can_be_painted_at_any_size(size):
    size = ImageSize(*size)
    rng = np.random.default_rng(0)
    far = object_cluster(3, box_px=(-1e12, -5.0, 1e12, 9e9), ref_px=(1e7, -1e7))
    vague = object_cluster(4, direction=None, direction_cov=None, epipole_px=None, ref_px=None, state_abc_hz=None)
    broken = object_cluster(5, box_px=(np.nan,) * 4)
    still = object_cluster(6, direction=np.full(3, np.nan), ref_px=(np.nan, np.nan), status=Status.no_parallax)
    camera = Camera(50.0, 50.0, 20.0, 20.0, size)
    many = [object_cluster(i, urgency_rank=i) for i in range(1, 30)]
    for distortion_model, distortion in (("none", ()), ("plumb_bob", (-0.3, 0.1, 0.0, 0.0, 0.0))):
        painter = OverlayPainter(replace(camera, distortion_model=distortion_model, distortion=distortion), size, 3)
        tracks = (no_tracks(), some_tracks(40, rng))
        clusters = ((), (scene_cluster(),), (far, vague, broken, still), many)
        horizons = (None, (5.0, 9.0), (np.nan, 1.0))
        for i, content in enumerate(product(tracks, clusters, horizons, ((), (event(),), (event(cluster_id=99),)))):
            track_rows, rows, horizon_px, events = content
            result = frame_result(i, track_rows, rows, horizon_px=horizon_px, events=events)
            assert painter.paint(blank(size), result).shape == (size.height_px, size.width_px, 3)


def test_equal_results_give_equal_pictures():
    results = [frame_result(i, some_tracks(60, np.random.default_rng(i)), [object_cluster()]) for i in range(3)]
    assert np.array_equal(painted(*results), painted(*results))


def test_outlines_are_black_so_that_signs_show_on_any_ground():
    assert has_colour(painted(frame_result(1, clusters=[object_cluster()])), BLACK)
