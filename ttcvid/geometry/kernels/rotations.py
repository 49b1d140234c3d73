"""Rotation matrices and tangents of directions, one at a time."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled
from ttcvid.model import Floats

# Below this 1 + y the tangent basis changes its formula: a cap of 2.6 deg about straight up, where no motion of
# interest points; everywhere else the basis is smooth, which keeps finite differences and Gauss-Newton steps sound.
_CAP_ONE_PLUS_Y = 1e-3


@compiled
def fill_rotation(x: float, y: float, z: float, rotation: Floats) -> None:
    """Fill ``rotation (3, 3)`` with that of a rotation vector, by Rodrigues' formula; NaN where one is in it."""
    angle = np.sqrt(x * x + y * y + z * z)
    sine = 1.0 if angle == 0.0 else np.sin(angle) / angle
    half = 1.0 if angle == 0.0 else np.sin(0.5 * angle) / (0.5 * angle)
    versed = 0.5 * half * half
    rotation[0, 0], rotation[1, 1] = 1.0 - versed * (y * y + z * z), 1.0 - versed * (x * x + z * z)
    rotation[2, 2] = 1.0 - versed * (x * x + y * y)
    rotation[0, 1], rotation[1, 0] = versed * x * y - sine * z, versed * x * y + sine * z
    rotation[0, 2], rotation[2, 0] = versed * x * z + sine * y, versed * x * z - sine * y
    rotation[1, 2], rotation[2, 1] = versed * y * z - sine * x, versed * y * z + sine * x


@compiled
def fill_tangents(x: float, y: float, z: float, basis: Floats) -> None:
    """Fill ``basis (3, 2)`` with two unit vectors across a unit vector, as `rotation.tangent_basis` says."""
    sign = -1.0 if 1.0 + y < _CAP_ONE_PLUS_Y else 1.0
    inverse = -1.0 / (sign + y)
    mixed = z * x * inverse
    basis[0, 0], basis[1, 0], basis[2, 0] = sign * mixed, -sign * z, 1.0 + sign * z * z * inverse
    basis[0, 1], basis[1, 1], basis[2, 1] = sign + x * x * inverse, -x, mixed
