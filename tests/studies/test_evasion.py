"""The smallest change of own velocity that avoids a collision."""

from dataclasses import replace

import numpy as np
import pytest

from ttcvid.studies.collision_map.evasion import Evasion, EvasionLimits, EvasionStatus, evade, needed_s
from ttcvid.studies.collision_map.evasion_wording import describe_advice
from ttcvid.studies.collision_map.hazards import Hazards, OwnBody, Situation, joined, one_object
from ttcvid.studies.collision_map.velocity_map import map_of_changes

OWN = OwnBody(1.8, 4.5, 1.5)
LIMITS = EvasionLimits()


def wall(place: tuple[float, float, float], half_width_m: float, velocity: tuple[float, float, float]) -> Hazards:
    return one_object("wall", 1, np.array([place]), np.array([velocity]), np.array([[half_width_m, 1.0, 0.3]]))


def driving(hazards: Hazards, speed_m_s: float = 10.0) -> Situation:
    return Situation(hazards, OWN, np.array([0.0, 0.0, speed_m_s]))


def test_no_danger_no_advice():
    advice = evade(driving(wall((6.0, 0.0, 30.0), 1.0, (0.0, 0.0, -10.0))), LIMITS)
    assert advice.status is EvasionStatus.no_danger
    assert (advice.forward_m_s, advice.right_m_s) == (0.0, 0.0)


def test_danger_later_than_the_time_of_warning_waits():
    far = driving(wall((0.0, 0.0, 45.0), 30.0, (0.0, 0.0, -10.0)))
    assert evade(far, LIMITS).status is EvasionStatus.no_danger
    assert evade(far, replace(LIMITS, warn_s=4.5)).status is EvasionStatus.advice


def test_wall_across_the_way_is_braked_for():
    advice = evade(driving(wall((0.0, 0.0, 30.0), 30.0, (0.0, 0.0, -10.0))), LIMITS)
    assert advice.status is EvasionStatus.advice
    assert advice.right_m_s == pytest.approx(0.0, abs=0.3)
    assert -10.0 <= advice.forward_m_s < -4.0
    assert advice.probability_after <= LIMITS.max_probability < advice.probability_now


def test_post_at_the_left_is_passed_on_the_right():
    post = driving(wall((-0.8, 0.0, 30.0), 0.2, (0.0, 0.0, -10.0)))
    advice = evade(post, LIMITS)
    assert advice.status is EvasionStatus.advice
    assert advice.right_m_s > 0.0
    assert np.hypot(advice.right_m_s, advice.forward_m_s) < 1.5


def test_of_equal_ways_out_braking_is_taken():
    crossing = wall((-18.0, 0.0, 30.0), 0.5, (6.0, 0.0, -10.0))
    advice = evade(driving(crossing), LIMITS)
    assert advice.forward_m_s < 0.0


def test_advice_is_the_smallest_that_suffices():
    situation = driving(wall((0.5, 0.0, 30.0), 1.2, (0.0, 0.0, -10.0)))
    advice = evade(situation, LIMITS)
    less = 0.9 * np.array([advice.forward_m_s]), 0.9 * np.array([advice.right_m_s])
    assert map_of_changes(situation, *less, LIMITS.look_ahead_s).probability.item() == 1.0


def test_no_way_out_is_said_and_the_brakes_are_advised():
    advice = evade(driving(wall((0.0, 0.0, 6.0), 30.0, (0.0, 0.0, -10.0))), LIMITS)
    assert advice.status is EvasionStatus.no_escape
    assert advice.forward_m_s == pytest.approx(-10.0)
    assert advice.probability_after == 1.0


def test_nothing_is_advised_where_going_on_is_enough():
    """A contact at the border of our way, at a distance and speed that are hardly known."""
    covariance = np.zeros((1, 6, 6))
    covariance[0, [0, 2, 5], [0, 2, 5]] = 0.2**2, 4.0**2, 3.0**2
    box = np.array([[2.48, 0.0, 48.0]]), np.array([[0.0, 0.0, -14.0]]), np.array([[1.4, 1.0, 1.0]])
    advice = evade(driving(one_object("car", 1, *box, covariance=covariance), 28.0), LIMITS)
    assert advice.probability_now > LIMITS.max_probability
    assert advice.status is EvasionStatus.no_danger


def test_change_stays_within_what_we_can_do():
    aside = driving(wall((0.0, 0.0, 12.0), 1.0, (0.0, 0.0, -10.0)))
    weak = replace(LIMITS, sideways_m_s2=0.5, braking_m_s2=0.5)
    assert evade(aside, weak).status is EvasionStatus.no_escape
    assert evade(aside, replace(LIMITS, sideways_m_s2=8.0)).status is EvasionStatus.advice


def test_sideways_is_limited_by_the_narrowest_turn_at_walking_pace():
    """At 2.5 m/s a car that turns within 5.5 m pulls no more than 1.1 m/s^2 across."""
    own_m_s = 2.5
    at_once = driving(wall((0.0, 0.0, 5.5), 2.0, (0.0, 0.0, -own_m_s)), own_m_s)
    only_steering = replace(LIMITS, braking_m_s2=0.01)
    assert evade(at_once, only_steering).status is EvasionStatus.no_escape
    assert evade(at_once, replace(only_steering, turning_radius_m=0.0)).status is EvasionStatus.advice
    assert evade(at_once, LIMITS).right_m_s == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("speed_m_s", [1.0, 2.5, 8.0, 25.0])
@pytest.mark.parametrize("place", [(0.0, 0.0, 12.0), (0.7, 0.0, 20.0), (-0.7, 0.0, 5.0)])
def test_no_advice_makes_us_faster_than_we_are(speed_m_s: float, place: tuple[float, float, float]):
    advice = evade(driving(wall(place, 1.0, (0.0, 0.0, -speed_m_s)), speed_m_s), LIMITS)
    assert np.hypot(speed_m_s + advice.forward_m_s, advice.right_m_s) <= speed_m_s + 1e-9


def test_braking_and_steering_share_the_tyres():
    """Each part alone takes 1 s at its limit; both together take longer than either."""
    one_s = needed_s(10.0, np.array([4.0, 10.0, 4.0]), np.array([0.0, 0.3, 3.0 / 7.0]), LIMITS)
    np.testing.assert_allclose(one_s, [1.0, 1.0, np.sqrt(2.0)])


def test_nothing_can_be_changed_that_has_no_limit_to_change_it_by():
    assert needed_s(10.0, np.array([12.0, 10.0]), np.zeros(2), LIMITS).tolist() == [np.inf, 0.0]


def test_only_courses_in_view_are_advised():
    post = driving(wall((-0.8, 0.0, 30.0), 0.2, (0.0, 0.0, -10.0)))
    advice = evade(post, replace(LIMITS, course_rad=(-0.5, 0.0)))
    assert advice.status is EvasionStatus.advice
    assert advice.right_m_s <= 0.0


def test_speeding_up_is_advised_only_where_it_is_allowed():
    from_behind = wall((0.0, 0.0, -15.0), 30.0, (0.0, 0.0, 5.0))
    assert evade(driving(from_behind), LIMITS).forward_m_s <= 0.0
    advice = evade(driving(from_behind), replace(LIMITS, forward_m_s2=3.0))
    assert advice.status is EvasionStatus.advice
    assert advice.forward_m_s > 1.0


def test_wording_names_what_when_and_what_to_do():
    advice = Evasion(EvasionStatus.advice, -2.0, 1.0, 0.98, 0.03, 1.94, 0)
    words = describe_advice(advice, ["lorry"])
    assert words == "lorry in 1.9 s (98 %): brake by 7.2 km/h and 3.6 km/h to the right (then 3 %)"
    unknown = replace(advice, status=EvasionStatus.unknown, time_s=1.2)
    assert describe_advice(unknown, ["lorry"]) == "unknown whether there is a danger: lorry in 1.2 s (98 %)"
    nothing = evade(driving(joined([])), LIMITS)
    assert describe_advice(nothing, []) == "no danger: nothing in the way"
