"""The annotated picture: what it says, and where it puts it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from frame_results import event, frame_result, no_tracks, object_cluster, scene_cluster, some_tracks, times_of

from ttcvid.draw import OverlayPainter
from ttcvid.draw.directions import epipole_ellipses_px
from ttcvid.draw.lettering import Lettering, cap_height_px
from ttcvid.draw.palette import BLACK, OBJECT_COLOURS, SCENE, WARNING, WHITE, object_colour
from ttcvid.draw.trails import Trails
from ttcvid.draw.wording import Urgency, banner_text, by_urgency, interval_text, seconds, time_text, urgency_of
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
    assert urgency_of(timed(2.4, 2.1, 2.8, MotionState.unknown), ()) is Urgency.calm


def test_objects_come_by_rank_and_those_without_rank_last():
    clusters = [object_cluster(4, urgency_rank=None), object_cluster(2, urgency_rank=2), scene_cluster(),
                object_cluster(3, urgency_rank=1), object_cluster(1, urgency_rank=None)]  # fmt: skip
    assert [row.cluster_id for row in by_urgency(frame_result(1, clusters=clusters))] == [3, 2, 1, 4]


def test_banner_names_kind_object_and_time():
    result = frame_result(3, clusters=[timed(2.4, 2.3, 2.5)])
    assert banner_text(event(cluster_id=1), result) == "COLLISION COURSE #1  2.4 s"
    assert banner_text(event(cluster_id=9, kind="constant_bearing"), result) == "CONSTANT BEARING #9"


def test_an_object_keeps_its_colour_and_neighbours_differ():
    assert len(set(OBJECT_COLOURS)) == len(OBJECT_COLOURS)
    assert object_colour(1) != object_colour(2)
    assert object_colour(1) == object_colour(1 + len(OBJECT_COLOURS))
    assert not set(OBJECT_COLOURS) & {SCENE, WARNING}


@pytest.mark.parametrize("size", [(1242, 375), (640, 360), (1920, 1080), (360, 640), (3840, 2160)])
def test_letters_can_be_read_when_the_picture_fills_a_phone(size):
    cap_px = cap_height_px(ImageSize(*size))
    assert cap_px >= 0.034 * size[1] or cap_px >= 0.04 * size[0]  # of the height, of the width where that is small
    assert Lettering(cap_px).width_px("#3 2.1-2.8 s") < 0.5 * size[0]


def test_letters_are_cut_off_at_the_edges_and_unknown_ones_replaced():
    letters = Lettering(12)
    for x, y in product((-500, -5, 100, 315, 900), (-500, -5, 50, 195, 900)):
        letters.draw(blank(), "12.3 s größe", x, y, WHITE)
    assert letters.width_px("ö") == letters.width_px("?")
    assert letters.width_px("") == 0
    letters.draw(blank(), "", 0, 0, WHITE)


def test_letters_are_white_where_they_cover_and_leave_the_rest():
    picture = blank()
    Lettering(30).draw(picture, "I", 20, 20, WHITE)
    assert picture.max() >= 250
    assert (picture[:15] == GREY).all()
    assert (picture[70:] == GREY).all()


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
    trails.draw(picture, tracks, stroke_px)
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
