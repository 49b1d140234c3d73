"""The one place where inner loops are compiled to machine code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import sigutils

from ttcvid.copies_on_disk import checked_cache, damaged_copies

F = TypeVar("F", bound=Callable[..., Any])

ZERO = cast(int, np.int64(0))
"""Of a literal 0 numba makes a type: what is called with it, or with a count that starts there, compiles once more."""

# Whoever changes these removes the copies on disk (`make clean`, or what lies in NUMBA_CACHE_DIR): numba knows a copy
# by its source file and the processor, not by what it was compiled with. An installation replaces all source files,
# which makes all copies stale.
# Without "nsz": together with "reassoc" it lets the compiler take x - x for zero, so that no sum with a NaN in it would
# be found not to be finite.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "no_cfunc_wrapper": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc"},
}


@dataclass(frozen=True)
class EntryPoint:
    """A compiled function that Python calls, and the only types of its arguments.

    ``signature`` in numba's words: ``(f8[:, ::1], i8)`` for a contiguous array (N, M) of floats and a whole number.
    """

    function: Any
    signature: str

    @property
    def module(self) -> str:
        """The module that it stands in."""
        return str(self.function.__module__)

    @property
    def folder(self) -> str | None:
        """Where its copy on disk belongs; None where there is no place to keep one."""
        path: str | None = self.function.stats.cache_path
        return path

    def compile(self) -> None:
        """Compile it, or load its copy from disk."""
        # As types: under its text numba would keep a copy that no call finds.
        types, _ = sigutils.normalize_signature(self.signature)  # type: ignore[no-untyped-call]
        self.function.compile(types)


_ENTRY_POINTS: list[EntryPoint] = []


def compiled(function: F) -> F:
    """The same function of scalars and arrays, compiled by numba at its first call and kept on disk.

    For functions that compiled ones call; those that Python calls say their types (`compiled_for`).

    It runs without the interpreter's lock. Divisions by zero give infinity or NaN as numpy's do, and there are no
    threads inside. A product and the sum that it goes into are rounded once where the processor can, and a loop adds up
    as many terms side by side as the processor can (a third of the time): two runs give identical numbers, another
    kind of processor may differ in the last digits.

    Where speed counts, functions called for every point take whole arrays and an index, and end in one place: a slice
    counts who holds its array, up and down, as does a function with several ends for what it was given. Such a count
    waits for the other processors, as long as a dozen products take.

    A loop over points side by side works at several of them at a time where nothing in it branches, where places are
    counted without a sign (`numpy.uint64`), and where the compiler sees how far apart they are: all that the loop
    writes in one flat array, at distances that are constants, sixteen points or more.
    """
    return _compiled(function)


def compiled_for(signature: str) -> Callable[[F], F]:
    """As `compiled`, for a function that Python calls: with arguments of these types alone, as `EntryPoint` says them.

    Other types compile it a second time, with all that it calls: arrays that are strided, read-only or of another kind
    of number are made contiguous where they are made.
    """

    def decorate(function: F) -> F:
        done = _compiled(function)
        _ENTRY_POINTS.append(EntryPoint(done, signature))
        return done

    return decorate


def compiled_in_place(function: F) -> F:
    """The same, put in where it is called: only so can a loop that calls it work at several items side by side.

    It is kept on disk with what calls it, and not by itself.
    """
    return cast(F, numba.njit(**_OPTIONS, forceinline=True)(function))


def compiled_part(function: F) -> F:
    """The same of a function made by another, with functions that it calls: kept on disk only with what calls it."""
    return cast(F, numba.njit(**_OPTIONS)(function))


def entry_points() -> tuple[EntryPoint, ...]:
    """The compiled functions that Python calls, of all modules imported so far."""
    return tuple(_ENTRY_POINTS)


def has_place_on_disk() -> bool:
    """Whether what is compiled can be kept for the next run."""
    return all(entry.folder is not None for entry in _ENTRY_POINTS)


def damaged_on_disk() -> list[Path]:
    """Copies, left by former runs, that are not as they were written: no run uses them."""
    return [file for folder in _folders() for file in damaged_copies(folder)]


def _folders() -> list[Path]:
    """Where copies of the functions imported so far lie."""
    paths = {Path(entry.folder) for entry in _ENTRY_POINTS if entry.folder is not None}
    return sorted(path for path in paths if path.is_dir())


def _compiled(function: F) -> F:
    done = numba.njit(**_OPTIONS)(function)
    try:
        done._cache = checked_cache(function)
    except RuntimeError as error:
        if "no locator" not in str(error):
            raise
        # Neither the package's folder nor the user's can be written to.
    return cast(F, done)
