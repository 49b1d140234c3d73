"""The one place where inner loops are compiled to machine code."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import codegen
from numba.core.registry import cpu_target

from ttcvid.geometry.copies_on_disk import INDEX_ENDING, checked_cache, damaged_copies

F = TypeVar("F", bound=Callable[..., Any])

# Whoever changes these removes the copies on disk (`make clean`, or what lies in NUMBA_CACHE_DIR): numba knows a copy
# by its source file and the processor, not by what it was compiled with. An installation replaces all source files,
# which makes all copies stale.
# Without "nsz": together with "reassoc" it lets the compiler take x - x for zero, so that no sum with a NaN in it would
# be found not to be finite.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc"},
}


_FUNCTIONS: list[Any] = []

# numba imports the seventy modules that say what compiled code is made of when a compiled function is first called.
# Imported with all else, they are there before a process is copied: loaded once, and not by both.
cpu_target.target_context.refresh()

# Its parts have no types.
_NUMBA: Any = codegen
_Library: Any = _NUMBA.JITCodeLibrary


class _Loaded(_Library):  # type: ignore[misc]
    """Machine code from disk, whose intermediate code is parsed only when a caller is compiled.

    A copy on disk holds both. Only the compiler asks for the latter, to put the function in where it is called; numba
    parses it and lists its symbols all the same, which takes twice as long as all else that loading does: 0.3 s of the
    start of an analysis.
    """

    _intermediate: bytes | None = None
    _shared_module: Any

    @classmethod
    def _unserialize(cls, target: Any, state: Any) -> Any:
        """As numba's, but for the intermediate code."""
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(target, state)
        library = target.create_library(name)
        machine_code, library._intermediate = data
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        return library

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None and self._intermediate is not None:
            self._shared_module = _NUMBA.ll.parse_bitcode(self._intermediate)
        return super()._get_module_for_linking()

    def get_pointer_to_function(self, name: str) -> Any:
        """Of a function by its name, without a look at the list of symbols where there is none."""
        if self._intermediate is None:
            return super().get_pointer_to_function(name)
        return self._codegen._engine.get_function_address(name)


cpu_target.target_context.codegen()._library_class = _Loaded


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

    A loop over points side by side works at several of them at a time where nothing in it branches, where places are
    counted without a sign (`numpy.uint64`), and where the compiler sees how far apart they are: all that the loop
    writes in one flat array, at distances that are constants, sixteen points or more.
    """
    return _compiled(function)


def compiled_in_place(function: F) -> F:
    """The same, put in where it is called: only so can a loop that calls it work at several items side by side."""
    return _compiled(function, forceinline=True)


def _compiled(function: F, **more: Any) -> F:
    done = numba.njit(**_OPTIONS, **more)(function)
    try:
        done._cache = checked_cache(function)
    except RuntimeError as error:
        if "no locator" not in str(error):
            raise
        # Neither the package's folder nor the user's can be written to.
    _FUNCTIONS.append(done)
    return cast(F, done)


def has_place_on_disk() -> bool:
    """Whether what is compiled can be kept for the next run."""
    return all(function.stats.cache_path for function in _FUNCTIONS)


def part_on_disk() -> float:
    """The part of all compiled functions imported so far that a former run has left on disk."""
    written_s = {
        entry.name.rpartition(".py")[0]: entry.stat().st_mtime
        for folder in _folders()
        for entry in os.scandir(folder)
        if entry.name.endswith(INDEX_ENDING)
    }
    return sum(_is_among(function.py_func, written_s) for function in _FUNCTIONS) / max(len(_FUNCTIONS), 1)


def damaged_on_disk() -> list[Path]:
    """Copies, left by former runs, that are not as they were written: no run uses them."""
    return [file for folder in _folders() for file in damaged_copies(folder)]


def _folders() -> list[Path]:
    """Where copies of the functions imported so far lie."""
    paths = {function.stats.cache_path for function in _FUNCTIONS} - {None}
    return [Path(path) for path in sorted(paths) if os.path.isdir(path)]


def _is_among(function: Any, written_s: dict[str, float]) -> bool:
    """Whether a function is among those on disk, by numba's names for them, and not older than its source."""
    code = function.__code__
    name = f"{Path(code.co_filename).stem}.{function.__qualname__}-{code.co_firstlineno}"
    return written_s.get(name, 0.0) >= os.stat(code.co_filename).st_mtime
