"""Calls in copies (forks) of the test process: nothing that they load or change stays, and nothing is imported anew."""

import multiprocessing
import os
import resource
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ttcvid.cli.main import program
from ttcvid.jobs.analyze import beside
from ttcvid.posix import can_copy_process


def in_copy(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function of a test module returns or raises in a copy of this process."""
    with _without_warning(), multiprocessing.get_context("fork").Pool(1) as pool:
        return pool.apply(function, arguments)


class CommandInCopy:
    """``ttcvid`` with these arguments in a copy of this process, to which signals can be sent.

    What it prints goes to files of a folder, in which it runs, unless ``redirect`` (called in the copy) leads it
    elsewhere; none that it writes may grow over ``largest_file_bytes``.
    """

    def __init__(
        self,
        folder: Path,
        *arguments: object,
        largest_file_bytes: int | None = None,
        redirect: Callable[[], None] = lambda: None,
    ) -> None:
        self._printed = [folder / name for name in ("stdout", "stderr")]
        words = [str(argument) for argument in arguments]
        task = (words, self._printed, largest_file_bytes, redirect)
        self._process = multiprocessing.get_context("fork").Process(target=_become_the_command, args=task)
        with _without_warning():
            self._process.start()

    def is_running(self) -> bool:
        return self._process.is_alive()

    def send_signal(self, number: signal.Signals) -> None:
        assert self._process.pid is not None
        os.kill(self._process.pid, number)

    def ended(self, within_s: float) -> tuple[int | None, str, str]:
        """Exit code, standard output and error, once it has ended."""
        self._process.join(within_s)
        stdout, stderr = (path.read_text(errors="surrogateescape") for path in self._printed)
        return self._process.exitcode, stdout, stderr


def _become_the_command(
    words: list[str], printed: list[Path], largest_file_bytes: int | None, redirect: Callable[[], None]
) -> None:
    os.chdir(printed[0].parent)
    for descriptor, path in enumerate(printed, 1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), descriptor)
    redirect()
    if largest_file_bytes is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file_bytes,) * 2)
    sys.stdout, sys.stderr = (os.fdopen(descriptor, "w", closefd=False) for descriptor in (1, 2))
    sys.argv[1:] = words
    beside.can_copy_process = can_copy_process  # as in any command
    program()


@contextmanager
def _without_warning() -> Iterator[None]:
    """Python 3.12 warns of locks that threads hold while a process is copied: no thread is needed there."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        yield
