"""What is around us in coordinates that run along our own bend: a straight road of what is a bend.

Who drives along a bend goes straight in them, and so does what stands still: the angle about the centre of our circle
is the way along the road, the distance from the circle the place across it.
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
    """A thing beside a straight road: ``place (3,)`` and ``velocity (3,)`` relative to us, to the right, down, ahead.

    The velocity is ``jacobian (3, 3)`` times that in the camera, and a constant.
    """

    place: Floats
    velocity: Floats
    jacobian: Floats


def straightened(place: Floats, velocity: Floats, heading: Floats, speed: float, turn_rad_s: float) -> Straightened:
    """A thing in coordinates along our circle; our way ahead is the axis "ahead".

    With R = speed / turn to the right, the place (B, A) to our right and ahead has the angle phi of (R - B, A) about
    the centre and its distance r from it: it lies R - r across and R phi along. What stands still, what goes along
    the road on a circle about the same centre, and what crosses the road at a right angle has a velocity there that
    lasts.

    Parameters
    ----------
    place, velocity : (3,) relative to the camera, in any unit of length, y down.
    heading, speed : (3,) where we drive now, and how fast in that unit; level to the plane of x and z.
    turn_rad_s : how fast we turn to the right. Nothing is straightened where we go straight on, and behind the centre.
    """
    level = math.hypot(heading[0], heading[2])
    ahead_x, ahead_z = heading[0] / level, heading[2] / level
    level_frame = np.array([[ahead_z, 0.0, -ahead_x], [0.0, 1.0, 0.0], [ahead_x, 0.0, ahead_z]])
    (right, down, ahead), relative = level_frame @ place, level_frame @ velocity
    side = math.copysign(1.0, turn_rad_s)
    if not ahead > 0.0 or abs(turn_rad_s) * ahead <= _LEAST_PART * speed:
        return Straightened(level_frame @ place, relative, level_frame)
    radius = speed / turn_rad_s
    from_centre = side * (radius - right)
    if not from_centre > 0.0:
        return Straightened(level_frame @ place, relative, level_frame)
    distance = math.hypot(from_centre, ahead)
    across = (2.0 * radius * right - right * right - ahead * ahead) / (radius + side * distance)
    along = side * radius * math.atan2(ahead, from_centre)
    cosine, sine, longer = from_centre / distance, ahead / distance, side * radius / distance
    turned = np.array([[cosine, 0.0, -side * sine], [0.0, 1.0, 0.0], [side * sine * longer, 0.0, cosine * longer]])
    own = np.array([0.0, 0.0, speed])
    return Straightened(np.array([across, down, along]), turned @ (relative + own) - own, turned @ level_frame)


def share_of_bend(turn_rad_s: float) -> float:
    """The part of a turn that is a bend and lasts: the rest is steering to and fro in a lane."""
    return turn_rad_s**2 / (turn_rad_s**2 + _WOBBLE_RAD_S**2)
