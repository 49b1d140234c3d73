"""Small positive definite systems."""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.model import Floats


@compiled
def solve(matrix: Floats, right: Floats) -> float:
    """Turn ``right (N,)`` into the solution, by Cholesky's decomposition; return ``right . solution``.

    Only the lower half of ``matrix (N, N)`` counts, and becomes its Cholesky factor. NaN where it is not positive
    definite.
    """
    n, product = len(right), 0.0
    for j in range(n):
        for k in range(j):
            matrix[j, j] -= matrix[j, k] * matrix[j, k]
            right[j] -= matrix[j, k] * right[k]
        matrix[j, j] = np.sqrt(matrix[j, j])
        right[j] /= matrix[j, j]
        product += right[j] * right[j]
        for i in range(j + 1, n):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            matrix[i, j] /= matrix[j, j]
    for j in range(n - 1, -1, -1):
        for i in range(j + 1, n):
            right[j] -= matrix[i, j] * right[i]
        right[j] /= matrix[j, j]
    return product


@compiled
def eliminate(matrix: Floats, right: Floats, n: int) -> None:
    """Take from the equations of the other unknowns what the first n explain when they follow (Schur complement).

    In place, of the lower half of ``matrix (N, N)`` and of ``right (N,)``, one unknown after the other.
    """
    for r in range(n):
        for i in range(r + 1, len(right)):
            part = matrix[i, r] / matrix[r, r]
            right[i] -= part * right[r]
            for c in range(r + 1, i + 1):
                matrix[i, c] -= part * matrix[c, r]


@compiled
def follow(matrix: Floats, right: Floats, step: Floats) -> None:
    """Fill the first n of ``step (N,)``, those that `eliminate` took out, for the others as they stand in it.

    ``matrix (N, n)`` and ``right (n,)`` are the first columns and numbers of what it left.
    """
    for r in range(len(right) - 1, -1, -1):
        step[r] = right[r]
        for i in range(r + 1, len(step)):
            step[r] -= matrix[i, r] * step[i]
        step[r] /= matrix[r, r]


@compiled_for("(f8[:, :, ::1], f8[:, ::1])")
def solve_each(matrices: Floats, rights: Floats) -> None:
    """`solve` of M small systems, ``matrices (M, N, N)`` and ``rights (M, N)``: a tenth of the time of LAPACK's."""
    for i in range(len(rights)):
        solve(matrices[i], rights[i])
