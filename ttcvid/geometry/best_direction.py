"""Least squares on the unit sphere: the direction that leaves the smallest residuals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Floats

# Determinant over squared trace below which a 2 x 2 matrix is singular.
_SINGULAR = 1e-15
# The search ends where a step changes the direction or the sum of squares by less than this part of it.
_CONVERGED = 1e-12


def best_direction(residuals: Callable[[Floats], Floats], start: Floats) -> tuple[Floats, Floats]:
    """The unit vector ``(3,)`` near ``start (3,)`` with the least sum of squared residuals, and its covariance.

    ``residuals`` of a unit vector are in their standard deviations; the covariance ``(3, 3)`` in the tangent plane,
    rad^2, is infinite where they do not determine the direction.
    """
    from scipy.optimize import least_squares  # takes long to import, and no stage of an analysis needs it

    basis = tangent_basis(start)
    found = least_squares(
        lambda tangent: residuals(normalize(start + basis @ tangent)),
        np.zeros(2),
        "3-point",
        ftol=_CONVERGED,
        xtol=_CONVERGED,
        gtol=_CONVERGED,
    )
    moved = start + basis @ found.x
    direction, information = normalize(moved), found.jac.T @ found.jac
    if not np.linalg.det(information) > _SINGULAR * np.trace(information) ** 2:
        return direction, np.full((3, 3), np.inf)
    by_tangent = (np.eye(3) - np.outer(direction, direction)) @ basis / np.linalg.norm(moved)
    return direction, by_tangent @ np.linalg.inv(information) @ by_tangent.T
