"""Which change of own velocity leads to a collision: against hand-made cases, brute force and Monte-Carlo."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.studies.collision_map.hazards import Hazards, OwnBody, Situation, joined, one_object
from ttcvid.studies.collision_map.velocity_map import NO_OBJECT, map_of_changes

BALL = OwnBody(2.0, 2.0, 2.0, is_round=True)
CAR = OwnBody(1.8, 4.5, 1.5)
ZERO = np.zeros(1)


def thing(
    name: str = "thing",
    place: tuple[float, float, float] = (0.0, 0.0, 20.0),
    velocity: tuple[float, float, float] = (0.0, 0.0, -10.0),
    half_size: tuple[float, float, float] = (0.5, 0.5, 0.5),
    **more: object,
) -> Hazards:
    return one_object(name, 1, np.array([place]), np.array([velocity]), np.array([half_size]), **more)  # type: ignore[arg-type]


def moment(hazards: Hazards, own: OwnBody = BALL, speed_m_s: float = 10.0, turn_rad_s: float = 0.0) -> Situation:
    return Situation(hazards, own, np.array([0.0, 0.0, speed_m_s]), turn_rad_s)


def test_time_of_contact_is_distance_between_outlines_over_closing_speed():
    made = map_of_changes(moment(thing()), np.array([-5.0, 0.0, 10.0]), ZERO, 10.0)
    gap_m = 20.0 - 0.5 - 1.0
    np.testing.assert_allclose(made.time_s[:, 0], gap_m / np.array([5.0, 10.0, 20.0]))
    assert (made.probability == 1.0).all()
    assert made.names[made.object_index[0, 0]] == "thing"


def test_what_is_later_than_the_look_ahead_does_not_count():
    made = map_of_changes(moment(thing()), ZERO, ZERO, 1.0)
    assert np.isnan(made.time_s).all()
    assert made.probability.item() == 0.0
    assert made.object_index.item() == NO_OBJECT


def test_what_has_passed_does_not_count():
    behind = thing(place=(0.0, 0.0, -5.0))
    assert map_of_changes(moment(behind), ZERO, ZERO, 5.0).probability.item() == 0.0


def test_what_touches_us_now_is_hit_at_once():
    beside = thing(place=(1.2, 0.0, 0.0), velocity=(0.0, 0.0, 0.0))
    assert map_of_changes(moment(beside), ZERO, ZERO, 5.0).time_s.item() == 0.0


def test_what_passes_over_us_is_no_collision():
    above = thing(place=(0.0, -3.0, 20.0))
    assert map_of_changes(moment(above), ZERO, ZERO, 5.0).probability.item() == 0.0


def test_a_car_is_longer_than_wide():
    crossing = thing(place=(-30.0, 0.0, 2.0), velocity=(10.0, 0.0, 0.0))
    assert map_of_changes(moment(crossing, CAR), ZERO, ZERO, 5.0).time_s.item() == pytest.approx((30 - 0.5 - 0.9) / 10)
    wide = moment(crossing, OwnBody(4.5, 1.8, 1.5))
    assert map_of_changes(wide, ZERO, ZERO, 5.0).probability.item() == 0.0


def test_earliest_of_several_is_named():
    both = joined([thing("far", place=(0, 0, 30)), thing("near", place=(0, 0, 20))])
    made = map_of_changes(moment(both), ZERO, ZERO, 5.0)
    assert made.names[made.object_index.item()] == "near"
    np.testing.assert_array_equal(made.object_probability[0, 0], [1.0, 1.0])


def test_mirrored_world_gives_mirrored_map():
    changes = np.linspace(-8.0, 8.0, 17)
    left = thing(place=(-6.0, 0.0, 25.0), velocity=(2.0, 0.0, -9.0), half_size=(0.9, 0.7, 2.0), yaw_rad=0.4)
    right = thing(place=(6.0, 0.0, 25.0), velocity=(-2.0, 0.0, -9.0), half_size=(0.9, 0.7, 2.0), yaw_rad=-0.4)
    one, other = (map_of_changes(moment(hazard, CAR), changes, changes, 5.0) for hazard in (left, right))
    np.testing.assert_allclose(one.time_s, other.time_s[:, ::-1])


def test_scaling_time_scales_the_times():
    changes = np.linspace(-8.0, 8.0, 17)
    fast, slow = thing(velocity=(1.0, 0.0, -10.0)), thing(velocity=(0.5, 0.0, -5.0))
    one = map_of_changes(moment(fast), changes, changes, 4.0)
    other = map_of_changes(moment(slow), 0.5 * changes, 0.5 * changes, 8.0)
    np.testing.assert_allclose(2.0 * one.time_s, other.time_s)


def test_who_turns_hits_what_stands_on_the_circle_and_misses_what_stands_straight_ahead():
    radius_m = 10.0 / 0.25
    angle = 0.6
    on_circle = (radius_m * (1 - np.cos(angle)), 0.0, radius_m * np.sin(angle))
    posts = joined([thing("on the circle", place=on_circle), thing("straight ahead", place=(0.0, 0.0, 30.0))])
    straight = map_of_changes(moment(posts), ZERO, ZERO, 5.0)
    turning = map_of_changes(moment(posts, turn_rad_s=0.25), ZERO, ZERO, 5.0)
    np.testing.assert_array_equal(straight.object_probability[0, 0], [0.0, 1.0])
    np.testing.assert_array_equal(turning.object_probability[0, 0], [1.0, 0.0])


def test_what_brakes_to_a_halt_is_reached_though_it_is_as_fast_as_we_are():
    lead = thing(place=(0.0, 0.0, 16.5), velocity=(0.0, 0.0, 0.0))
    lead = replace(lead, acceleration_m_s2=np.array([-5.0]))
    made = map_of_changes(moment(lead), ZERO, ZERO, 6.0)
    # 15 m between us; it stands after 2 s and 10 m, we cover 25 m in 2.5 s.
    assert made.time_s.item() == pytest.approx(2.5, abs=0.01)


@pytest.mark.parametrize(("closing_m_s", "look_ahead_s"), [(12.0, 4.0), (4.0, 6.0)])
def test_probability_agrees_with_monte_carlo(closing_m_s: float, look_ahead_s: float):
    sigma = np.array([0.4, 0.05, 1.5, 0.4, 0.02, 0.8])
    covariance = np.diag(sigma**2)
    covariance[2, 5] = covariance[5, 2] = 0.6 * sigma[2] * sigma[5]
    place, velocity = np.array([1.5, 0.0, 24.0]), np.array([0.3, 0.0, -closing_m_s])
    half = (0.9, 0.7, 2.0)
    hazard = thing(place=tuple(place), velocity=tuple(velocity), half_size=half, covariance=covariance[None])
    right = np.array([-2.0, -0.5, 0.0, 0.5, 1.0, 2.0])
    made = map_of_changes(moment(hazard, CAR), ZERO, right, look_ahead_s)
    drawn = np.random.default_rng(5).multivariate_normal([*place, *velocity], covariance, 4000)
    many = joined([thing(place=tuple(d[:3]), velocity=tuple(d[3:]), half_size=half) for d in drawn])
    hit = map_of_changes(moment(many, CAR), ZERO, right, look_ahead_s).object_probability
    np.testing.assert_allclose(made.probability[0], hit.mean(axis=2)[0], atol=0.05)
    assert 0.1 < made.probability[0, 2] < 0.999


def test_alternatives_of_an_object_are_weighted_and_independent_objects_add_up():
    where = Hazards(
        np.array([[0.0, 0.0, 20.0], [8.0, 0.0, 20.0], [0.0, 0.0, 25.0]]),
        np.tile([0.0, 0.0, -10.0], (3, 1)),
        np.full((3, 3), 0.5),
        np.zeros(3),
        np.zeros((3, 6, 6)),
        np.zeros(3),
        np.zeros(3),
        np.array([0, 0, 1]),
        np.array([0, 1, 0]),
        np.array([0.4, 0.6, 1.0]),
        ("either", "other"),
        (1, 2),
    )
    made = map_of_changes(moment(where), ZERO, ZERO, 5.0)
    np.testing.assert_allclose(made.object_probability[0, 0], [0.4, 1.0])
    assert made.names[made.object_index.item()] == "other"
    only = where.take(np.array([True, True, False]))
    made = map_of_changes(moment(only), ZERO, ZERO, 5.0)
    assert made.probability.item() == pytest.approx(0.4)
    assert made.time_s.item() == pytest.approx(1.85)


def test_an_empty_world_is_free():
    made = map_of_changes(moment(joined([])), np.linspace(-1, 1, 3), np.linspace(-1, 1, 3), 5.0)
    assert np.isnan(made.time_s).all()
    assert (made.probability == 0).all()


def test_where_nobody_looks_the_map_says_unknown():
    """The camera sees 45 deg to either side: farther aside, and backwards, all is unknown; a stop is not."""
    made = map_of_changes(moment(thing()), np.array([-12.0, -10.0, -8.0, 0.0]), np.array([-3.0, 0.0, 3.0]), 5.0)
    seen = made.known_within(10.0, (-np.pi / 4, np.pi / 4))
    is_known = [[False, False, False], [False, True, False], [False, True, False], [True, True, True]]
    np.testing.assert_array_equal(np.isfinite(seen.probability), is_known)
    assert (seen.object_index[~np.array(is_known)] == NO_OBJECT).all()
    np.testing.assert_array_equal(seen.probability[3], made.probability[3])
