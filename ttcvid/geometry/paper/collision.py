"""When and how far off a point passes: angles from the epipole, k, H, and the three times.

The paper is Burschka, *Monocular Navigation in Large Scale Dynamic Environments*, BMVC 2017. Its epipole E_i, where
a point comes from, is ``-dir`` here; its k is the time to closest approach, in frames or seconds as the gap is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import cross, normalize
from ttcvid.model import Floats, Ints, Status

# Rounding of an angle in [0, pi]: a smaller difference between two angles is not there.
_ANGLE_ROUNDING_RAD = 1e-15


class PointTimes(NamedTuple):
    """The three times of N points, each ``(N,)`` in s; NaN where there is none."""

    tcpa_s: Floats
    miss_s: Floats
    ttc_z_s: Floats


def angle_from_direction(rays: Floats, origin_dir: Floats, plane_normal: Floats) -> Floats:
    """Angle of rays from the epipole, signed about the normal of the flow's plane.

    The paper's arctan(u / f) holds only where the line of the flow runs through the principal point; the angle
    between the rays themselves holds everywhere. The part of a ray along ``plane_normal`` is ignored.

    Parameters
    ----------
    rays : ``(N, 3)`` of any length.
    origin_dir : ``(3,)`` or ``(N, 3)``, where the angle is zero: the epipole ``-dir``.
    plane_normal : ``(N, 3)``, normal to ``origin_dir``; the angle grows right-handed about it.

    Returns
    -------
    ``(N,)`` rad in [-pi, pi]; NaN where an input is NaN or the normal is zero.

    Source: the paper's (1), DESIGN equation 1.

    >>> angle_from_direction(np.array([[1.0, 0.0, 1.0]]), np.array([0.0, 0.0, 1.0]), np.array([[0.0, 2.0, 0.0]]))
    array([0.78539816])
    """
    along = np.einsum("...i,...i->...", rays, origin_dir)
    across = np.einsum("...i,...i->...", cross(origin_dir, rays), normalize(plane_normal))
    return np.asarray(np.arctan2(across, along))


def angles_from_epipoles(rays: Floats, direction: Floats) -> Floats:
    """Angle between each ray and the epipole of its own motion: alpha = angle(P, -dir), without a sign.

    Of ``rays (N, 3)`` of any length and ``direction (N, 3)``: (N,) rad in [0, pi]; NaN where an input is NaN.

    Source: DESIGN section 2, "Epipole".

    >>> angles_from_epipoles(np.array([[1.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]]))
    array([0.78539816])
    """
    across = cross(rays, direction)
    length = np.sqrt(np.einsum("ni,ni->n", across, across))
    return np.asarray(np.arctan2(length, -np.einsum("ni,ni->n", rays, direction)))


def k_from_two_angles(alpha_rad: Floats, beta_rad: Floats, gap: float | Floats) -> tuple[Floats, Ints]:
    """Time to closest approach k, at the first of two views ``gap`` apart; at the second it is ``k - gap``.

    ``k = gap tan b / (tan b - tan a)``, computed as ``gap sin b cos a / sin(b - a)``, which stays exact where an
    angle passes pi/2 (the collision plane has swept the camera). Receding points give a negative k.

    Parameters
    ----------
    alpha_rad, beta_rad : ``(N,)`` angles from the epipole at the first and second view.
    gap : Scalar or ``(N,)``, in frames or seconds: k is in the same unit.

    Returns
    -------
    k : ``(N,)``, NaN unless the status is ``ok``.
    status : ``(N,)``: ``at_epipole`` (a view has the point on the epipole line), ``no_parallax`` (equal tangents, or
        no positive gap), ``no_epipole`` (an angle is NaN).

    Source: the paper's (2), DESIGN equation 2.

    >>> k, status = k_from_two_angles(np.arctan([1 / 10]), np.arctan([1 / 7]), 3.0)
    >>> k.round(12), status
    (array([10.]), array([0]))
    """
    alpha, beta, gap = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (alpha_rad, beta_rad, gap)))
    sin_difference = np.sin(beta - alpha)
    is_at_epipole = np.minimum(np.abs(np.sin(alpha)), np.abs(np.sin(beta))) <= _ANGLE_ROUNDING_RAD
    has_no_parallax = (np.abs(sin_difference) <= _ANGLE_ROUNDING_RAD) | ~(gap > 0.0)
    status = np.select(
        [np.isnan(alpha) | np.isnan(beta), is_at_epipole, has_no_parallax],
        [Status.no_epipole, Status.at_epipole, Status.no_parallax],
        Status.ok,
    ).astype(np.int64)
    k = np.full(alpha.shape, np.nan)
    np.divide(gap * np.sin(beta) * np.cos(alpha), sin_difference, out=k, where=status == Status.ok)
    return k, status


def collision_point(rays: Floats, direction: Floats, tcpa_s: Floats, miss_s: Floats) -> Floats:
    """The point P' in collision-time units: P / abs(V), approaching or receding alike.

    ``P' = -tcpa dir + miss v_H`` with v_H the unit part of the ray normal to dir. A point on the epipole line has no
    v_H and needs none.

    Parameters
    ----------
    rays : ``(N, 3)`` of any length.
    direction : ``(3,)`` or ``(N, 3)`` unit vector dir = V / abs(V).
    tcpa_s, miss_s : ``(N,)``, the paper's k and H.

    Returns
    -------
    ``(N, 3)`` s; NaN where an input is NaN.

    Source: the paper's (3) with the sign of V as it is here, DESIGN equation 4.

    >>> collision_point(np.array([[1.0, 0.0, 2.0]]), np.array([0.0, 0.0, -1.0]), np.array([4.0]), np.array([2.0]))
    array([[2., 0., 4.]])
    """
    across = rays - np.einsum("...i,...i->...", rays, direction)[..., None] * direction
    v_h = np.where((across == 0.0).all(axis=-1, keepdims=True), 0.0, normalize(across))
    return np.asarray(-tcpa_s[..., None] * direction + miss_s[..., None] * v_h)


def times_from_position_velocity(position: Floats, velocity: Floats) -> PointTimes:
    """The three times of points with known position and relative velocity: P and V ``(N, 3)`` in the camera frame.

    ``tcpa = -P.V / V^2``, ``miss = abs(P x V) / V^2``, ``ttc_z = -Z / Vz``, in any one unit of length (V per s). NaN
    where V (for ttc_z: Vz) is zero.

    Source: the paper's k and H, (2) and (3); DESIGN equation 4 and section 2.

    The crossing car of the conventions:

    >>> times = times_from_position_velocity(np.array([[20.0, 0.0, 20.0]]), np.array([[-10.0, 0.0, -2.0]]))
    >>> [round(float(t[0]), 2) for t in times]
    [2.31, 1.54, 10.0]
    """
    across = cross(position, velocity)
    along, across2, speed2 = (
        np.einsum("...i,...i->...", v, w) for v, w in ((position, velocity), (across, across), (velocity, velocity))
    )
    tcpa_s, miss_s = quotient(-along, speed2), quotient(np.sqrt(across2), speed2)
    return PointTimes(tcpa_s, miss_s, quotient(-position[..., 2], velocity[..., 2]))


def times_from_state(state: Floats) -> PointTimes:
    """The three times from the image state ``(N, 5)`` (x, y, a, b, c), with (a, b, c) = V / Z in 1/s.

    ``ttc_z = -1 / c``, ``tcpa = -(ax + by + c) / abs(abc)^2``, ``miss = abs((x, y, 1) x (a, b, c)) / abs(abc)^2``.
    NaN where (a, b, c) (for ttc_z: c) is zero.

    Source: DESIGN section 3, the general estimator.

    >>> times = times_from_state(np.array([[1.0, 0.0, -0.5, 0.0, -0.1]]))
    >>> [round(float(t[0]), 2) for t in times]
    [2.31, 1.54, 10.0]
    """
    ray = np.concatenate([state[..., :2], np.ones_like(state[..., :1])], axis=-1)
    return times_from_position_velocity(ray, state[..., 2:])
