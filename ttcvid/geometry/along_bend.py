"""Road coordinates along our own bend: a circular road becomes a straight one.

In these coordinates whoever follows the bend moves straight, and so does what stands still: the angle about the centre
of our circle is the distance along the road, the distance from the circle the lateral position.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttcvid.model import Floats

BEND_ENDS = 0.3
"""A bend may end at any time until we are where it matters. What it takes us off a straight line by then is half of an
acceleration times the square of the time: the part of it that is gone has this standard deviation."""

# Whoever keeps a lane turns to and fro by about this.
_WOBBLE_RAD_S = math.radians(1.0)
# A turn that moves us off our line by less than this part of the way is none.
_LEAST_PART = 1e-6


@dataclass(frozen=True)
class Straightened:
    """An object in road coordinates: ``place (3,)`` and ``velocity (3,)`` relative to us, axes right, down, ahead.

    Unit of length as given. The velocity is ``jacobian (3, 3)`` times that in the camera frame, plus a constant.
    """

    place: Floats
    velocity: Floats
    jacobian: Floats


def straightened(place: Floats, velocity: Floats, heading: Floats, speed: float, turn_rad_s: float) -> Straightened:
    """Position and velocity of an object in coordinates along our own circle; our heading is the axis "ahead".

    With R = speed / turn rate, positive to the right, the point (B, A) to our right and ahead has the angle phi of (R -
    B, A) about the centre and its distance r from it: it lies R - r to the side and R phi along the road. What stands
    still, what follows the road on a circle about the same centre, and what crosses it at a right angle has a constant
    velocity there. Where our turn rate is 0, and behind the centre, the coordinates are the camera's own.

    ``place, velocity (3,)`` are relative to the camera, in any one unit of length (velocity and ``speed``: per s), y
    down; ``heading (3,)`` is a unit vector in the plane of x and z.
    """
    level = math.hypot(heading[0], heading[2])
    ahead_x, ahead_z = heading[0] / level, heading[2] / level
    level_frame = np.array([[ahead_z, 0.0, -ahead_x], [0.0, 1.0, 0.0], [ahead_x, 0.0, ahead_z]])
    (right, down, ahead), relative = level_frame @ place, level_frame @ velocity
    own_axes = Straightened(level_frame @ place, relative, level_frame)
    if not ahead > 0.0 or abs(turn_rad_s) * ahead <= _LEAST_PART * speed:
        return own_axes
    radius, side = speed / turn_rad_s, math.copysign(1.0, turn_rad_s)
    from_centre = side * (radius - right)
    if not from_centre > 0.0:
        return own_axes
    distance = math.hypot(from_centre, ahead)
    across = (2.0 * radius * right - right * right - ahead * ahead) / (radius + side * distance)
    along = side * radius * math.atan2(ahead, from_centre)
    cosine, sine, longer = from_centre / distance, ahead / distance, side * radius / distance
    turned = np.array([[cosine, 0.0, -side * sine], [0.0, 1.0, 0.0], [side * sine * longer, 0.0, cosine * longer]])
    own = np.array([0.0, 0.0, speed])
    return Straightened(np.array([across, down, along]), turned @ (relative + own) - own, turned @ level_frame)


def share_of_bend(turn_rad_s: float) -> float:
    """Share of a turn rate (rad/s) that belongs to a bend, 0 to 1; the rest is steering within a lane."""
    return turn_rad_s**2 / (turn_rad_s**2 + _WOBBLE_RAD_S**2)
