"""General motion: the epipole and k of a single point from three views, nothing else known.

The rate at which the angle of a point changes fixes where, on the great circle of its flow, it comes from. The motion
has to be constant over the three views, and the change of the flow between them has to stand out of the noise:
at consecutive frames it seldom does (k = 60 frames, 0.2 px: 16 times k), over gaps of several frames it may.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from ttcvid.geometry.paper.collision import angle_from_direction, k_from_two_angles
from ttcvid.geometry.paper.epipole import INFINITY_COSINE, SIGNIFICANCE_SIGMAS
from ttcvid.geometry.quotient import quotient
from ttcvid.geometry.rotation import cross, normalize, tangent_basis
from ttcvid.model import Floats, Ints, Status

# What three points may miss a common great circle by: the 99 % quantile of chi-square.
_CHI2_99_ONE = float(chdtri(1, 0.01))


def epipole_offset_three_frames(
    A: Floats, B: Floats, C: Floats, gap_1: float | Floats, gap_2: float | Floats
) -> Floats:
    """Angle x to add to angles measured from any reference in the flow's plane, to have them from the epipole.

    ``tan x = (d1 A (B - C) - d2 C (A - B)) / (d2 (A - B) - d1 (B - C))``. The paper's formula is d1 = d2.

    Parameters
    ----------
    A, B, C : ``(N,)`` tangents of the measured angles, oldest first.
    gap_1, gap_2 : Gaps d1 from A to B and d2 from B to C, in any one unit; scalar or ``(N,)``.

    Returns
    -------
    ``(N,)`` rad in [-pi/2, pi/2]: the tangent knows the line through the epipole, not the side. NaN where the three
    angles are equal.

    Source: the paper's (6), generalised; DESIGN equation 7.

    A point with H = 1 at k = 5, 4, 3, measured from the epipole itself:

    >>> epipole_offset_three_frames(np.array([1 / 5]), np.array([1 / 4]), np.array([1 / 3]), 1.0, 1.0).round(12) + 0.0
    array([0.])
    """
    numerator = gap_1 * A * (B - C) - gap_2 * C * (A - B)
    denominator = gap_2 * (A - B) - gap_1 * (B - C)
    angle = np.arctan2(numerator, denominator)
    angle = np.where(angle > 0.5 * np.pi, angle - np.pi, np.where(angle < -0.5 * np.pi, angle + np.pi, angle))
    return np.where((A == B) & (B == C), np.nan, angle)


def three_frame_direction(
    rays: Floats, gap_1: float | Floats, gap_2: float | Floats, sigma_rad: Floats
) -> tuple[Floats, Floats, Ints]:
    """Direction of motion and k of each point from three views.

    Parameters
    ----------
    rays : ``(3, N, 3)`` oldest first, rotated into the last camera; any length.
    gap_1, gap_2 : Gaps from the first to the second and from the second to the third view; scalar or ``(N,)``.
    sigma_rad : ``(N,)`` standard deviation of a ray's direction per axis.

    Returns
    -------
    direction : ``(N, 3)`` unit vectors dir = V / abs(V), in the plane that fits the three rays best.
    k : ``(N,)`` time to closest approach at the last view, in the unit of the gaps.
    status : ``(N,)``. Without values: ``short_track`` (NaN), ``no_parallax`` (flow within 3 sigma), ``not_rigid`` (the
        rays miss a common great circle at the 99 % level: no constant motion). With values: ``epipole_at_infinity``
        (within 1 deg of the picture plane; k may be NaN at exactly constant bearing rate).

    Source: the paper's section 2.3 and (6); DESIGN equation 7.
    """
    gap_1, gap_2 = (np.broadcast_to(np.asarray(gap, dtype=np.float64), rays.shape[1]) for gap in (gap_1, gap_2))
    rays = normalize(rays)
    reference, along, miss2 = _best_great_circle(rays)
    normal = cross(reference, along)
    angles = angle_from_direction(rays, reference, normal)
    tangents = np.tan(angles)
    x = epipole_offset_three_frames(tangents[0], tangents[1], tangents[2], gap_1, gap_2)
    direction = np.cos(x)[:, None] * reference - np.sin(x)[:, None] * along
    direction *= np.where(np.einsum("ni,ni->n", rays[2] - rays[0], direction) < 0.0, -1.0, 1.0)[:, None]
    k_first, _ = k_from_two_angles(angles[0] + x, angles[2] + x, gap_1 + gap_2)
    flow2 = np.einsum("ni,ni->n", rays[2] - rays[0], rays[2] - rays[0])
    status = np.select(
        [
            ~np.isfinite(flow2 + sigma_rad) | ~((gap_1 > 0.0) & (gap_2 > 0.0)),
            (flow2 <= SIGNIFICANCE_SIGMAS**2 * 2.0 * sigma_rad**2) | ~np.isfinite(x),
            miss2 > _CHI2_99_ONE * sigma_rad**2,
            np.abs(direction[:, 2]) < INFINITY_COSINE,
        ],
        [Status.short_track, Status.no_parallax, Status.not_rigid, Status.epipole_at_infinity],
        Status.ok,
    ).astype(np.int64)
    has_value = (status == Status.ok) | (status == Status.epipole_at_infinity)
    k = k_first - (gap_1 + gap_2)
    return np.where(has_value[:, None], direction, np.nan), np.where(has_value, k, np.nan), status


def _best_great_circle(rays: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit of a great circle to three unit rays: a ray and a tangent in its plane ``(N, 3)``, squared misfit in rad^2.

    Total least squares in the tangent plane of the mean ray, where a great circle is a line: differences of rays are
    formed before they are squared, so that short flows keep their digits.
    """
    mean = normalize(rays.sum(axis=0))
    basis = tangent_basis(mean)
    flat = quotient(np.einsum("kni,nij->knj", rays, basis), np.einsum("kni,ni->kn", rays, mean)[..., None])
    centre = flat.mean(axis=0)
    dx, dy = np.moveaxis(flat - centre, -1, 0)
    xx, yy, xy = (dx * dx).sum(axis=0), (dy * dy).sum(axis=0), (dx * dy).sum(axis=0)
    turn = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    line = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    off = -line[:, 1] * dx + line[:, 0] * dy
    reference = normalize(mean + np.einsum("nij,nj->ni", basis, centre))
    along = np.einsum("nij,nj->ni", basis, line)
    along = normalize(along - np.einsum("ni,ni->n", along, reference)[:, None] * reference)
    return reference, along, (off * off).sum(axis=0)
