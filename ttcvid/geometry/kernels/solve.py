"""Small positive definite systems."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import compiled
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
def eliminate(equations: Floats, kept: Floats, information: Floats, score: Floats) -> None:
    """Add what equations say of all unknowns but the first n, which follow (Schur complement).

    ``equations (N + 1, N)``: information, of which the lower half counts, and in the last row the score; changed in
    place. Fills ``kept (N + 1, n)`` for `follow`. Adds to ``information (N - n, N - n)``, its lower half, and ``score
    (N - n,)``: nothing where the n-th unknown stays open.
    """
    n, size = kept.shape[1], equations.shape[1]
    for r in range(n):
        for i in range(r, size + 1):
            kept[i, r] = equations[i, r]
        for i in range(r + 1, size + 1):
            part = kept[i, r] / kept[r, r]
            for c in range(r + 1, min(i, size - 1) + 1):
                equations[i, c] -= part * kept[c, r]
    if kept[n - 1, n - 1] > 0.0:
        for c in range(size - n):
            score[c] += equations[size, n + c]
            for d in range(c + 1):
                information[c, d] += equations[n + c, n + d]


@compiled
def follow(kept: Floats, step: Floats) -> None:
    """Fill the first n of ``step (N,)``, those that `eliminate` took out, for the others as they stand in it.

    They stay where they are, with a step of 0, where the n-th of them is open.
    """
    n, size = kept.shape[1], len(step)
    is_open = not kept[n - 1, n - 1] > 0.0
    for r in range(n - 1, -1, -1):
        step[r] = 0.0 if is_open else kept[size, r] / kept[r, r]
        for i in range(r + 1, size):
            step[r] -= 0.0 if is_open else kept[i, r] / kept[r, r] * step[i]
