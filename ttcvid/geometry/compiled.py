"""The one place where inner loops are compiled to machine code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """The same function of scalars and arrays, compiled by numba at its first call and kept on disk.

    It runs without the interpreter's lock. Divisions by zero give infinity or NaN as numpy's do; there is neither
    reordering of sums (fastmath) nor threads inside, so that two runs give identical numbers. A product and the sum
    that it goes into are rounded once where the processor can (a sixth of the time; another kind of processor may
    differ in the last digit). A compiled function may call others of its own file only: a change in another file would
    go unnoticed by the copy on disk.
    """
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})(function))
