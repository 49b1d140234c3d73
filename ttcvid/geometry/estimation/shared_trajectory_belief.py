"""What is believed of a path, said of what its points share: see `shared_trajectory_descent` for the unknowns.

All arrays that a function fills are arguments of it.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.geometry.kernels.medians import median
from ttcvid.model import Floats, Ints

# What does not contradict a direction: a chi-square with two degrees of freedom inside its 90 %.
_CHANCE_CHI2 = 4.605


@compiled_for("(f8[:, :, ::1], f8[:, :, ::1], f8, f8, f8, f8[:, :, ::1])")
def set_prior(
    basis: Floats, direction_cov: Floats, across_sigma: float, along_sigma: float, turn_sigma: float, prior: Floats
) -> None:
    """Fills ``prior (K, 8, 8)``, zeros before: information on what moves along a path, by its belief."""
    for k in range(len(basis)):
        xx, xy, yy = 0.0, 0.0, 0.0
        for i in range(3):
            for j in range(3):
                covariance = direction_cov[k, i, j]
                xx += basis[k, i, 0] * covariance * basis[k, j, 0]
                xy += basis[k, i, 0] * covariance * basis[k, j, 1]
                yy += basis[k, i, 1] * covariance * basis[k, j, 1]
        rest = 1.0 / (xx * yy - xy * xy)
        prior[k, 0, 0], prior[k, 1, 1] = yy * rest, xx * rest
        prior[k, 0, 1] = prior[k, 1, 0] = -xy * rest
        prior[k, 2, 2] = prior[k, 3, 3] = 1.0 / across_sigma**2
        prior[k, 4, 4] = 1.0 / along_sigma**2
        for j in range(5, prior.shape[1]):
            prior[k, j, j] = 1.0 / turn_sigma**2


@compiled_for("(b1, f8[:, :, ::1], f8[:, ::1], i8[::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1])")
def set_beliefs(
    turns_itself: bool,
    basis: Floats,
    state: Floats,
    first: Ints,
    prior: Floats,
    own_motion: Floats,
    believed: Floats,
) -> None:
    """Fills ``own_motion (K, 8, 8)``: from offsets to that of which the belief speaks; and ``believed (K, 8, 8)``.

    That is the information on offsets that ``prior (K, 8, 8)`` means: M' prior M.

    Parameters
    ----------
    turns_itself : whether it is the thing on a path that turns, about its own middle, or the camera.
    basis : (K, 3, 3) axes of the paths; ``state (N, 3)`` the points of path k from ``first[k]`` on.
    """
    n, half = prior.shape[1], np.empty(prior.shape[1:])
    for k in range(len(basis)):
        _set_own_motion(turns_itself, basis[k], state[first[k] : first[k + 1]], own_motion[k])
        half[:] = 0.0
        for i in range(n):
            for j in range(n):
                for m in range(n):
                    half[i, m] += prior[k, i, j] * own_motion[k, j, m]
        believed[k] = 0.0
        for i in range(n):
            for j in range(n):
                for m in range(n):
                    believed[k, j, m] += own_motion[k, i, j] * half[i, m]


@compiled_for("(f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1], f8[:, :, ::1])")
def believe_as_found(
    basis: Floats,
    own_motion: Floats,
    believed_cov: Floats,
    found_cov: Floats,
    local: Floats,
    cov: Floats,
    believed: Floats,
) -> None:
    """Goes over from ``believed_cov`` to ``found_cov (K, 3, 3)`` of directions in ``believed (K, 8, 8)``.

    By as much as the offsets ``local (K, 8)``, with ``cov (K, 8, 8)``, contradict a direction, more than chance makes
    them, ``found_cov`` counts more.
    """
    n = cov.shape[1]
    along, off = np.empty((2, n)), np.empty(2)
    wide, found, both = np.empty((2, 2)), np.empty((2, 2)), np.empty((2, 2))
    for k in range(len(basis)):
        for i in range(2):
            off[i] = 0.0
            for m in range(n):
                off[i] += own_motion[k, i, m] * local[k, m]
                along[i, m] = 0.0
                for j in range(n):
                    along[i, m] += own_motion[k, i, j] * cov[k, j, m]
        for i in range(2):
            for j in range(2):
                wide[i, j], found[i, j], both[i, j] = 0.0, 0.0, 0.0
                for m in range(3):
                    for q in range(3):
                        wide[i, j] += basis[k, m, i] * believed_cov[k, m, q] * basis[k, q, j]
                        found[i, j] += basis[k, m, i] * found_cov[k, m, q] * basis[k, q, j]
                for m in range(n):
                    both[i, j] += along[i, m] * own_motion[k, j, m]
                both[i, j] += found[i, j]
        rest = both[0, 0] * both[1, 1] - both[0, 1] * both[1, 0]
        chi2 = off[0] * off[0] * both[1, 1] + off[1] * off[1] * both[0, 0] - 2.0 * off[0] * off[1] * both[0, 1]
        worse = max(1.0, chi2 / rest / _CHANCE_CHI2)
        less = wide[0, 0] * wide[1, 1] - wide[0, 1] * wide[1, 0]
        more = worse * (found[0, 0] * found[1, 1] - found[0, 1] * found[1, 0])
        xx, yy = found[1, 1] / more - wide[1, 1] / less, found[0, 0] / more - wide[0, 0] / less
        xy = wide[0, 1] / less - found[0, 1] / more
        for i in range(n):
            for j in range(n):
                x, y = own_motion[k, 0, i], own_motion[k, 1, i]
                believed[k, i, j] += (x * xx + y * xy) * own_motion[k, 0, j] + (x * xy + y * yy) * own_motion[k, 1, j]


@compiled
def _set_own_motion(turns_itself: bool, basis: Floats, state: Floats, own_motion: Floats) -> None:
    """Fills the matrix ``(8, 8)`` that takes shared offsets to the motion of the middle of what turns itself.

    Views of a point at C + V t + A t^2 / 2, turned back at the rate omega, show it moving by
    (V - omega x C) t + (A - 2 omega x V) t^2 / 2, to first order in omega. The offsets are the latter. C is (x, y, 1) /
    rho of the middle of the points, in units in which the speed is 1, and V the unit vector of the direction.
    """
    for j in range(len(own_motion)):
        for k in range(len(own_motion)):
            own_motion[j, k] = 1.0 if j == k else 0.0
    if not turns_itself or len(state) == 0:
        return
    rate = median(state[:, 2].copy())
    if rate > 0.0:
        x, y, z = median(state[:, 0].copy()) / rate, median(state[:, 1].copy()) / rate, 1.0 / rate
        for j in range(2):
            # omega x C along the axis b is omega . (C x b).
            own_motion[j, 5] = y * basis[2, j] - z * basis[1, j]
            own_motion[j, 6] = z * basis[0, j] - x * basis[2, j]
            own_motion[j, 7] = x * basis[1, j] - y * basis[0, j]
    e = basis[:, 2]
    for j in range(3):
        own_motion[2 + j, 5] = 2.0 * (e[1] * basis[2, j] - e[2] * basis[1, j])
        own_motion[2 + j, 6] = 2.0 * (e[2] * basis[0, j] - e[0] * basis[2, j])
        own_motion[2 + j, 7] = 2.0 * (e[0] * basis[1, j] - e[1] * basis[0, j])
