"""The one place where inner loops are compiled to machine code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

# Without "nsz": together with "reassoc" it lets the compiler take x - x for zero, so that no sum with a NaN in it would
# be found not to be finite.
_OPTIONS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc"},
}


def compiled(function: F) -> F:
    """The same function of scalars and arrays, compiled by numba at its first call and kept on disk.

    It runs without the interpreter's lock. Divisions by zero give infinity or NaN as numpy's do, and there are no
    threads inside. A product and the sum that it goes into are rounded once where the processor can, and a loop adds up
    as many terms side by side as the processor can (a third of the time): two runs give identical numbers, another
    kind of processor may differ in the last digits. A compiled function may call others of its own file only: a change
    in another file would go unnoticed by the copy on disk.

    Where speed counts, functions called for every point take whole arrays and an index, and end in one place: a slice
    counts who holds its array, up and down, as does a function with several ends for what it was given. Such a count
    waits for the other processors, as long as a dozen products take.
    """
    return cast(F, numba.njit(**_OPTIONS)(function))


def compiled_in_place(function: F) -> F:
    """The same, put in where it is called: only so can a loop that calls it work at several items side by side."""
    return cast(F, numba.njit(**_OPTIONS, forceinline=True)(function))
