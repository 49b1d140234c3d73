"""When, and how probably, boxes that move past us touch our outline, over a stretch of straight relative motion.

Boxes and outline are symmetric about their centres, so the sum of both is cut out by slabs abs(n.x) <= h(n), one for
each edge direction, and the time of contact is the intersection of the times inside each slab.
"""

from __future__ import annotations

import math

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.model import Floats

RIGHT, DOWN, AHEAD = 0, 1, 2
"""Places of the level axes in a vector."""
POSSIBLE = 0.05
"""Below this probability nothing is said of a contact: no time, no object."""

# Slabs that stand for a round outline: the polygon of 16 sides around a circle exceeds it by 2 % at its corners.
_ROUND_DIRECTIONS = 8
_TINY = 1e-12
# What stays farther off than this many of its standard deviations has no probability worth computing.
_FAR_SIGMAS = 5.0
# Probabilities below this count as none.
_NEGLIGIBLE = 1e-4


@compiled_for(
    "(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[:, :, ::1], f8[::1], b1, f8[:, ::1], f8[:, ::1], f8, f8, "
    "f8[:, ::1], f8[:, ::1])"
)
def add_contacts(
    position_m: Floats,
    velocity_m_s: Floats,
    half_size_m: Floats,
    yaw_rad: Floats,
    covariance: Floats,
    own_half_m: Floats,
    is_round: bool,
    shift_m: Floats,
    change_m_s: Floats,
    start_s: float,
    duration_s: float,
    time_s: Floats,
    probability: Floats,
) -> None:
    """Contacts of N boxes on C ways within one stretch, entered where they are earlier or more probable than before.

    Parameters
    ----------
    position_m, velocity_m_s, half_size_m, yaw_rad, covariance
        Of the boxes at the start of the stretch, as in `collision_map.hazards.Hazards`; the covariance is that of now.
    own_half_m
        ``(3,)`` half our width, height and length; with ``is_round`` the half-axes of an ellipsoid.
    shift_m, change_m_s
        ``(C, 3)`` where we are at the start, and our velocity, both relative to keeping the present velocity.
    start_s, duration_s
        When the stretch begins, from now, and how long it is.
    time_s, probability
        ``(N, C)``, changed in place: the earliest time from now at which a contact is possible (infinite: none), and
        the probability of a contact in the likeliest stretch. Where the box is known exactly it is 0 or 1.
    """
    for n in range(len(position_m)):
        half, yaw = half_size_m[n], yaw_rad[n]
        is_exact = not covariance[n].any()
        factors = _variances(covariance[n])
        slabs = _slabs(half, yaw, own_half_m, is_round)
        end_sigma = _largest_sigma(factors, start_s + duration_s)
        spare = _FAR_SIGMAS * max(end_sigma, _largest_sigma(factors, start_s))
        reach = math.hypot(half[RIGHT], half[AHEAD]) + math.hypot(own_half_m[RIGHT], own_half_m[AHEAD]) + spare
        for c in range(len(shift_m)):
            x, y, z = (
                position_m[n, 0] - shift_m[c, 0],
                position_m[n, 1] - shift_m[c, 1],
                position_m[n, 2] - shift_m[c, 2],
            )
            u = velocity_m_s[n, 0] - change_m_s[c, 0]
            v = velocity_m_s[n, 1] - change_m_s[c, 1]
            w = velocity_m_s[n, 2] - change_m_s[c, 2]
            pace2 = max(u * u + w * w, _TINY)
            closest = min(max(-(x * u + z * w) / pace2, 0.0), duration_s)
            near_x, near_z = x + closest * u, z + closest * w
            if near_x * near_x + near_z * near_z > reach * reach:
                continue
            p = 1.0
            if not is_exact:
                p = _probability(
                    x, y, z, u, v, w, closest, half, yaw, own_half_m, is_round, factors, start_s, duration_s
                )
                probability[n, c] = max(probability[n, c], p)
                if p < POSSIBLE or start_s >= time_s[n, c]:
                    continue
            below = max(abs(y + closest * v) - half[DOWN], 0.0)
            share = _share_at_height(below / own_half_m[DOWN]) if is_round else 1.0
            enter, leave = _touching(x, y, z, u, v, w, half[DOWN] + own_half_m[DOWN], slabs, share)
            is_contact = enter <= leave and leave >= 0.0 and enter <= duration_s
            if is_contact or not is_exact:
                probability[n, c] = max(probability[n, c], p)
                time_s[n, c] = min(time_s[n, c], start_s + (max(enter, 0.0) if is_contact else closest))


@compiled
def _share_at_height(ratio: float) -> float:
    """How wide an ellipsoid is at a height in units of its half-axis, relative to its middle."""
    return math.sqrt(max(1.0 - ratio * ratio, 0.0))


@compiled
def _slabs(half: Floats, yaw: float, own_half: Floats, is_round: bool) -> Floats:
    """Upright slabs ``(K, 4)`` that cut out the sum of box and outline: unit vector (x, z), extents of box and us."""
    n_own = _ROUND_DIRECTIONS if is_round else 2
    slabs = np.empty((2 + n_own, 4))
    for k in range(2 + n_own):
        angle = -yaw + 0.5 * math.pi * k if k < 2 else math.pi * (k - 2) / n_own
        nx, nz = math.cos(angle), math.sin(angle)
        slabs[k, 0], slabs[k, 1] = nx, nz
        slabs[k, 2] = _box_extent(half, yaw, nx, nz)
        slabs[k, 3] = _own_extent(own_half, is_round, nx, nz)
    return slabs


@compiled
def _touching(
    x: float, y: float, z: float, u: float, v: float, w: float, reach_down: float, slabs: Floats, share: float
) -> tuple[float, float]:
    """From when until when a box at (x, y, z) with velocity (u, v, w) touches us; enter > leave: never.

    ``share`` is how wide we are at the height of meeting.
    """
    enter, leave = _slab(y, v, reach_down)
    for k in range(len(slabs)):
        nx, nz = slabs[k, 0], slabs[k, 1]
        slab_enter, slab_leave = _slab(nx * x + nz * z, nx * u + nz * w, slabs[k, 2] + share * slabs[k, 3])
        enter, leave = max(enter, slab_enter), min(leave, slab_leave)
    return enter, leave


@compiled
def _slab(along: float, rate: float, reach: float) -> tuple[float, float]:
    """From when until when abs(along + rate t) <= reach; without a rate that is always, or so late as never."""
    safe = rate if abs(rate) > _TINY else _TINY
    middle, spread = -along / safe, reach / abs(safe)
    return middle - spread, middle + spread


@compiled
def _box_extent(half: Floats, yaw: float, nx: float, nz: float) -> float:
    """Half the extent of a turned box along a horizontal unit vector (its support function)."""
    c, s = math.cos(yaw), math.sin(yaw)
    extent: float = half[RIGHT] * abs(c * nx - s * nz) + half[AHEAD] * abs(s * nx + c * nz)
    return extent


@compiled
def _own_extent(own_half: Floats, is_round: bool, nx: float, nz: float) -> float:
    """Half our own extent along a horizontal unit vector, at the height of the camera."""
    across, along = own_half[RIGHT] * nx, own_half[AHEAD] * nz
    extent: float = math.hypot(across, along) if is_round else abs(across) + abs(along)
    return extent


@compiled
def _probability(
    x: float,
    y: float,
    z: float,
    u: float,
    v: float,
    w: float,
    closest: float,
    half: Floats,
    yaw: float,
    own_half: Floats,
    is_round: bool,
    factors: Floats,
    start_s: float,
    duration_s: float,
) -> float:
    """Probability of contact within a stretch.

    The product of four: the paths cross within both outlines (across the relative motion), at one height, we are not
    past each other at the start, and have met by the end (along the motion).
    """
    pace = math.sqrt(max(u * u + w * w, _TINY))
    ax, az = u / pace, w / pace
    along, across = ax * x + az * z, az * x - ax * z
    reach_along = _box_extent(half, yaw, ax, az) + _own_extent(own_half, is_round, ax, az)
    reach_across = _box_extent(half, yaw, az, -ax) + _own_extent(own_half, is_round, az, -ax)
    reach_down = half[DOWN] + own_half[DOWN]
    at_closest = start_s + closest
    p = _between(across, reach_across, _sigma(factors, at_closest, az, -ax))
    if p < _NEGLIGIBLE:
        return 0.0
    p *= _below((reach_along + along + pace * duration_s) / _sigma(factors, start_s + duration_s, ax, az))
    p *= _below((reach_along - along) / _sigma(factors, start_s, ax, az))
    if p < _NEGLIGIBLE:
        return 0.0
    return p * _between(y + closest * v, reach_down, math.sqrt(max(_variance(factors, 3, at_closest), _TINY)))


@compiled
def _between(mean: float, reach: float, sigma: float) -> float:
    """Probability that a normal variable lies within +-reach."""
    return _below((reach - mean) / sigma) - _below((-reach - mean) / sigma)


@compiled
def _below(x: float) -> float:
    """The standard normal distribution function."""
    return 0.5 * math.erfc(-x / math.sqrt(2.0))


@compiled
def _variances(covariance: Floats) -> Floats:
    """Of the variances of P + V t, right right, right ahead, ahead ahead and down down: the factors of 1, t and t^2."""
    factors = np.empty((4, 3))
    for k, (i, j) in enumerate(((RIGHT, RIGHT), (RIGHT, AHEAD), (AHEAD, AHEAD), (DOWN, DOWN))):
        factors[k, 0] = covariance[i, j]
        factors[k, 1] = covariance[i, 3 + j] + covariance[3 + i, j]
        factors[k, 2] = covariance[3 + i, 3 + j]
    return factors


@compiled
def _variance(factors: Floats, k: int, t_s: float) -> float:
    variance: float = factors[k, 0] + t_s * (factors[k, 1] + t_s * factors[k, 2])
    return variance


@compiled
def _sigma(factors: Floats, t_s: float, nx: float, nz: float) -> float:
    """Standard deviation of P + V t along a horizontal unit vector."""
    variance = nx * nx * _variance(factors, 0, t_s) + nz * nz * _variance(factors, 2, t_s)
    return math.sqrt(max(variance + 2.0 * nx * nz * _variance(factors, 1, t_s), _TINY))


@compiled
def _largest_sigma(factors: Floats, t_s: float) -> float:
    """A bound of the standard deviation of P + V t along any horizontal direction."""
    return math.sqrt(max(_variance(factors, 0, t_s) + _variance(factors, 2, t_s), 0.0))
