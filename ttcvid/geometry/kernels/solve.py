"""Small positive definite systems."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled
from ttcvid.model import Floats


@compiled
def solve(matrix: Floats, right: Floats) -> float:
    """Turn ``right (N,)`` into the solution, by Cholesky's decomposition; return ``right . solution``.

    Only the lower half of ``matrix (N, N)`` counts, and becomes its Cholesky factor; NaN where not positive definite.
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
def eliminate(equations: Floats, kept: Floats, information: Floats, score: Floats) -> None:
    """Add what equations say of all unknowns but the first three, which follow (Schur complement).

    ``equations (N + 1, N)``: information, of which the lower half counts, and in the last row the score. Fills ``kept
    (3, N + 1)`` for `follow`. Adds to ``information (N - 3, N - 3)``, its lower half, and ``score (N - 3,)``: nothing
    where the third unknown stays open.
    """
    size = equations.shape[1]
    for r in range(3):
        for i in range(r, size + 1):
            kept[r, i] = equations[i, r]
            for q in range(r):
                kept[r, i] -= kept[q, r] / kept[q, q] * kept[q, i]
    if kept[2, 2] > 0.0:
        for c in range(3, size):
            x, y, z = kept[0, c] / kept[0, 0], kept[1, c] / kept[1, 1], kept[2, c] / kept[2, 2]
            score[c - 3] += equations[size, c] - x * kept[0, size] - y * kept[1, size] - z * kept[2, size]
            for d in range(3, c + 1):
                information[c - 3, d - 3] += equations[c, d] - x * kept[0, d] - y * kept[1, d] - z * kept[2, d]


@compiled
def follow(kept: Floats, step: Floats) -> None:
    """Fill the first three of ``step (N,)``, those that `eliminate` took out, for the others as they stand in it.

    They stay where they are, with a step of 0, where the third of them is open.
    """
    is_open, size = not kept[2, 2] > 0.0, len(step)
    for r in range(2, -1, -1):
        rest = kept[r, size]
        for i in range(r + 1, size):
            rest -= kept[r, i] * step[i]
        step[r] = 0.0 if is_open else rest / kept[r, r]
