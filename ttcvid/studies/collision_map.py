"""Which change of own velocity leads to a collision: when, with what, and how probably.

The paper's section 3.3. For every change of own velocity, forward and sideways, each hazard moves along a straight
relative path; a collision is its box touching our outline. Uncertainty is treated as in conjunction analysis of
satellites (Foster and Estes, 1992; Akella and Alfriend, J. Guidance 23, 2000): the covariance of the relative place at
the closest approach, seen along the relative motion, against the extent of both outlines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import ndtr

from ttcvid.model import Floats, Ints
from ttcvid.studies.hazards import AHEAD, DOWN, RIGHT, Hazards, OwnBody, Situation, turned_right

NO_OBJECT = -1
LIKELY = 0.5
"""From this probability on a collision counts as likely."""
POSSIBLE = 0.05
"""Below this probability nothing is said of a cell: no time, no object."""
_ROUND_DIRECTIONS = 8
"""Slabs that stand for a round outline: the polygon of 16 sides around a circle exceeds it by 2 % at its corners."""
_TINY = 1e-12


@dataclass(frozen=True)
class Leg:
    """A stretch of C ways that we could go, in which our velocity differs from the present one by a constant.

    ``change_m_s (C, 3)`` in level axes, from ``start_s`` to ``end_s``; ``shift_m (C, 3)`` is how far we are by then
    from where the present velocity would have brought us.
    """

    start_s: float
    end_s: float
    shift_m: Floats
    change_m_s: Floats


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


def map_of_changes(situation: Situation, forward_m_s: Floats, right_m_s: Floats, horizon_s: float) -> CollisionMap:
    """The map of a moment.

    Parameters
    ----------
    situation
        What could be hit, our own outline and motion.
    forward_m_s, right_m_s
        ``(F,)`` and ``(R,)`` changes of own velocity, at once and for good; zero is the present velocity.
    horizon_s
        How far ahead collisions count.

    Source: the paper's section 3.3.

    A post 20 m straight ahead at 10 m/s is reached in 1.9 s with an outline of 2 m; 10 m/s slower, never:

    >>> from ttcvid.studies.hazards import one_object
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
        leg_time, leg_probability = _contacts(then, own, leg)
        # A hazard that is met in two legs is met in the one in which that is more probable, not twice.
        is_earlier = (leg_probability >= POSSIBLE) & (leg_time < time)
        time = np.where(is_earlier, leg_time, time)
        probability = np.maximum(probability, leg_probability)
    return _by_object(near, time, probability, n_objects)


def ways(situation: Situation, change_m_s: Floats, horizon_s: float, ramp_s: Floats | None = None) -> list[Leg]:
    """The ways that C changes of the present velocity ``(C, 3)`` lead, in level axes.

    ``ramp_s (C,)`` is how long it takes until a change is complete, at constant acceleration; None: it is there at
    once. The changed velocity turns as the present one does. One leg where everything is straight, else a leg each
    quarter of a second.
    """
    own_velocity_m_s, turn_rad_s = situation.own_velocity_m_s, situation.own_turn_rad_s
    if ramp_s is None and turn_rad_s == 0.0 and situation.hazards.is_straight:
        return [Leg(0.0, horizon_s, np.zeros_like(change_m_s), change_m_s)]
    knots = leg_times(horizon_s)
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


def _contacts(hazards: Hazards, own: OwnBody, leg: Leg) -> tuple[Floats, Floats]:
    """Time of contact (or of the closest approach) and probability of contact ``(N, C)`` within one leg."""
    place = [hazards.position_m[:, None, k] - leg.shift_m[None, :, k] for k in range(3)]
    speed = [hazards.velocity_m_s[:, None, k] - leg.change_m_s[None, :, k] for k in range(3)]
    duration = leg.end_s - leg.start_s
    enter, leave = _touching(hazards, own, place, speed)
    is_contact = (enter <= leave) & (leave >= 0.0) & (enter <= duration)
    if hazards.is_exact:
        return np.where(is_contact, leg.start_s + np.maximum(enter, 0.0), np.inf), is_contact.astype(float)
    closest, probability = _probability(hazards, own, place, speed, leg.start_s, duration)
    return leg.start_s + np.where(is_contact, np.maximum(enter, 0.0), closest), probability


def _touching(hazards: Hazards, own: OwnBody, place: list[Floats], speed: list[Floats]) -> tuple[Floats, Floats]:
    """From when until when boxes touch our outline ``(N, C)`` in s; enter > leave: never.

    The sum of two convex outlines that are symmetric about their centres is cut out by slabs abs(n.x) <= h(n), one for
    each edge direction; the time inside is the intersection of the times inside each slab.
    """
    right = [np.cos(hazards.yaw_rad), -np.sin(hazards.yaw_rad)]
    ahead = [np.sin(hazards.yaw_rad), np.cos(hazards.yaw_rad)]
    angles = np.pi * np.arange(_ROUND_DIRECTIONS) / _ROUND_DIRECTIONS if own.is_round else np.array([0.0, 0.5 * np.pi])
    axes = [right, ahead, *([np.full(1, np.cos(a)), np.full(1, np.sin(a))] for a in angles)]
    half_down = hazards.half_size_m[:, DOWN]
    enter, leave = _slab(place[DOWN], speed[DOWN], (half_down + 0.5 * own.height_m)[:, None])
    share = _share_at_meeting(hazards, own, place, speed)
    for x, z in axes:
        half = _box_half_extent(hazards, x, z)[:, None] + own.half_extent_m(x, z)[:, None] * share
        along = x[:, None] * place[RIGHT] + z[:, None] * place[AHEAD]
        rate = x[:, None] * speed[RIGHT] + z[:, None] * speed[AHEAD]
        slab_enter, slab_leave = _slab(along, rate, half)
        np.maximum(enter, slab_enter, out=enter)
        np.minimum(leave, slab_leave, out=leave)
    return enter, leave


def _share_at_meeting(hazards: Hazards, own: OwnBody, place: list[Floats], speed: list[Floats]) -> Floats | float:
    """How wide a round outline is at the height at which it meets each box; 1 for one with upright sides."""
    if not own.is_round:
        return 1.0
    pace2 = np.maximum(speed[RIGHT] ** 2 + speed[AHEAD] ** 2, _TINY)
    closest = np.maximum(-(place[RIGHT] * speed[RIGHT] + place[AHEAD] * speed[AHEAD]) / pace2, 0.0)
    below_m = np.abs(place[DOWN] + closest * speed[DOWN]) - hazards.half_size_m[:, None, DOWN]
    return own.share_at_height(np.maximum(below_m, 0.0))


def _slab(along: Floats, rate: Floats, half: Floats) -> tuple[Floats, Floats]:
    """From when until when abs(along + rate t) <= half; without a rate that is always, or so late as never."""
    inverse = 1.0 / np.where(np.abs(rate) < _TINY, _TINY, rate)
    middle, reach = -along * inverse, half * np.abs(inverse)
    return middle - reach, middle + reach


def _box_half_extent(hazards: Hazards, x: Floats, z: Floats) -> Floats:
    """Half the extent of each box along horizontal unit vectors (x right, z ahead)."""
    cos, sin = np.cos(hazards.yaw_rad), np.sin(hazards.yaw_rad)
    width, length = hazards.half_size_m[:, RIGHT], hazards.half_size_m[:, AHEAD]
    if x.ndim == 2:
        cos, sin, width, length = (v[:, None] for v in (cos, sin, width, length))
    return width * np.abs(cos * x - sin * z) + length * np.abs(sin * x + cos * z)


def _probability(
    hazards: Hazards, own: OwnBody, place: list[Floats], speed: list[Floats], start_s: float, duration_s: float
) -> tuple[Floats, Floats]:
    """Time of the closest approach within a leg and the probability of contact ``(N, C)``.

    The product of three: we are not past each other at its start and have met by its end (along the motion), the paths
    cross within both outlines (across it), and at one height.
    """
    pace = np.maximum(np.hypot(speed[RIGHT], speed[AHEAD]), _TINY)
    x, z = speed[RIGHT] / pace, speed[AHEAD] / pace
    along = x * place[RIGHT] + z * place[AHEAD]
    across = z * place[RIGHT] - x * place[AHEAD]
    closest = np.clip(-along / pace, 0.0, duration_s)
    half_along = _box_half_extent(hazards, x, z) + own.half_extent_m(x, z)
    half_across = _box_half_extent(hazards, z, -x) + own.half_extent_m(z, -x)
    half_down = (hazards.half_size_m[:, DOWN] + 0.5 * own.height_m)[:, None]
    down = place[DOWN] + closest * speed[DOWN]
    sigma_across = _sigma(hazards, start_s + closest, z, -x)
    sigma_start = _sigma(hazards, np.full(1, start_s), x, z)
    sigma_end = _sigma(hazards, np.full(1, start_s + duration_s), x, z)
    sigma_down = _sigma_down(hazards, start_s + closest)
    probability = ndtr((half_across - across) / sigma_across) - ndtr((-half_across - across) / sigma_across)
    probability *= ndtr((half_along + along + pace * duration_s) / sigma_end)
    probability *= ndtr((half_along - along) / sigma_start)
    probability *= ndtr((half_down - down) / sigma_down) - ndtr((-half_down - down) / sigma_down)
    return closest, probability


def _sigma(hazards: Hazards, t_s: Floats, x: Floats, z: Floats) -> Floats:
    """Standard deviation of the relative place at times ``t_s`` along horizontal unit vectors (x right, z ahead)."""
    variance: Floats | float = 0.0
    for i, j, factor in ((RIGHT, RIGHT, x * x), (RIGHT, AHEAD, 2.0 * x * z), (AHEAD, AHEAD, z * z)):
        variance = variance + factor * _variance(hazards.covariance, i, j, t_s)
    return np.sqrt(np.maximum(variance, _TINY))


def _sigma_down(hazards: Hazards, t_s: Floats) -> Floats:
    return np.sqrt(np.maximum(_variance(hazards.covariance, DOWN, DOWN, t_s), _TINY))


def _variance(covariance: Floats, i: int, j: int, t_s: Floats) -> Floats:
    """Element (i, j) of the covariance of P + V t."""
    constant, square = covariance[:, i, j], covariance[:, 3 + i, 3 + j]
    linear = covariance[:, i, 3 + j] + covariance[:, j, 3 + i]
    return constant[:, None] + t_s * (linear[:, None] + t_s * square[:, None])


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
