"""Metres for what a run has seen: own speed, the road, widths; and what has no link."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.studies.collision_map.hazards import OwnBody, Situation
from ttcvid.studies.collision_map.run_hazards import Scale, SeenFrame, SeenObjects, SeenSituation, situation_of
from ttcvid.studies.collision_map.static_scene import StaticPoints, carried, obstacles, remembered, seen_now
from ttcvid.studies.collision_map.velocity_map import map_of_changes

OWN = OwnBody(1.8, 4.5, 1.5)
OWN_SPEED_M_S, CAMERA_HEIGHT_M = 10.0, 1.4
CAR_AT_M, CAR_VELOCITY_M_S = np.array([6.0, 0.7, 30.0]), np.array([-4.0, 0.0, -12.0])
BY_SPEED = Scale(OWN_SPEED_M_S, None, {}, None, stands_on_road=True)


VIEW = np.array([[-0.9, -0.5], [0.9, 0.5]])


def seen_frame(t_s: float = 0.0, moved_m: float = 0.0, motion_id: int = 1) -> SeenFrame:
    """A level road, two posts, and a car 1.8 m wide and 1.4 m high that stands on it, all seen without error.

    Of each post we see four points, two a hand apart at each of two heights.
    """
    rng = np.random.default_rng(3)
    road = np.column_stack([rng.uniform(-4, 4, 60), np.full(60, CAMERA_HEIGHT_M), rng.uniform(6, 40, 60)])
    posts = [[x + dx, y, z] for x, z in ((-3.5, 15.5), (3.5, 20.5)) for dx in (0.0, 0.1) for y in (0.1, 0.3)]
    places = np.concatenate([road, posts]) - [0.0, 0.0, moved_m]
    track_id = np.flatnonzero(places[:, 2] > 1.0)
    places = places[track_id]
    rays = places / places[:, 2:]
    car = CAR_AT_M / CAR_AT_M[2]
    side = np.array([0.9, 0.0, 0.0]) / CAR_AT_M[2]
    top, bottom = car.copy(), car.copy()
    top[1], bottom[1] = 0.0, CAMERA_HEIGHT_M / CAR_AT_M[2]
    objects = SeenObjects(
        np.array([7]),
        np.array([motion_id]),
        car[None],
        CAR_VELOCITY_M_S[None] / CAR_AT_M[2],
        1e-8 * np.eye(3)[None],
        (car - side)[None],
        (car + side)[None],
        top[None],
        bottom[None],
    )
    return SeenFrame(
        t_s,
        np.array([0.0, 0.0, 1.0]),
        np.array([0.0, 1.0, 0.0]),
        0.0,
        track_id,
        rays,
        np.linalg.norm(places, axis=1) / OWN_SPEED_M_S,
        np.full(len(places), 0.01),
        objects,
        VIEW,
    )


def drive(scale: Scale, n_frames: int = 10, change=lambda n, seen: seen) -> list[SeenSituation]:
    """What is found in frame after frame, 0.1 s apart, each remembering those before."""
    memory, found = None, []
    for n in range(n_frames):
        found.append(situation_of(change(n, seen_frame(0.1 * n, 0.1 * n * OWN_SPEED_M_S)), scale, OWN, memory))
        memory = found[-1].memory
    return found


def static_places(found: SeenSituation) -> np.ndarray:
    """Places of the boxes of the static scene ``(N, 3)``."""
    assert found.situation is not None
    hazards = found.situation.hazards
    return hazards.position_m[[hazards.names[k] == "static scene" for k in hazards.object_index]]


def without_posts(seen: SeenFrame) -> SeenFrame:
    is_road = seen.point_id < 60
    points = seen.point_id[is_road], seen.point_rays[is_road], seen.point_range_s[is_road], seen.point_sigma[is_road]
    return replace(seen, **dict(zip(("point_id", "point_rays", "point_range_s", "point_sigma"), points, strict=True)))


def car_of(scale: Scale, seen: SeenFrame | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Place and velocity that the car gets."""
    found = situation_of(seen_frame() if seen is None else seen, scale, OWN).situation
    assert found is not None
    hazards = found.hazards
    k = int(np.flatnonzero(hazards.object_index == hazards.names.index("object 7"))[0])
    return hazards.position_m[k], hazards.velocity_m_s[k]


@pytest.mark.parametrize(
    "scale",
    [
        BY_SPEED,
        replace(BY_SPEED, own_speed_m_s=None, camera_height_m=CAMERA_HEIGHT_M),
        replace(BY_SPEED, camera_height_m=CAMERA_HEIGHT_M),
        replace(BY_SPEED, width_m=1.8, stands_on_road=False),
        replace(BY_SPEED, width_m_of={7: 1.8}, width_m=9.0),
    ],
    ids=["own speed", "camera height", "both", "width of all", "width of this one"],
)
def test_every_link_gives_the_car_its_place_and_velocity(scale: Scale):
    place, velocity = car_of(scale)
    # The box lies behind the surface that is seen, half its depth of 1.8 m.
    np.testing.assert_allclose(place, [6.0, 0.7, 30.9], rtol=0.01)
    np.testing.assert_allclose(velocity, CAR_VELOCITY_M_S, rtol=0.01)


def test_what_moves_with_the_scene_has_its_scale_without_a_road():
    seen = seen_frame(motion_id=0)
    still = replace(seen.objects, w=np.array([[0.0, 0.0, -OWN_SPEED_M_S / 30.0]]))
    place, velocity = car_of(replace(BY_SPEED, stands_on_road=False), replace(seen, objects=still))
    np.testing.assert_allclose(place[2], 30.9, rtol=0.01)
    np.testing.assert_allclose(velocity, [0.0, 0.0, -OWN_SPEED_M_S], atol=1e-9)


def still(depth_m: float, sigma: float = 0.01) -> SeenFrame:
    """The car at rest, at a depth by own speed; it stands on the road at 30 m."""
    seen, rate = seen_frame(motion_id=0), OWN_SPEED_M_S / depth_m
    w, cov_w = np.array([[0.0, 0.0, -rate]]), (sigma * rate) ** 2 * np.diag([0.0, 0.0, 1.0])[None]
    return replace(seen, objects=replace(seen.objects, w=w, cov_w=cov_w))


@pytest.mark.parametrize(
    ("seen", "is_linked"),
    [(still(30.0), True), (still(32.0), True), (still(60.0), False), (still(15.0), False), (still(30.0, 0.3), False)],
    ids=["both links agree", "nearly", "farther by speed", "nearer by speed", "speed unsure"],
)
def test_a_thing_at_rest_is_believed_where_its_links_agree(seen: SeenFrame, is_linked: bool):
    assert (situation_of(seen, BY_SPEED, OWN).unlinked == ()) == is_linked


def test_an_object_without_a_link_is_a_family_of_distances_and_the_map_says_so():
    found = situation_of(seen_frame(), replace(BY_SPEED, stands_on_road=False), OWN)
    assert found.unlinked == ("object 7",)
    assert any("object 7: neither width nor road" in note for note in found.notes)
    assert found.situation is not None
    hazards = found.situation.hazards
    members = hazards.take(hazards.object_index == hazards.names.index("object 7"))
    assert len(members) > 3
    assert members.weight.sum() == pytest.approx(1.0)
    over_ground = np.linalg.norm(members.velocity_m_s + found.situation.own_velocity_m_s, axis=1)
    assert over_ground.max() <= 60.0
    # The true one is among them, and all lie on the same ray and move alike.
    depths = members.position_m[:, 2]
    assert depths.min() < 30.0 < depths.max()
    np.testing.assert_allclose(
        members.velocity_m_s / members.velocity_m_s[:, 2:], np.tile([1 / 3, 0, 1], (len(members), 1))
    )


def test_without_any_scale_there_is_no_situation():
    seen = seen_frame()
    none = {"point_id": np.empty(0, np.int64), "point_range_s": np.empty(0), "point_sigma": np.empty(0)}
    nothing = replace(seen, point_rays=np.empty((0, 3)), **none)
    by_height = replace(BY_SPEED, own_speed_m_s=None, camera_height_m=CAMERA_HEIGHT_M)
    found = situation_of(nothing, by_height, OWN)
    assert found.situation is None
    assert "No scale" in found.notes[0]


def test_who_rests_sees_what_stands_on_the_road_of_a_known_height():
    seen = replace(seen_frame(), own_direction=np.full(3, np.nan))
    found = situation_of(seen, replace(BY_SPEED, own_speed_m_s=0.0, camera_height_m=CAMERA_HEIGHT_M), OWN)
    assert found.situation is not None
    assert found.situation.hazards.names == ("object 7",)
    np.testing.assert_allclose(found.situation.hazards.position_m[0], [6.0, 0.7, 30.9], rtol=0.01)


def test_a_speed_of_zero_scales_nothing_though_the_pictures_move():
    found = situation_of(seen_frame(), replace(BY_SPEED, own_speed_m_s=0.0), OWN)
    assert found.unlinked == ("object 7",)
    assert found.situation is not None
    assert found.situation.hazards.position_m[:, 2].min() > 1.0


def test_posts_are_obstacles_and_the_road_is_none():
    found = drive(BY_SPEED)[-1].situation
    assert found is not None
    scene = found.hazards.take(found.hazards.object_index == 0)
    assert found.hazards.names[0] == "static scene"
    np.testing.assert_allclose(sorted(scene.position_m[:, 2]), [15.5 - 9.0, 20.5 - 9.0], rtol=1e-6)
    # They reach down to the road.
    np.testing.assert_allclose(scene.position_m[:, 1] + scene.half_size_m[:, 1], CAMERA_HEIGHT_M, rtol=0.01)
    np.testing.assert_allclose(scene.velocity_m_s, np.tile([0.0, 0.0, -OWN_SPEED_M_S], (2, 1)))


def test_nothing_is_said_of_the_static_scene_before_it_has_been_watched():
    found = drive(BY_SPEED)
    assert [one.is_scene_known for one in found] == [False] * 5 + [True] * 5
    assert all(len(static_places(one)) == 0 for one in found[:5])


def test_without_a_road_nothing_is_said_of_the_static_scene_of_a_vehicle():
    def without_road(_, seen):
        return replace(seen, point_range_s=seen.point_range_s * np.linspace(0.2, 3.0, len(seen.point_id)))

    found = drive(BY_SPEED, change=without_road)[-1]
    assert not found.is_scene_known
    assert len(static_places(found)) == 0


def test_the_height_of_the_camera_is_remembered_where_no_road_is_found():
    found = drive(BY_SPEED, change=lambda n, seen: seen if n < 9 else replace(seen, point_sigma=seen.point_sigma * 11))
    assert found[-1].is_scene_known
    assert any("camera 1.40 m over the road" in note for note in found[-1].notes)


def test_a_car_stands_on_the_road_whatever_the_height_of_its_camera():
    """Its outline reaches from the road up, and not as far under the camera as over it."""
    found = drive(replace(BY_SPEED, camera_height_m=CAMERA_HEIGHT_M))[-1].situation
    assert found is not None
    assert found.own.middle_m[1] + 0.5 * OWN.height_m == pytest.approx(CAMERA_HEIGHT_M)
    assert found.own.middle_m[1] - 0.5 * OWN.height_m == pytest.approx(CAMERA_HEIGHT_M - OWN.height_m)


def test_what_is_left_behind_the_border_of_the_picture_is_remembered_where_it_is_now():
    """Posts 3.5 m aside leave a picture of 42 deg to either side when they are 4 m ahead."""
    found = drive(BY_SPEED, n_frames=20, change=lambda n, seen: seen if n < 12 else without_posts(seen))
    np.testing.assert_allclose(sorted(static_places(found[-1])[:, 2]), [15.5 - 19.0, 20.5 - 19.0], rtol=0.01)


def test_what_ought_to_be_seen_and_is_not_is_forgotten():
    found = drive(BY_SPEED, n_frames=13, change=lambda n, seen: seen if n < 6 else without_posts(seen))
    assert len(static_places(found[10])) == 2
    assert len(static_places(found[12])) == 0


def test_turning_carries_what_is_remembered_to_the_other_side():
    before = points_at([[0.0, 0.0, 10.0]])
    after = carried(before, np.zeros(3), np.radians(90.0), 0.1)
    np.testing.assert_allclose(after.place_m, [[-10.0, 0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose([after.age_s, after.unseen_s], [[2.1], [0.1]])


def test_a_point_that_wanders_through_the_world_is_not_believed():
    """That of a car ahead of us at our own speed: it is always as far away."""

    def nowhere(place_m):
        return np.zeros(len(place_m), bool)

    for speed_m_s, is_believed in ((10.0, True), (0.0, False)):
        known = points_at(np.zeros((0, 3)))
        for n in range(12):
            here = carried(known, np.array([0.0, 0.0, 1.0]), 0.0, 0.1)
            place = [[0.0, 0.0, 30.0 - 0.1 * n * speed_m_s]]
            known = remembered(here, seen_now(np.array([5]), np.array(place), np.full((1, 3), 0.05)), nowhere)
        assert (known.age_s[0] > 1.0) == is_believed
        assert (known.n_frames[0] > 10) == is_believed


def points_at(place_m, n_frames=20, age_s=2.0, spread_m=0.05) -> StaticPoints:
    """Points that have been seen for long."""
    place, n = np.asarray(place_m, dtype=float).reshape(-1, 3), len(place_m)
    ages = np.full(n, age_s), np.zeros(n)
    return StaticPoints(np.arange(n), place, np.full((n, 3), spread_m), np.full(n, n_frames), *ages)


def in_the_way(points: StaticPoints, own: OwnBody = OWN) -> np.ndarray:
    """Places of the obstacles that points are, over a road."""
    return obstacles(
        points, own.standing_on_road(CAMERA_HEIGHT_M), np.array([0.0, 0.0, 10.0]), CAMERA_HEIGHT_M
    ).position_m


def cluster(x: float, down: float, z: float) -> list[list[float]]:
    """Three points of one thing."""
    return [[x, down, z], [x, down + 0.05, z], [x + 0.05, down, z]]


@pytest.mark.parametrize(
    ("points", "is_obstacle"),
    [
        (points_at(cluster(0.0, 0.0, 10.2)), True),
        (points_at(cluster(0.0, 0.0, 10.2), n_frames=2), False),
        (points_at(cluster(0.0, 0.0, 10.2), age_s=0.2), False),
        (points_at(cluster(0.0, 0.0, 10.2), spread_m=0.9), False),
        (points_at(cluster(0.0, CAMERA_HEIGHT_M - 0.2, 10.2)), False),
        (points_at(cluster(0.0, -3.0, 10.2)), False),
        (points_at(cluster(0.3, 0.0, 1.2)), False),
    ],
    ids=["sure", "seldom", "new", "distance unsure", "on the road", "a bridge", "inside us"],
)
def test_only_what_surely_stands_on_the_road_is_an_obstacle(points: StaticPoints, is_obstacle: bool):
    assert (len(in_the_way(points)) > 0) == is_obstacle


def test_points_without_sure_height_are_no_obstacles():
    """At 60 m, 0.3 deg of level are 0.3 m of height: 0.7 m over the road may be none."""
    low = [CAMERA_HEIGHT_M - 0.7] * 2
    assert len(in_the_way(points_at(cluster(0.0, low[0], 20.2)))) == 1
    assert len(in_the_way(points_at(cluster(0.0, low[1], 60.2)))) == 0


@pytest.mark.parametrize(("x_m", "is_hit"), [(0.5, True), (0.85, False), (-0.85, False), (1.1, False)])
def test_what_stands_at_the_border_of_our_way_is_no_obstacle(x_m: float, is_hit: bool):
    hazards = obstacles(
        points_at([[x_m, 0.0, 10.2], [x_m, 0.05, 10.2], [x_m, 0.1, 10.2]], spread_m=1e-6),
        OWN.standing_on_road(CAMERA_HEIGHT_M),
        np.array([0.0, 0.0, 10.0]),
        CAMERA_HEIGHT_M,
    )
    exact = replace(hazards, covariance=np.zeros_like(hazards.covariance))
    situation = Situation(exact, OWN.standing_on_road(CAMERA_HEIGHT_M), np.array([0.0, 0.0, 10.0]))
    made = map_of_changes(situation, np.zeros(1), np.zeros(1), 5.0)
    assert (made.probability.item() == 1.0) == is_hit


def test_courses_in_view_are_those_along_which_the_camera_looks():
    ahead = situation_of(seen_frame(), BY_SPEED, OWN)
    np.testing.assert_allclose(ahead.course_rad, np.arctan([-0.9, 0.9]), atol=1e-9)
    backwards = situation_of(replace(seen_frame(), own_direction=np.array([0.0, 0.0, -1.0])), BY_SPEED, OWN)
    assert not backwards.course_rad[0] <= 0.0 <= backwards.course_rad[1]
