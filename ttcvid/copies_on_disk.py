"""Copies of compiled functions on disk, each with a checksum: one that is damaged or out of date counts as absent.

numba reads its copies as they are. An empty file (a full disk, a power cut) would end every later run, and a changed
byte of machine code could do anything at all. It also writes the index of a changed function before its code: killed
in between, later runs would compute with the former code. And it knows a function by its own file alone, though the
machine code holds what that calls and the constants that it uses of others.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np
from numba.core import caching

MARK = "-checked"
"""What the names of checked copies end with, before numba's own ending."""
INDEX_ENDING = f"{MARK}.nbi"

_DIGEST_BYTES = hashlib.sha256().digest_size

# Its parts have no types.
_CACHING: Any = caching
_File: Any = _CACHING.IndexDataCacheFile
_Cache: Any = _CACHING.FunctionCache


def checked_cache(function: Callable[..., Any]) -> Any:
    """Where copies of a function are kept on disk; what `numba.njit` with ``cache=True`` has, with checksums.

    Raises
    ------
    RuntimeError
        There is no folder to keep them in.
    """
    return _CheckedCache(function)


def damaged_copies(folder: Path) -> list[Path]:
    """Copies in a folder that cannot be read or are not as they were written."""
    return [file for file in sorted(folder.glob(f"*{MARK}.*nb[ic]")) if _source_of(file) is None]


class _CheckedFile(_File):  # type: ignore[misc]
    """As numba's, but each file ends with the digests of its content and of the source that it was compiled from."""

    def __init__(self, function: Callable[..., Any], *where: Any) -> None:
        super().__init__(*where)
        self._function = function

    @contextmanager
    def _open_for_write(self, path: str) -> Iterator[BinaryIO]:
        with super()._open_for_write(path) as file:
            yield file
            file.flush()
            file.write(_digest(Path(file.name).read_bytes()) + self._source)

    def _load_index(self) -> dict[Any, str]:
        return super()._load_index() if _source_of(Path(self._index_path)) == self._source else {}

    def _load_data(self, name: str) -> Any:
        if _source_of(Path(self._data_path(name))) != self._source:
            raise FileNotFoundError(name)  # numba compiles what is not there
        return super()._load_data(name)

    @property
    def _source(self) -> bytes:
        return _digest(repr((self._source_stamp, sorted(_uses_of(self._function)))).encode())


class _CheckedCache(_Cache):  # type: ignore[misc]
    """As numba's, with checked files. One that cannot be written costs the next run time, not this one its result."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        place = self._impl.locator
        self._cache_file: Any = _CheckedFile(
            function, place.get_cache_path(), self._impl.filename_base + MARK, place.get_source_stamp()
        )

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep a copy where that can be done (disk full, or a file of somebody else's in its place)."""
        with suppress(OSError):
            super().save_overload(signature, data)


def _uses_of(function: Any) -> set[str]:
    """The files of the compiled functions that a function calls, as they are now, and the constants that they use."""
    uses, known, left = set(), {function}, [function]
    while left:
        caller = left.pop()
        cells = (cell.cell_contents for cell in caller.__closure__ or ())
        names = {name: caller.__globals__.get(name) for name in caller.__code__.co_names}
        for module in [value for value in names.values() if isinstance(value, ModuleType)]:
            names |= {f"{module.__name__}.{name}": vars(module)[name] for name in names if name in vars(module)}
        for name, value in (*names.items(), *zip(caller.__code__.co_freevars, cells, strict=True)):
            callee = getattr(value, "py_func", None)
            if isinstance(value, bool | int | float | str | tuple | np.generic):
                uses.add(f"{name} = {value!r}")
            elif callee is not None and callee not in known:
                known.add(callee)
                left.append(callee)
                file = Path(callee.__code__.co_filename)
                uses.add(f"{file} {file.stat().st_mtime_ns} {file.stat().st_size}")
    return uses


def _source_of(path: Path) -> bytes | None:
    """The digest of the source that a copy was compiled from; None where the copy cannot be read or is damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    if len(content) < 2 * _DIGEST_BYTES:
        return None
    content, digest, source = (
        content[: -2 * _DIGEST_BYTES],
        content[-2 * _DIGEST_BYTES : -_DIGEST_BYTES],
        content[-_DIGEST_BYTES:],
    )
    return source if _digest(content) == digest else None


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()
