"""Copies and sums of arrays: numba's own bring along the words of an error, seconds of compilation."""

from __future__ import annotations

from typing import cast

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.model import Floats

ZERO = cast(int, np.int64(0))
"""Of a literal 0 numba makes a type: what is called with it, or with a count that starts there, compiles once more."""


@compiled
def copy(values: Floats, into: Floats) -> None:
    """Copy ``values (N,)``."""
    for i in range(len(into)):
        into[i] = values[i]


@compiled
def copy_rows(values: Floats, into: Floats) -> None:
    """Copy ``values (N, M)``."""
    for i in range(len(into)):
        for j in range(into.shape[1]):
            into[i, j] = values[i, j]


@compiled
def add(values: Floats, into: Floats) -> None:
    """Add ``values (N,)``."""
    for i in range(len(into)):
        into[i] += values[i]
