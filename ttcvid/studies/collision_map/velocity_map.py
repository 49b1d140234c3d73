"""Which change of own velocity leads to a collision: when, with what, and how probably.

The paper's section 3.3. For every change of own velocity, forward and sideways, each hazard moves along a straight
relative path; a collision is its box touching our outline. Uncertainty is treated as in conjunction analysis of
satellites (Foster and Estes, 1992; Akella and Alfriend, J. Guidance 23, 2000): the covariance of the relative place at
the closest approach, seen along the relative motion, against the extent of both outlines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ttcvid.model import Floats, Ints
from ttcvid.studies.collision_map.contacts import POSSIBLE, Boxes, Leg, add_contacts
from ttcvid.studies.collision_map.hazards import Hazards, Situation, turned_right

NO_OBJECT = -1
LIKELY = 0.5
"""From this probability on a collision counts as likely."""
_TINY = 1e-12
_STILL = 1e-6


@dataclass(frozen=True)
class Outcomes:
    """What becomes of C ways: ``time_s (C,)`` of the earliest possible contact (NaN: none), its probability, with whom.

    ``probability (C,)`` is that of any collision until the horizon; ``object_probability (C, O)`` that of each object;
    ``object_index (C,)`` is the object hit first among those that are hit most probably, or ``NO_OBJECT``.
    """

    time_s: Floats
    probability: Floats
    object_probability: Floats
    object_index: Ints


@dataclass(frozen=True)
class CollisionMap:
    """Outcomes over a grid of changes of own velocity; rows are ``forward_m_s (F,)``, columns ``right_m_s (R,)``.

    ``time_s``, ``probability`` and ``object_index`` are ``(F, R)`` as in `Outcomes`, ``object_probability (F, R, O)``.
    A probability of NaN says that it is unknown.
    """

    forward_m_s: Floats
    right_m_s: Floats
    time_s: Floats
    probability: Floats
    object_probability: Floats
    object_index: Ints
    names: tuple[str, ...]
    cluster_ids: tuple[int, ...]
    horizon_s: float

    def known_within(self, own_speed_m_s: float, course_rad: tuple[float, float]) -> CollisionMap:
        """The map with all that is unknown where nobody looks: beyond the courses in view, from ahead to the right."""
        ahead_m_s = own_speed_m_s + self.forward_m_s[:, None]
        course = np.arctan2(np.broadcast_to(self.right_m_s, self.time_s.shape), ahead_m_s)
        # Who stands still goes nowhere.
        is_still = np.hypot(self.right_m_s, ahead_m_s) <= _STILL * own_speed_m_s
        is_seen = ((course >= course_rad[0]) & (course <= course_rad[1])) | is_still
        return replace(
            self,
            time_s=np.where(is_seen, self.time_s, np.nan),
            probability=np.where(is_seen, self.probability, np.nan),
            object_probability=np.where(is_seen[..., None], self.object_probability, np.nan),
            object_index=np.where(is_seen, self.object_index, NO_OBJECT),
        )


def map_of_changes(situation: Situation, forward_m_s: Floats, right_m_s: Floats, horizon_s: float) -> CollisionMap:
    """The map of a moment.

    Parameters
    ----------
    situation : What could be hit, our own outline and motion.
    forward_m_s, right_m_s : ``(F,)`` and ``(R,)`` changes of own velocity, at once and for good; zero is the present
        velocity.
    horizon_s : How far ahead collisions count.

    Source: the paper's section 3.3.

    A post 20 m straight ahead at 10 m/s is reached in 1.9 s with an outline of 2 m; 10 m/s slower, never:

    >>> from ttcvid.studies.collision_map.hazards import one_object
    >>> post = one_object("post", 0, np.array([[0.0, 0.0, 20.0]]), np.array([[0.0, 0.0, -10.0]]), np.zeros((1, 3)))
    >>> situation = Situation(post, OwnBody(2.0, 2.0, 2.0), np.array([0.0, 0.0, 10.0]))
    >>> map_of_changes(situation, np.array([-10.0, 0.0]), np.array([0.0]), 5.0).time_s
    array([[nan],
           [1.9]])
    """
    forward, right = np.meshgrid(forward_m_s, right_m_s, indexing="ij")
    change = np.stack([right.ravel(), np.zeros(right.size), forward.ravel()], axis=1)
    outcome = outcomes(situation, ways(situation, change, horizon_s), horizon_s)
    shape = forward.shape
    return CollisionMap(
        forward_m_s,
        right_m_s,
        outcome.time_s.reshape(shape),
        outcome.probability.reshape(shape),
        outcome.object_probability.reshape(*shape, -1),
        outcome.object_index.reshape(shape),
        situation.hazards.names,
        situation.hazards.cluster_ids,
        horizon_s,
    )


def family_maps(situation: Situation, name: str, forward_m_s: Floats, right_m_s: Floats, horizon_s: float) -> Floats:
    """Probability of hitting an object by each of its alternatives, were that the true one: ``(K, F, R)``."""
    hazards = situation.hazards
    is_of_object = hazards.object_index == hazards.names.index(name)
    maps = []
    for alternative in np.unique(hazards.alternative[is_of_object]):
        member = hazards.take(is_of_object & (hazards.alternative == alternative))
        alone = replace(situation, hazards=replace(member, weight=np.ones(len(member))))
        maps.append(map_of_changes(alone, forward_m_s, right_m_s, horizon_s).probability)
    return np.stack(maps)


def outcomes(situation: Situation, legs: Sequence[Leg], horizon_s: float) -> Outcomes:
    """What becomes of C ways, each given by one or more legs that follow each other until ``horizon_s``."""
    hazards, own = situation.hazards, situation.own
    n_ways, n_objects = len(legs[0].change_m_s), len(hazards.names)
    fastest = max(float(np.linalg.norm(leg.change_m_s, axis=1).max(initial=0.0)) for leg in legs)
    near = hazards.within_reach(own.reach_m, fastest, horizon_s)
    if len(near) == 0:
        nothing = np.full(n_ways, np.nan), np.zeros(n_ways), np.zeros((n_ways, n_objects))
        return Outcomes(*nothing, np.full(n_ways, NO_OBJECT))
    time, probability = (np.full((len(near), n_ways), fill) for fill in (np.inf, 0.0))
    times_s = np.array([legs[0].start_s, *(leg.end_s for leg in legs)])
    for leg, then in zip(legs, near.along(times_s, situation.own_velocity_m_s), strict=True):
        # A hazard that is met in two legs is met in the one in which that is more probable, not twice.
        boxes = Boxes(
            then.position_m - own.middle_m, then.velocity_m_s, then.half_size_m, then.yaw_rad, then.covariance
        )
        add_contacts(boxes, own.half_m, own.is_round, leg, time, probability)
    return _by_object(near, time, probability, n_objects)


def ways(situation: Situation, change_m_s: Floats, horizon_s: float, ramp_s: Floats | None = None) -> list[Leg]:
    """The ways that C changes of the present velocity ``(C, 3)`` lead, in level axes.

    ``ramp_s (C,)`` is how long it takes until a change is complete, at constant acceleration; None: it is there at
    once. The changed velocity turns as the present one does. One leg where everything is straight, else a leg each
    quarter of a second; what is straight after the changes are complete is one leg again.
    """
    own_velocity_m_s, turn_rad_s = situation.own_velocity_m_s, situation.own_turn_rad_s
    if ramp_s is None and turn_rad_s == 0.0 and situation.hazards.is_straight:
        return [Leg(0.0, horizon_s, np.zeros_like(change_m_s), change_m_s)]
    knots = leg_times(horizon_s)
    if turn_rad_s == 0.0 and situation.hazards.is_straight and ramp_s is not None:
        knots = np.unique(np.append(knots[knots < ramp_s.max()], [min(float(ramp_s.max()), horizon_s), horizon_s]))
    shift, legs = np.zeros_like(change_m_s), []
    for start, end in pairwise(knots.tolist()):
        share = 1.0 if ramp_s is None else (_ramped_s(end, ramp_s) - _ramped_s(start, ramp_s))[:, None] / (end - start)
        changed = own_velocity_m_s + share * change_m_s
        extra = turned_right(changed, 0.5 * turn_rad_s * (start + end)) - own_velocity_m_s
        legs.append(Leg(start, end, shift, extra))
        shift = shift + (end - start) * extra
    return legs


def leg_times(horizon_s: float, longest_s: float = 0.25) -> Floats:
    """Times that divide a curved way into legs; over 0.25 s at 6 m/s^2, a chord is off its curve by 5 cm at most."""
    return np.linspace(0.0, horizon_s, 1 + int(np.ceil(horizon_s / longest_s - 1e-9)))


def _ramped_s(t_s: float, ramp_s: Floats) -> Floats:
    """Integral of min(t / ramp, 1) from 0 to ``t_s``."""
    safe = np.maximum(ramp_s, _TINY)
    return np.where(t_s < ramp_s, 0.5 * t_s**2 / safe, t_s - 0.5 * ramp_s)


def _by_object(hazards: Hazards, time: Floats, probability: Floats, n_objects: int) -> Outcomes:
    """Boxes ``(N, C)`` gathered: together in an alternative, weighted over alternatives, independent over objects."""
    n_ways = time.shape[1]
    key = hazards.object_index * (hazards.alternative.max() + 1) + hazards.alternative
    first = np.flatnonzero(np.diff(key, prepend=-1))
    by_alternative = np.maximum.reduceat(probability, first, axis=0) * hazards.weight[first, None]
    owner = hazards.object_index[first]
    first_of_object = np.flatnonzero(np.diff(owner, prepend=-1))
    present = owner[first_of_object]
    by_object = np.zeros((n_objects, n_ways))
    by_object[present] = np.minimum(np.add.reduceat(by_alternative, first_of_object, axis=0), 1.0)
    first_box = np.flatnonzero(np.diff(hazards.object_index, prepend=-1))
    object_time = np.full((n_objects, n_ways), np.inf)
    object_time[present] = np.minimum.reduceat(np.where(probability >= POSSIBLE, time, np.inf), first_box, axis=0)
    total = 1.0 - np.prod(1.0 - by_object, axis=0)
    # Who is named is hit first among the likely ones; where none is likely, among the possible ones.
    is_candidate = by_object >= np.where(by_object.max(axis=0, initial=0.0) >= LIKELY, LIKELY, POSSIBLE)
    candidate_time = np.where(is_candidate, object_time, np.inf)
    earliest = candidate_time.min(axis=0)
    is_hit = np.isfinite(earliest)
    return Outcomes(
        np.where(is_hit, earliest, np.nan),
        total,
        by_object.T,
        np.where(is_hit, candidate_time.argmin(axis=0), NO_OBJECT),
    )
