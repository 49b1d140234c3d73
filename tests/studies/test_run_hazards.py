"""Metres for what a run has seen: own speed, the road, widths; and what has no link."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.studies.hazards import OwnBody
from ttcvid.studies.run_hazards import Scale, SeenFrame, SeenObjects, situation_of
from ttcvid.studies.static_scene import StaticPoints, no_points, obstacles, remembered

OWN = OwnBody(1.8, 4.5, 1.5)
OWN_SPEED_M_S, CAMERA_HEIGHT_M = 10.0, 1.4
CAR_AT_M, CAR_VELOCITY_M_S = np.array([6.0, 0.7, 30.0]), np.array([-4.0, 0.0, -12.0])
BY_SPEED = Scale(OWN_SPEED_M_S, None, {}, None, stands_on_road=True)


def seen_frame(t_s: float = 0.0, moved_m: float = 0.0, motion_id: int = 1) -> SeenFrame:
    """A level road, two posts, and a car 1.8 m wide and 1.4 m high that stands on it, all seen without error."""
    rng = np.random.default_rng(3)
    road = np.column_stack([rng.uniform(-4, 4, 60), np.full(60, CAMERA_HEIGHT_M), rng.uniform(6, 40, 60)])
    posts = np.array([[-3.5, 0.1, 15.5], [3.5, -0.5, 20.5]])
    places = np.concatenate([road, posts]) - [0.0, 0.0, moved_m]
    places = places[places[:, 2] > 1.0]
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
        rays,
        np.linalg.norm(places, axis=1) / OWN_SPEED_M_S,
        np.full(len(places), 0.01),
        objects,
    )


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
    nothing = replace(seen, point_rays=np.empty((0, 3)), point_range_s=np.empty(0), point_sigma=np.empty(0))
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
    found = situation_of(seen_frame(), BY_SPEED, OWN).situation
    assert found is not None
    scene = found.hazards.take(found.hazards.object_index == 0)
    assert found.hazards.names[0] == "static scene"
    np.testing.assert_allclose(sorted(scene.position_m[:, 2]), [15.5, 20.5], rtol=1e-6)
    # They reach down to the road.
    np.testing.assert_allclose(scene.position_m[:, 1] + scene.half_size_m[:, 1], CAMERA_HEIGHT_M, rtol=0.01)
    np.testing.assert_allclose(scene.velocity_m_s, np.tile([0.0, 0.0, -OWN_SPEED_M_S], (2, 1)))


def test_what_has_been_seen_is_remembered_where_it_is_now():
    memory, places = None, []
    for n in range(10):
        seen = seen_frame(t_s=0.1 * n, moved_m=n * 0.1 * OWN_SPEED_M_S)
        if n >= 5:
            seen = replace(seen, point_rays=seen.point_rays[:40], point_range_s=seen.point_range_s[:40])
            seen = replace(seen, point_sigma=seen.point_sigma[:40])
        found = situation_of(seen, replace(BY_SPEED, camera_height_m=CAMERA_HEIGHT_M), OWN, memory)
        memory = found.memory
        assert found.situation is not None
        hazards = found.situation.hazards
        places.append(np.sort(hazards.position_m[hazards.object_index == 0][:, 2]))
    np.testing.assert_allclose(places[-1], [15.5 - 9.0, 20.5 - 9.0], rtol=0.01)


def test_turning_carries_what_is_remembered_to_the_other_side():
    before = StaticPoints(np.array([[0.0, 0.0, 10.0]]), np.array([[0.0, 0.0, 0.1]]), np.array([5]))
    after = remembered(before, no_points(), np.zeros(3), np.radians(90.0))
    np.testing.assert_allclose(after.place_m, [[-10.0, 0.0, 0.0]], atol=1e-9)


def test_what_was_seen_too_seldom_is_not_believed():
    points = StaticPoints(np.array([[0.0, 0.0, 10.0], [5.0, 0.0, 10.0]]), np.full((2, 3), 0.05), np.array([1, 20]))
    np.testing.assert_allclose(obstacles(points, np.array([0.0, 0.0, 10.0]), CAMERA_HEIGHT_M).position_m[:, 0], [5.0])
