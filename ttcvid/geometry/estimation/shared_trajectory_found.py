"""What is found of paths, said as `shared_trajectory` says it: in the axes of the camera, compiled.

All arrays that a function fills are arguments of it.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.model import Floats

_N_SHARED, _N_LOCAL = 9, 8


@compiled_for(
    "(f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, :, ::1], "
    "f8[:, :, ::1])"
)
def share(
    basis: Floats,
    own_motion: Floats,
    local: Floats,
    cov: Floats,
    velocity: Floats,
    direction: Floats,
    offset: Floats,
    shared_cov: Floats,
    own_cov: Floats,
) -> None:
    """Fills what `SharedPaths` holds of offsets ``local (K, 8)`` with ``cov (K, 8, 8)``; a direction is a unit vector.

    The first six columns of ``shared_cov (K, 9, 9)`` are over the speed, as those of ``own_cov (K, 3, 3)`` are: the
    part of the direction in the motion of the middle, which ``own_motion (K, 8, 8)`` takes offsets to.
    """
    columns, half = np.zeros((_N_SHARED, _N_LOCAL)), np.empty((_N_SHARED, _N_LOCAL))
    own, own_half = np.empty((3, _N_LOCAL)), np.empty((3, _N_LOCAL))
    for k in range(len(basis)):
        slower = 1.0 / np.sqrt(velocity[k, 0] ** 2 + velocity[k, 1] ** 2 + velocity[k, 2] ** 2)
        for j in range(3):
            direction[k, j] = velocity[k, j] * slower
            offset[k, j] = basis[k, j, 0] * local[k, 0] + basis[k, j, 1] * local[k, 1]
            offset[k, 3 + j], offset[k, 6 + j] = 0.0, local[k, 5 + j]
            columns[j, 0], columns[j, 1], columns[6 + j, 5 + j] = basis[k, j, 0] * slower, basis[k, j, 1] * slower, 1.0
            for m in range(3):
                columns[3 + j, 2 + m] = basis[k, j, m] * slower
                offset[k, 3 + j] += basis[k, j, m] * local[k, 2 + m]
            for n in range(_N_LOCAL):
                own[j, n] = columns[j, 0] * own_motion[k, 0, n] + columns[j, 1] * own_motion[k, 1, n]
        _turn_covariance(columns, cov[k], half, shared_cov[k])
        _turn_covariance(own, cov[k], own_half, own_cov[k])


@compiled
def _turn_covariance(columns: Floats, cov: Floats, half: Floats, turned: Floats) -> None:
    """Fills ``turned (n, n)``: J cov J' with ``columns (n, 8)``; ``half (n, 8)`` on the way."""
    half[:], turned[:] = 0.0, 0.0
    for i in range(len(columns)):
        for m in range(_N_LOCAL):
            for j in range(_N_LOCAL):
                half[i, j] += columns[i, m] * cov[m, j]
    for i in range(len(columns)):
        for j in range(i + 1):
            for m in range(_N_LOCAL):
                turned[i, j] += half[i, m] * columns[j, m]
            turned[j, i] = turned[i, j]
