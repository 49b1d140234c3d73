"""When, and how probably, boxes that move past us touch our outline, over a stretch of straight relative motion.

Boxes and outline are symmetric about their centres, so the sum of both is cut out by slabs abs(n.x) <= h(n), one for
each edge direction, and the time of contact is the intersection of the times inside each slab.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from ttcvid.model import Floats, Ints

RIGHT, DOWN, AHEAD = 0, 1, 2
"""Places of the level axes in a vector."""
POSSIBLE = 0.05
"""Below this probability nothing is said of a contact: no time, no object."""

# Slabs that stand for a round outline: the polygon of 16 sides around a circle exceeds it by 2 % at its corners.
_ROUND_DIRECTIONS = 8
_TINY = 1e-12
# What stays farther off than this many of its standard deviations has no probability worth computing.
_FAR_SIGMAS = 5.0


@dataclass(frozen=True)
class Boxes:
    """N boxes at the start of a stretch, in level axes.

    ``position_m, velocity_m_s, half_size_m (N, 3)`` and ``yaw_rad (N,)``;
    ``covariance (N, 6, 6)`` is that of place and velocity now; without it a box is known exactly.
    """

    position_m: Floats
    velocity_m_s: Floats
    half_size_m: Floats
    yaw_rad: Floats
    covariance: Floats


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
class _Outlines:
    """M boxes and our own outline, by their extents: ``half_size_m (M, 3)``, ``yaw_rad (M,)``, ``own_half_m (3,)``."""

    half_size_m: Floats
    yaw_rad: Floats
    own_half_m: Floats
    is_round: bool

    @property
    def reach_down(self) -> Floats:
        """Half the height of both together, ``(M,)``."""
        reach: Floats = self.half_size_m[:, DOWN] + self.own_half_m[DOWN]
        return reach

    def box_extent(self, n_right: Floats | float, n_ahead: Floats | float) -> Floats:
        """Half the extent of each turned box along a horizontal unit vector (its support function)."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        across, along = np.abs(c * n_right - s * n_ahead), np.abs(s * n_right + c * n_ahead)
        extent: Floats = self.half_size_m[:, RIGHT] * across + self.half_size_m[:, AHEAD] * along
        return extent

    def own_extent(self, n_right: Floats | float, n_ahead: Floats | float) -> Floats:
        """Half our own extent along a horizontal unit vector, at the height of the camera."""
        across, along = self.own_half_m[RIGHT] * n_right, self.own_half_m[AHEAD] * n_ahead
        extent: Floats = np.hypot(across, along) if self.is_round else np.abs(across) + np.abs(along)
        return extent


def add_contacts(
    boxes: Boxes, own_half_m: Floats, is_round: bool, leg: Leg, time_s: Floats, probability: Floats
) -> None:
    """Contacts of N boxes on C ways within one stretch, entered where they are earlier or more probable than before.

    Parameters
    ----------
    boxes : At the start of the stretch, places relative to the middle of our own outline.
    own_half_m : ``(3,)`` half our width, height and length; with ``is_round`` the half-axes of an ellipsoid.
    leg : The stretch.
    time_s, probability : ``(N, C)``, changed in place: the earliest time from now at which a contact is possible
        (infinite: none), and the probability of a contact in the likeliest stretch. Where the box is known exactly it
        is 0 or 1.
    """
    duration_s = leg.end_s - leg.start_s
    factors = _variances(boxes.covariance)
    box, way = _near(boxes, factors, own_half_m, leg)
    if len(box) == 0:
        return
    place_m = boxes.position_m[box] - leg.shift_m[way]
    velocity_m_s = boxes.velocity_m_s[box] - leg.change_m_s[way]
    closest_s = _closest_s(place_m, velocity_m_s, duration_s)
    outlines = _Outlines(boxes.half_size_m[box], boxes.yaw_rad[box], own_half_m, is_round)
    is_exact = (boxes.covariance == 0.0).all(axis=(1, 2))[box]
    p = np.where(is_exact, 1.0, _probability(place_m, velocity_m_s, closest_s, outlines, factors[:, :, box], leg))
    enter, leave = _touching(place_m, velocity_m_s, closest_s, outlines)
    is_contact = (enter <= leave) & (leave >= 0.0) & (enter <= duration_s)
    found = np.where(is_exact & ~is_contact, 0.0, p)
    probability[box, way] = np.maximum(probability[box, way], found)
    when_s = leg.start_s + np.where(is_contact, np.maximum(enter, 0.0), closest_s)
    time_s[box, way] = np.minimum(time_s[box, way], np.where(found >= POSSIBLE, when_s, np.inf))


def _near(boxes: Boxes, factors: Floats, own_half_m: Floats, leg: Leg) -> tuple[Ints, Ints]:
    """Pairs of a box and a way that come near enough for a contact that is not negligible: two ``(M,)``."""
    largest_sigma = np.maximum(_largest_sigma(factors, leg.start_s), _largest_sigma(factors, leg.end_s))
    half = boxes.half_size_m
    own_reach = math.hypot(own_half_m[RIGHT], own_half_m[AHEAD])
    reach = np.hypot(half[:, RIGHT], half[:, AHEAD]) + own_reach + _FAR_SIGMAS * largest_sigma
    place_m = boxes.position_m[:, None] - leg.shift_m
    velocity_m_s = boxes.velocity_m_s[:, None] - leg.change_m_s
    closest_s = _closest_s(place_m, velocity_m_s, leg.end_s - leg.start_s)
    nearest = place_m + closest_s[..., None] * velocity_m_s
    box, way = np.nonzero(nearest[..., RIGHT] ** 2 + nearest[..., AHEAD] ** 2 <= reach[:, None] ** 2)
    return box, way


def _closest_s(place_m: Floats, velocity_m_s: Floats, duration_s: float) -> Floats:
    """When boxes ``(..., 3)`` pass our middle most closely, seen from above and within a stretch."""
    level = [RIGHT, AHEAD]
    pace2 = np.maximum((velocity_m_s[..., level] ** 2).sum(axis=-1), _TINY)
    closest: Floats = np.clip(-(place_m[..., level] * velocity_m_s[..., level]).sum(axis=-1) / pace2, 0.0, duration_s)
    return closest


def _touching(place_m: Floats, velocity_m_s: Floats, closest_s: Floats, outlines: _Outlines) -> tuple[Floats, Floats]:
    """From when until when M boxes touch us, from the start of the stretch; enter > leave: never."""
    own_half, turn = outlines.own_half_m, -outlines.yaw_rad
    enter, leave = _slab(place_m[:, DOWN], velocity_m_s[:, DOWN], outlines.reach_down)
    below = np.maximum(np.abs(place_m[:, DOWN] + closest_s * velocity_m_s[:, DOWN]) - outlines.half_size_m[:, DOWN], 0)
    share = np.ones(len(below))
    if outlines.is_round:
        # An ellipsoid is narrower at the height of meeting than in its middle.
        share = np.sqrt(np.maximum(1.0 - (below / own_half[DOWN]) ** 2, 0.0))
    n_own = _ROUND_DIRECTIONS if outlines.is_round else 2
    own_angles = [np.full(len(turn), math.pi * k / n_own) for k in range(n_own)]
    for angle in (turn, turn + 0.5 * math.pi, *own_angles):
        n_right, n_ahead = np.cos(angle), np.sin(angle)
        slab_enter, slab_leave = _slab(
            n_right * place_m[:, RIGHT] + n_ahead * place_m[:, AHEAD],
            n_right * velocity_m_s[:, RIGHT] + n_ahead * velocity_m_s[:, AHEAD],
            outlines.box_extent(n_right, n_ahead) + share * outlines.own_extent(n_right, n_ahead),
        )
        enter, leave = np.maximum(enter, slab_enter), np.minimum(leave, slab_leave)
    return enter, leave


def _slab(along: Floats, rate: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """From when until when abs(along + rate t) <= reach; without a rate that is always, or so late as never."""
    safe = np.where(np.abs(rate) > _TINY, rate, _TINY)
    middle, spread = -along / safe, reach / np.abs(safe)
    return middle - spread, middle + spread


def _probability(
    place_m: Floats, velocity_m_s: Floats, closest_s: Floats, outlines: _Outlines, factors: Floats, leg: Leg
) -> Floats:
    """Probability of contact within a stretch, of M boxes whose places have the variances ``factors (4, 3, M)``.

    The product of four: the paths cross within both outlines (across the relative motion), at one height, we are not
    past each other at the start, and have met by the end (along the motion).
    """
    pace = np.sqrt(np.maximum(velocity_m_s[:, RIGHT] ** 2 + velocity_m_s[:, AHEAD] ** 2, _TINY))
    right, ahead = velocity_m_s[:, RIGHT] / pace, velocity_m_s[:, AHEAD] / pace
    along = right * place_m[:, RIGHT] + ahead * place_m[:, AHEAD]
    across = ahead * place_m[:, RIGHT] - right * place_m[:, AHEAD]
    reach_along = outlines.box_extent(right, ahead) + outlines.own_extent(right, ahead)
    reach_across = outlines.box_extent(ahead, -right) + outlines.own_extent(ahead, -right)
    at_closest_s = leg.start_s + closest_s
    sigma_down = np.sqrt(np.maximum(_at(factors[3], at_closest_s), _TINY))
    down = place_m[:, DOWN] + closest_s * velocity_m_s[:, DOWN]
    probability: Floats = (
        _between(across, reach_across, _sigma(factors, at_closest_s, ahead, -right))
        * ndtr((reach_along + along + pace * (leg.end_s - leg.start_s)) / _sigma(factors, leg.end_s, right, ahead))
        * ndtr((reach_along - along) / _sigma(factors, leg.start_s, right, ahead))
        * _between(down, outlines.reach_down, sigma_down)
    )
    return probability


def _between(mean: Floats, reach: Floats, sigma: Floats) -> Floats:
    """Probability that a normal variable lies within +-reach."""
    inside: Floats = ndtr((reach - mean) / sigma) - ndtr((-reach - mean) / sigma)
    return inside


def _variances(covariance: Floats) -> Floats:
    """Of the variances of P + V t, right right, right ahead, ahead ahead, down down: factors of 1, t, t^2 (4, 3, N)."""
    pairs = ((RIGHT, RIGHT), (RIGHT, AHEAD), (AHEAD, AHEAD), (DOWN, DOWN))
    return np.array(
        [
            [covariance[:, i, j], covariance[:, i, 3 + j] + covariance[:, 3 + i, j], covariance[:, 3 + i, 3 + j]]
            for i, j in pairs
        ]
    )


def _at(factors: Floats, t_s: Floats | float) -> Floats:
    """A variance with the ``factors (3, M)`` at a time."""
    variance: Floats = factors[0] + t_s * (factors[1] + t_s * factors[2])
    return variance


def _sigma(factors: Floats, t_s: Floats | float, n_right: Floats, n_ahead: Floats) -> Floats:
    """Standard deviation of P + V t along horizontal unit vectors."""
    variance = n_right**2 * _at(factors[0], t_s) + n_ahead**2 * _at(factors[2], t_s)
    return np.sqrt(np.maximum(variance + 2.0 * n_right * n_ahead * _at(factors[1], t_s), _TINY))


def _largest_sigma(factors: Floats, t_s: float) -> Floats:
    """A bound of the standard deviation of P + V t along any horizontal direction."""
    return np.sqrt(np.maximum(_at(factors[0], t_s) + _at(factors[2], t_s), 0.0))
