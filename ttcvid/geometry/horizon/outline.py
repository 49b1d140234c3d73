"""The direction of an object that moves as a whole, from the top and the bottom of its outline.

In a straight motion a point at the top and one at the bottom run along two lines of the picture, which meet at the
epipole, where the object would have no height. Whatever its speed, (x, top, bottom) then moves along a straight line in
three dimensions, and the epipole is where that line crosses the plane top = bottom.

A pedestrian bobs about that line, once per step: a wave that is fitted together with the line (`horizon.gait`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from ttcvid.geometry.horizon.gait import find_steps
from ttcvid.geometry.medians import MEDIAN_RAYLEIGH
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Floats, Ints

# The line is started through each pair of so many places along the way.
_PLACES = 20
_ROUNDS = 30
# Scale of the Cauchy weights, in sigmas.
_CAUCHY_SIGMAS = 2.0
_TINY = 1e-12


@dataclass(frozen=True)
class OutlineFit:
    """An epipole ``direction (3,)``, its sign along the motion, with ``covariance (3, 3)`` in its tangent plane, rad^2.

    ``noise`` is the scatter about the line in the units of the outlines, without the bobbing of steps; ``bend_sigmas``
    the curvature of the path in standard deviations; ``steadiness`` the part of the variance along the path that a
    constant rate explains, small where an outline shrinks by occlusion only.
    """

    direction: Floats
    covariance: Floats
    noise: float
    bend_sigmas: float
    steadiness: float


@dataclass(frozen=True)
class _Line:
    """A line through ``point`` in the direction ``along``; ``level (N, 3)`` are the outlines without their bobbing.

    ``weight (N,)`` of each outline; ``noise`` the scatter of a coordinate about the line.
    """

    point: Floats
    along: Floats
    level: Floats
    weight: Floats
    noise: float


def fit_outline(
    outline: Floats, t_s: Floats, block: Ints, n_independent: float, border_sigma: float
) -> OutlineFit | None:
    """Fit the line of (x, top, bottom), robust against outlines that merge where objects occlude each other.

    None where there are fewer than three blocks, or no line.

    Parameters
    ----------
    outline : ``(N, 3)`` x, top and bottom in undistorted normalised coordinates.
    t_s : ``(N,)`` ascending times.
    block : ``(N,)`` ascending numbers; errors of different blocks are independent. The covariance is the jackknife's
        over blocks.
    n_independent : Number of independent outlines; the covariance is at least that of so many.
    border_sigma : Constant error of the top and of the bottom, in the unit of ``outline``: where exactly that is seen.

    Source: jackknife as in Efron and Stein, Annals of Statistics, 1981.
    """
    numbers = np.unique(block)
    if len(numbers) < 3:
        return None
    line = _line(outline, _start(outline))
    steps = find_steps(_across(outline, line.point, line.along)[:, 1], t_s, outline[:, 2] - outline[:, 1], line.weight)
    if steps is not None:
        line = _line(outline, (line.point, line.along), steps)
    epipole = _epipole(line.point, line.along)
    if not np.isfinite(epipole).all():
        return None
    basis = tangent_basis(epipole)
    left_out = np.empty((len(numbers), 3))
    for place, number in enumerate(numbers):
        kept = block != number
        part = _line(outline[kept], (line.point, line.along), None if steps is None else steps[kept])
        left_out[place] = _like(_epipole(part.point, part.along), epipole)
    spread = _at_least(_jackknife(left_out @ basis), _formal(line, n_independent, basis))
    for side in (1, 2):
        moved = line.point.copy()
        moved[side] += border_sigma
        shift = (_like(_epipole(moved, line.along), epipole) - epipole) @ basis
        spread += np.outer(shift, shift)
    way = (line.level - line.point) @ line.along
    (of_time, together), (_, of_way) = np.cov(t_s, way, aweights=line.weight).tolist()
    forth = np.sign(together) * np.array([line.along[0], line.along[1:].mean()])
    towards = epipole[:2] - np.array([line.point[0], line.point[1:].mean()]) * epipole[2]
    return OutlineFit(
        direction=epipole if towards @ forth >= 0 else -epipole,
        covariance=basis @ spread @ basis.T,
        noise=line.noise,
        bend_sigmas=_bend_sigmas(line, block),
        steadiness=together**2 / max(of_time * of_way, _TINY**2),
    )


def _start(outline: Floats) -> tuple[Floats, Floats]:
    """Of the lines through pairs of outlines that from which the median distance is least."""
    chosen = outline[np.unique(np.linspace(0, len(outline) - 1, _PLACES).astype(np.int64))]
    one, other = np.triu_indices(len(chosen), 1)
    point, along = chosen[one], normalize(chosen[other] - chosen[one])
    is_line = np.isfinite(along).all(axis=1)
    point, along = point[is_line], along[is_line]
    offset = outline[None] - point[:, None]
    across = offset - np.einsum("lni,li->ln", offset, along)[:, :, None] * along[:, None]
    best = int(np.argmin(np.median(np.linalg.norm(across, axis=2), axis=1)))
    return point[best], along[best]


def _line(outline: Floats, start: tuple[Floats, Floats], terms: Floats | None = None) -> _Line:
    """Total least squares with Cauchy weights, of top and bottom less what the ``terms (N, k)`` of a wave explain."""
    point, along = start
    level, weight, noise = outline.copy(), np.ones(len(outline)), 0.0
    for _ in range(_ROUNDS):
        distance = np.linalg.norm(_across(level, point, along), axis=1)
        noise = float(np.median(distance)) / MEDIAN_RAYLEIGH
        weight = 1.0 / (1.0 + (distance / max(_CAUCHY_SIGMAS * noise, _TINY)) ** 2)
        point = weight @ level / weight.sum()
        offset = level - point
        along = np.linalg.eigh((weight[:, None] * offset).T @ offset)[1][:, -1]
        if terms is not None:
            across, root = _across(outline, point, along)[:, 1:], np.sqrt(weight)[:, None]
            level[:, 1:] = outline[:, 1:] - terms @ np.linalg.lstsq(root * terms, root * across, rcond=None)[0]
    return _Line(point, along, level, weight, noise)


def _across(outline: Floats, point: Floats, along: Floats) -> Floats:
    """Distances ``(N, 3)`` from a line."""
    offset = outline - point
    return np.asarray(offset - (offset @ along)[:, None] * along)


def _epipole(point: Floats, along: Floats) -> Floats:
    """Where the height is zero, as a unit ray ``(3,)`` of either sign; at infinity where the height does not change."""
    height, growth = point[2] - point[1], along[2] - along[1]
    ray = np.append(growth * point[[0, 2]] - height * along[[0, 2]], growth)
    return normalize(ray)


def _formal(line: _Line, n_independent: float, basis: Floats) -> Floats:
    """Covariance ``(2, 2)`` of the epipole from so many independent outlines along the way."""
    point, along = line.point, line.along
    way = (line.level - point) @ along
    of_point = line.noise**2 / n_independent
    of_along = of_point / max(float(np.mean(way**2)), _TINY)
    epipole = _epipole(point, along)
    covariance = np.zeros((2, 2))
    for across in tangent_basis(along).T:
        by_point = _epipole(point + np.sqrt(of_point) * across, along)
        by_along = _epipole(point, normalize(along + np.sqrt(of_along) * across))
        for moved in (by_point, by_along):
            shift = (_like(moved, epipole) - epipole) @ basis
            covariance += np.outer(shift, shift)
    return covariance


def _at_least(covariance: Floats, least: Floats) -> Floats:
    """A covariance ``(2, 2)``, and ``least`` in the directions in which it is smaller."""
    least = least + _TINY * np.eye(2)
    values, vectors = eigh(covariance, least)
    return np.asarray(least @ vectors @ np.diag(np.maximum(values, 1.0)) @ vectors.T @ least)


def _jackknife(left_out: Floats) -> Floats:
    """Covariance ``(k, k)`` of an estimate from those ``(B, k)`` without each of the blocks."""
    change = left_out - left_out.mean(axis=0)
    return np.asarray((len(change) - 1) / len(change) * change.T @ change)


def _like(ray: Floats, other: Floats) -> Floats:
    return -ray if ray @ other < 0 else ray


def _bend_sigmas(line: _Line, block: Ints) -> float:
    """How surely (x, top, bottom) bends: the square term of each of its two distances from the line, by blocks."""
    way, weight = (line.level - line.point) @ line.along, line.weight
    terms = np.column_stack([np.ones_like(way), way, way**2])
    scale = np.abs(terms).max(axis=0) + _TINY
    across = (line.level - line.point) @ tangent_basis(line.along)

    def square(rows: np.ndarray) -> Floats:
        design = terms[rows] / scale * np.sqrt(weight[rows])[:, None]
        found: Floats = np.linalg.lstsq(design, across[rows] * np.sqrt(weight[rows])[:, None], rcond=None)[0][2]
        return found

    left_out = np.array([square(block != number) for number in np.unique(block)])
    error = np.sqrt(np.diag(_jackknife(left_out)))
    return float(np.max(np.abs(square(block >= 0)) / np.maximum(error, _TINY)))
