"""Rotation matrices, their vectors, and tangents of directions."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled, compiled_for
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


@compiled_for("(f8[:, :, ::1], f8[:, ::1])")
def fill_vectors(rotations: Floats, vectors: Floats) -> None:
    """Fill ``vectors (N, 3)`` from ``rotations (N, 3, 3)``."""
    q = np.empty(4)
    for i in range(len(rotations)):
        r = rotations[i]
        diagonal = r[0, 0], r[1, 1], r[2, 2]
        # The largest component of the quaternion, from its square, and the others from their products with it.
        best, largest = 0, diagonal[0] + diagonal[1] + diagonal[2]
        for j in range(3):
            if diagonal[j] > largest:
                best, largest = j + 1, diagonal[j]
        if best == 0:
            q[0] = 1.0 + largest
            q[1], q[2], q[3] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
        else:
            j = best - 1
            k, m = (j + 1) % 3, (j + 2) % 3
            q[0] = r[m, k] - r[k, m]
            q[1 + j] = 1.0 + r[j, j] - r[k, k] - r[m, m]
            q[1 + k], q[1 + m] = r[k, j] + r[j, k], r[m, j] + r[j, m]
        if q[0] < 0.0:
            q *= -1.0
        sine = np.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        scale = 2.0 * np.arctan2(sine, q[0]) / sine if sine > 0.0 else 2.0 / q[0]
        for j in range(3):
            vectors[i, j] = scale * q[1 + j]
