"""Rotations and unit vectors: rotation vectors, matrices, tangent bases; all vectorised, NaN in gives NaN out."""

from __future__ import annotations

import numpy as np

from ttcvid.model import Floats

# Below this 1 + y the tangent basis changes its formula: a cap of 2.6 deg about straight up, where no motion of
# interest points; everywhere else the basis is smooth, which keeps finite differences and Gauss-Newton steps sound.
_CAP_ONE_PLUS_Y = 1e-3


def cross(v: Floats, w: Floats) -> Floats:
    """Cross products of ``v`` and ``w (..., 3)``, broadcast; a fifth of the time of `numpy.cross` on short arrays.

    >>> cross(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    array([0., 0., 1.])
    """
    result = np.empty(np.broadcast_shapes(v.shape, w.shape))
    v0, v1, v2, w0, w1, w2 = v[..., 0], v[..., 1], v[..., 2], w[..., 0], w[..., 1], w[..., 2]
    result[..., 0] = v1 * w2 - v2 * w1
    result[..., 1] = v2 * w0 - v0 * w2
    result[..., 2] = v0 * w1 - v1 * w0
    return result


def normalize(v: Floats) -> Floats:
    """Unit vectors along ``v (..., n)``; NaN where the length is zero or not finite.

    >>> normalize(np.array([[0.0, 3.0, 4.0], [0.0, 0.0, 0.0]]))
    array([[0. , 0.6, 0.8],
           [nan, nan, nan]])
    """
    v = np.asarray(v, dtype=np.float64)
    with np.errstate(over="ignore"):
        length = np.sqrt(np.einsum("...i,...i->...", v, v))[..., None]
    is_usable = np.isfinite(length) & (length > 0.0)
    unit: Floats = np.divide(v, length, out=np.full_like(v, np.nan), where=is_usable)
    return unit


def skew(v: Floats) -> Floats:
    """Matrices ``[v]x (..., 3, 3)`` of vectors ``v (..., 3)``: ``skew(v) @ w == cross(v, w)``.

    >>> skew(np.array([1.0, 2.0, 3.0])) @ np.array([0.0, 0.0, 1.0])
    array([ 2., -1.,  0.])
    """
    v = np.asarray(v, dtype=np.float64)
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    return matrix - np.swapaxes(matrix, -1, -2)


def rotation_from_vector(rotvec_rad: Floats) -> Floats:
    """Rotation matrices of rotation vectors (axis times angle), by Rodrigues' formula.

    Parameters
    ----------
    rotvec_rad
        ``(..., 3)`` in rad; exact for angles down to zero.

    Returns
    -------
    ``(..., 3, 3)``; NaN where a component is not finite.

    >>> rotation_from_vector(np.array([0.0, 0.0, np.pi / 2])).round(12) @ np.array([1.0, 0.0, 0.0])
    array([0., 1., 0.])
    """
    rotvec_rad = np.asarray(rotvec_rad, dtype=np.float64)
    rotvec_rad = np.where(np.isfinite(rotvec_rad), rotvec_rad, np.nan)
    angle = np.sqrt(np.einsum("...i,...i->...", rotvec_rad, rotvec_rad))[..., None, None]
    k = skew(rotvec_rad)
    sin_over_angle = np.sinc(angle / np.pi)
    one_minus_cos_over_angle2 = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    result: Floats = np.eye(3) + sin_over_angle * k + one_minus_cos_over_angle2 * (k @ k)
    return result


def vector_from_rotation(rotation: Floats) -> Floats:
    """Rotation vectors of rotation matrices: the inverse of `rotation_from_vector`, angle in [0, pi].

    Goes through the unit quaternion, taken from the best-conditioned row of ``4 q q'`` (Shepperd), so that tiny
    angles and half turns are both exact.

    Parameters
    ----------
    rotation
        ``(..., 3, 3)`` proper rotations.

    Returns
    -------
    ``(..., 3)`` in rad; NaN where the matrix holds NaN.

    >>> vector_from_rotation(np.eye(3))
    array([0., 0., 0.])
    """
    r = np.asarray(rotation, dtype=np.float64)
    x, y, z = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    wx, wy, wz = r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]
    xy, xz, yz = r[..., 0, 1] + r[..., 1, 0], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 2] + r[..., 2, 1]
    rows = np.stack(
        [
            np.stack([1 + x + y + z, wx, wy, wz], axis=-1),
            np.stack([wx, 1 + x - y - z, xy, xz], axis=-1),
            np.stack([wy, xy, 1 - x + y - z, yz], axis=-1),
            np.stack([wz, xz, yz, 1 - x - y + z], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    q = normalize(q) * np.where(q[..., :1] < 0.0, -1.0, 1.0)
    sin_half = np.sqrt(np.einsum("...i,...i->...", q[..., 1:], q[..., 1:]))
    angle = 2.0 * np.arctan2(sin_half, q[..., 0])
    scale = np.divide(angle, sin_half, out=np.full_like(angle, 2.0), where=sin_half > 0.0)
    result: Floats = q[..., 1:] * scale[..., None]
    return result


def tangent_basis(direction: Floats) -> Floats:
    """Two orthonormal columns normal to each unit vector; with the vector itself as third they are right-handed.

    Parameters
    ----------
    direction
        ``(..., 3)`` unit vectors.

    Returns
    -------
    ``(..., 3, 2)``, a smooth function of the direction except across the border of a cap of 2.6 deg about
    straight up (0, -1, 0). NaN in gives NaN out.

    Source: Duff et al., *Building an Orthonormal Basis, Revisited*, JCGT 2017, with y as the pole.

    >>> (tangent_basis(np.array([0.0, 1.0, 0.0])).T + 0.0)
    array([[0., 0., 1.],
           [1., 0., 0.]])
    """
    direction = np.asarray(direction, dtype=np.float64)
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    sign = np.where(1.0 + y < _CAP_ONE_PLUS_Y, -1.0, 1.0)
    inverse = -1.0 / (sign + y)
    cross_term = z * x * inverse
    basis = np.empty((*direction.shape, 2))
    basis[..., 0, 0], basis[..., 1, 0], basis[..., 2, 0] = sign * cross_term, -sign * z, 1.0 + sign * z * z * inverse
    basis[..., 0, 1], basis[..., 1, 1], basis[..., 2, 1] = sign + x * x * inverse, -x, cross_term
    return basis
