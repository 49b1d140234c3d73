"""Normal equations of weighted residuals and their derivatives, side by side."""

from __future__ import annotations

import numpy as np

from ttcvid.compiled import ZERO, compiled, compiled_in_place
from ttcvid.model import Floats


@compiled_in_place
def product(rows: Floats, c: int, d: int, first: int, stop: int) -> float:
    """The inner product of two rows, from one place to another."""
    total = 0.0
    # By an index without a sign: several places are worked at at a time.
    for k in range(np.uint64(first), np.uint64(stop)):
        total += rows[c, k] * rows[d, k]
    return total


@compiled
def add_equations(rows: Floats, stop: int, information: Floats, score: Floats) -> None:
    """Add to ``information (U, U)``, its lower half, and to ``score (U,)``.

    ``rows (U + 1, M)`` have derivatives of a prediction by U unknowns, and last what was seen less what is predicted,
    all of them times the root of the weight.
    """
    n = len(score)
    for c in range(n):
        for d in range(c + 1):
            information[c, d] += product(rows, c, d, ZERO, stop)
        score[c] += product(rows, c, n, ZERO, stop)
