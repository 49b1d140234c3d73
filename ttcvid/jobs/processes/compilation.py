"""Compiled code: made ahead on all cores where it is missing, and what to know where it cannot be kept.

The inner loops are compiled when they are first called, and kept on disk. A command compiles all that is missing before
its work, so that its progress shows the work alone.
"""

from __future__ import annotations

import hashlib
import importlib
import multiprocessing
import platform
import re
import signal
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numba

import ttcvid
from ttcvid.compiled import damaged_on_disk, entry_points, has_place_on_disk
from ttcvid.errors import TtcvidError
from ttcvid.posix import can_copy_process, usable_cores

OnCompiled = Callable[[int, int], None]
"""Called with (functions done, functions in all)."""

_PACKAGE = Path(ttcvid.__file__).parent
_MARK_OF_SOURCE = rb"(?m)^@compiled"
_DONE_NAME = "ttcvid-compiled-"
# Each takes 200 MB.
_MOST_PROCESSES = 4


def compile_missing(on_compiled: OnCompiled = lambda n_done, n_total: None) -> bool:
    """Compile what no former run has left on disk, on all cores; whether there was anything to do.

    Nothing is done where nothing can be kept: each run then compiles what it uses.

    Raises
    ------
    TtcvidError
        A process that compiles was ended from outside.
    """
    sources = _sources()
    done = _mark_that_all_is_done(sources)
    if done is None or done.exists():
        return False
    import_compiled()
    n_done, n_total = 0, len(entry_points())
    on_compiled(n_done, n_total)
    # A long file takes long: those first, so that all processes end together.
    for n_of_module in _each_compiled(
        [_module(file) for file in sorted(sources, key=lambda file: -file.stat().st_size)]
    ):
        n_done += n_of_module
        on_compiled(n_done, n_total)
    for former in done.parent.glob(f"{_DONE_NAME}*"):
        former.unlink(missing_ok=True)
    done.touch()
    return True


def load_compiled() -> None:
    """Load all compiled functions into this process, so that copies of it (forks) have them.

    Nothing is done unless all of them are on disk: to compile those that nobody calls takes half a minute. Nor in a
    copy of a process that has them: to read all sources for that takes a tenth of a second.
    """
    if entry_points() and all(entry.function.signatures for entry in entry_points()):
        return
    done = _mark_that_all_is_done(_sources())
    if done is None or not done.exists():
        return
    import_compiled()
    for entry in entry_points():
        entry.compile()


def import_compiled() -> None:
    """Import all modules that hold compiled functions: `entry_points` then knows all of them."""
    for file in _sources():
        importlib.import_module(_module(file))


def compilation_complaint() -> str | None:
    """Where nothing can be kept, every run compiles."""
    if has_place_on_disk():
        return None
    return (
        "no folder to keep compiled code in: every run takes half a minute longer; "
        "set NUMBA_CACHE_DIR to a folder that may be written to"
    )


def damage_complaint() -> str | None:
    """Where copies of former runs are damaged, those are compiled again."""
    damaged = damaged_on_disk()
    if not damaged:
        return None
    others = f" and {len(damaged) - 1} more beside it" if len(damaged) > 1 else ""
    return f"{damaged[0]}{others}: damaged compiled code, compiled again when it is used: remove it if this stays"


def _sources() -> list[Path]:
    """The files of the package that hold compiled functions."""
    return [file for file in sorted(_PACKAGE.rglob("*.py")) if re.search(_MARK_OF_SOURCE, file.read_bytes())]


def _mark_that_all_is_done(sources: list[Path]) -> Path | None:
    """The file that is there once all functions of these sources are on disk; None where nothing can be kept."""
    # Any of them says where copies belong, but always the same one.
    first = _module(sources[0])
    importlib.import_module(first)
    folder = next(entry.folder for entry in entry_points() if entry.module == first)
    return None if folder is None else Path(folder) / f"{_DONE_NAME}{_digest(sources)}"


def _module(file: Path) -> str:
    return ".".join((_PACKAGE.name, *file.relative_to(_PACKAGE).with_suffix("").parts))


def _digest(sources: list[Path]) -> str:
    """Changes with what makes numba compile again: source files, versions, and the machine with its processor."""
    stamps = [(str(file), file.stat().st_mtime_ns, file.stat().st_size) for file in sources]
    machine = platform.node(), platform.machine(), numba.__version__, platform.python_version()
    return hashlib.sha256(repr((stamps, machine)).encode()).hexdigest()[:16]


def _each_compiled(modules: list[str]) -> Iterator[int]:
    """Compile modules side by side; the number of functions of each that is done."""
    n_processes = min(usable_cores(), _MOST_PROCESSES)
    if n_processes == 1 or not can_copy_process():
        yield from map(_compile_module, modules)
        return
    with warnings.catch_warnings():
        # Python 3.12 warns of locks that threads hold while a process is copied: no thread of ours runs yet.
        warnings.simplefilter("ignore", DeprecationWarning)
        context = multiprocessing.get_context("fork")
        pool = ProcessPoolExecutor(n_processes, mp_context=context, initializer=_end_with_ctrl_c)
        try:
            for future in as_completed([pool.submit(_compile_module, module) for module in modules]):
                yield future.result()
        except BrokenProcessPool:
            raise TtcvidError("a process that compiles was ended from outside: is there enough memory?") from None
        finally:
            pool.shutdown(cancel_futures=True)


def _compile_module(module: str) -> int:
    """Compile the entry points of a module; their number."""
    entries = [entry for entry in entry_points() if entry.module == module]
    for entry in entries:
        entry.compile()
    return len(entries)


def _end_with_ctrl_c() -> None:
    """Ctrl-C goes to all processes of a terminal: these end without a word."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
