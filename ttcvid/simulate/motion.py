"""How bodies move: straight, accelerating, turning or swinging paths over the ground, exact at every time.

Road frame (ISO 8855): x ahead, y to the left, z up, in metres; headings and yaw rates count from x towards y.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ttcvid.model import Floats

PANEL_S = 0.5
"""Longest stretch integrated at once; with 12 nodes the error is below 1e-13 m for every allowed motion."""
NODES = 12
_NODE, _WEIGHT = np.polynomial.legendre.leggauss(NODES)


@dataclass(frozen=True)
class Motion:
    """A path that starts at ``start_m`` (3,) at time 0.

    The speed is constant, changes by ``acceleration_m_s2`` from ``acceleration_from_s`` until
    ``acceleration_until_s``, and never falls below zero. The course is ``course_rad``, plus ``yaw_rate_rad_s`` times
    the time since ``yaw_from_s`` (until ``yaw_until_s``), plus ``sideslip_rad sin(2 pi t / sideslip_period_s)``; the
    heading of the moving body leaves the sideslip out and adds ``facing_rad``. ``climb_m_s`` is the constant rate
    of ascent. A lane change adds ``lane_change_m`` to the left of ``course_rad`` within ``lane_change_duration_s``,
    with no jump of the acceleration; the heading follows. It excludes a yaw rate.
    """

    start_m: tuple[float, float, float]
    course_rad: float = 0.0
    speed_m_s: float = 0.0
    acceleration_m_s2: float = 0.0
    acceleration_from_s: float = 0.0
    acceleration_until_s: float = np.inf
    yaw_rate_rad_s: float = 0.0
    yaw_from_s: float = 0.0
    yaw_until_s: float = np.inf
    climb_m_s: float = 0.0
    sideslip_rad: float = 0.0
    sideslip_period_s: float = 1.0
    facing_rad: float = 0.0
    lane_change_m: float = 0.0
    lane_change_from_s: float = 0.0
    lane_change_duration_s: float = 3.0

    @property
    def is_moving(self) -> bool:
        """True for what translates at some time; what only turns on the spot counts as resting."""
        return self.speed_m_s > 0 or self.acceleration_m_s2 > 0 or self.climb_m_s != 0


def speed_at(motion: Motion, t_s: Floats) -> Floats:
    """Speed over the ground in m/s at times ``(N,)``."""
    pushed_s = np.clip(t_s, motion.acceleration_from_s, motion.acceleration_until_s) - motion.acceleration_from_s
    return np.maximum(motion.speed_m_s + motion.acceleration_m_s2 * pushed_s, 0.0)


def heading_at(motion: Motion, t_s: Floats) -> Floats:
    """Heading of the body itself in rad at times ``(N,)``."""
    _, aside, _ = _lane_change_at(motion, t_s)
    turned = motion.yaw_rate_rad_s * _turning_s(motion, t_s)
    return np.asarray(motion.course_rad + motion.facing_rad + turned + np.arctan2(aside, speed_at(motion, t_s)))


def turn_rate_at(motion: Motion, t_s: Floats) -> Floats:
    """Rate of the heading in rad/s at times ``(N,)``."""
    _, aside, aside_rate = _lane_change_at(motion, t_s)
    is_turning = (t_s >= motion.yaw_from_s) & (t_s < motion.yaw_until_s)
    speed = speed_at(motion, t_s)
    is_pushed = (t_s >= motion.acceleration_from_s) & (t_s < motion.acceleration_until_s) & (speed > 0)
    square = speed**2 + aside**2
    swing = aside_rate * speed - aside * motion.acceleration_m_s2 * is_pushed
    bend = np.where(square > 0, swing / np.where(square > 0, square, 1.0), 0.0)
    return np.asarray(motion.yaw_rate_rad_s * is_turning + bend)


def _turning_s(motion: Motion, t_s: Floats) -> Floats:
    """How long it has been turning at times ``(N,)``."""
    return np.asarray(np.clip(t_s, motion.yaw_from_s, motion.yaw_until_s) - motion.yaw_from_s)


def _lane_change_at(motion: Motion, t_s: Floats) -> tuple[Floats, Floats, Floats]:
    """Offset to the left in m, its rate and its acceleration at times ``(N,)``: a cycloid."""
    duration, whole = motion.lane_change_duration_s, 2 * np.pi
    part = np.clip((t_s - motion.lane_change_from_s) / duration, 0.0, 1.0)
    offset = motion.lane_change_m * (part - np.sin(whole * part) / whole)
    rate = motion.lane_change_m / duration * (1.0 - np.cos(whole * part))
    return offset, rate, motion.lane_change_m * whole / duration**2 * np.sin(whole * part)


def _left_of(motion: Motion) -> Floats:
    """Unit vector (3,) to the left of the course."""
    return np.array([-np.sin(motion.course_rad), np.cos(motion.course_rad), 0.0])


def velocity_at(motion: Motion, t_s: Floats) -> Floats:
    """Velocity in the road frame in m/s at times ``(N,)``: ``(N, 3)``."""
    _, aside, _ = _lane_change_at(motion, t_s)
    return _velocity_along(motion, t_s) + aside[..., None] * _left_of(motion)


def _velocity_along(motion: Motion, t_s: Floats) -> Floats:
    """Velocity without the lane change."""
    slip = motion.sideslip_rad * np.sin(2 * np.pi * t_s / motion.sideslip_period_s)
    course = motion.course_rad + motion.yaw_rate_rad_s * _turning_s(motion, t_s) + slip
    speed = speed_at(motion, t_s)
    return np.stack([speed * np.cos(course), speed * np.sin(course), np.full_like(speed, motion.climb_m_s)], axis=-1)


def position_at(motion: Motion, t_s: Floats) -> Floats:
    """Position in the road frame in m at times ``(N,)``: ``(N, 3)``. Times just before 0 are allowed.

    The velocity is integrated piece by piece between the kinks of the speed by Gauss-Legendre quadrature, which
    holds for every combination of the terms (a turn at changing speed has only a Fresnel-like closed form). On a
    straight course it changes linearly between the kinks: one node is exact.
    """
    t_s = np.asarray(t_s, dtype=float)
    if not motion.is_moving:
        return np.tile(np.asarray(motion.start_m), (*t_s.shape, 1))
    total = np.zeros((*t_s.shape, 3))
    is_straight = motion.yaw_rate_rad_s == 0 and motion.sideslip_rad == 0
    nodes, weights = (np.zeros(1), np.array([2.0])) if is_straight else (_NODE, _WEIGHT)
    kinks = _kinks_s(motion, float(t_s.max(initial=0.0)))
    for start, end in pairwise(kinks):
        n_panels = 1 if is_straight else max(1, int(np.ceil((end - start) / PANEL_S)))
        within = np.minimum(t_s, end) if start == 0 else np.clip(t_s, start, end)
        half = (within - start) / (2 * n_panels)
        centres = 2 * np.arange(n_panels) + 1
        at_s = start + half[..., None, None] * (centres[:, None] + nodes)
        velocity = _velocity_along(motion, at_s)
        total += half[..., None] * np.einsum("...pnk,n->...k", velocity, weights)
    offset, _, _ = _lane_change_at(motion, t_s)
    return np.asarray(motion.start_m) + total + offset[..., None] * _left_of(motion)


def _kinks_s(motion: Motion, end_s: float) -> list[float]:
    """Times between 0 and ``end_s`` that divide the speed into smooth pieces, both ends included."""
    kinks = [motion.acceleration_from_s, motion.acceleration_until_s, motion.yaw_from_s, motion.yaw_until_s]
    if motion.acceleration_m_s2 < 0:
        kinks.append(motion.acceleration_from_s - motion.speed_m_s / motion.acceleration_m_s2)
    return [0.0, *sorted(k for k in set(kinks) if 0 < k < end_s), max(end_s, 0.0)]
