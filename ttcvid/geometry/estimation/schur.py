"""Elimination of the points of a bundle adjustment (Schur complement): N of them, of three unknowns each.

What all points hold lies component by component, (3, N): numpy then works on long rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Floats

_N_POINT = 3


@dataclass(frozen=True)
class EliminatedPoints:
    """What the points leave to K other unknowns.

    ``root (3, 3, N)`` is the lower triangular Cholesky factor of each point's Hessian; ``mixed (K, 3, N)`` and
    ``gradient (3, N)``, what couples the points with the others and their gradient, are divided by it.
    """

    root: Floats
    mixed: Floats
    gradient: Floats

    @property
    def information(self) -> Floats:
        """What the others know less for not knowing the points, (K, K)."""
        flat = self.mixed.reshape(len(self.mixed), -1)
        return np.asarray(flat @ flat.T)

    @property
    def pull(self) -> Floats:
        """What the points' own steps take from the gradient of the others, (K,)."""
        return np.asarray(self.mixed.reshape(len(self.mixed), -1) @ self.gradient.ravel())

    @property
    def scores(self) -> Floats:
        """The part of each point in ``pull``, (K, N)."""
        return np.asarray((self.mixed * self.gradient).sum(axis=1))

    def steps(self, step: Floats) -> Floats:
        """The steps (3, N) of the points that belong to ``step (K,)`` of the others."""
        left = self.gradient - (step @ self.mixed.reshape(len(step), -1)).reshape(_N_POINT, -1)
        for row in reversed(range(_N_POINT)):
            left[row] /= self.root[row, row]
            left[:row] -= self.root[row, :row] * left[row]
        return left


def eliminated(hessian: Floats, gradient: Floats, mixed: Floats) -> EliminatedPoints:
    """Eliminate points with the positive definite ``hessian (3, 3, N)``, ``gradient (3, N)``, ``mixed (K, 3, N)``."""
    root = np.zeros_like(hessian)
    mixed, gradient = mixed.copy(), gradient.copy()
    for row in range(_N_POINT):
        root[row, row] = np.sqrt(hessian[row, row] - (root[row, :row] ** 2).sum(axis=0))
        for below in range(row + 1, _N_POINT):
            root[below, row] = hessian[below, row] - (root[below, :row] * root[row, :row]).sum(axis=0)
            root[below, row] /= root[row, row]
        for right in (mixed, gradient[None]):
            right[:, row] /= root[row, row]
            for below in range(row + 1, _N_POINT):
                right[:, below] -= root[below, row] * right[:, row]
    return EliminatedPoints(root, mixed, gradient)


def cross_of_rows(v: Floats, w: Floats) -> Floats:
    """Cross products of ``v, w (J, 3, ..., N)`` along their second axis, broadcast."""
    v0, v1, v2, w0, w1, w2 = v[:, 0], v[:, 1], v[:, 2], w[:, 0], w[:, 1], w[:, 2]
    return np.stack([v1 * w2 - v2 * w1, v2 * w0 - v0 * w2, v0 * w1 - v1 * w0], axis=1)
