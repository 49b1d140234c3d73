"""What a command says on stderr while it works: a progress bar on a terminal, and log lines."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ttcvid.errors import on_one_line

LOGGER_NAME = "ttcvid"
LINE_EVERY_S = 10.0
"""Where there is no terminal, a line says how far the work is, so often."""

OnProgress = Callable[[int, int | None], None]
"""Called with (frames done, frames in all or None)."""


def compile_first(*, enabled: bool = True) -> None:
    """Compile what no former run has left on disk, and say so: on a terminal by a bar, elsewhere by lines."""
    from ttcvid.jobs.processes.compilation import compile_missing

    if not enabled:
        compile_missing()
    elif Console(stderr=True).is_terminal:
        columns = TextColumn("compiling, once on this machine"), BarColumn(), MofNCompleteColumn()
        with ExitStack() as stack:
            bar = Progress(*columns, console=Console(stderr=True), transient=True)
            task = bar.add_task("functions", total=None)

            def show(n_done: int, n_total: int) -> None:
                if n_done == 0:  # nothing is shown where nothing is missing
                    stack.enter_context(bar)
                bar.update(task, completed=n_done, total=n_total)

            compile_missing(show)
    else:
        compile_missing(_say_compiled)


def _say_compiled(n_done: int, n_total: int) -> None:
    if n_done in (0, n_total):
        said = f"{n_total} functions compiled" if n_done else "compiling, once on this machine"
        print(f"ttcvid: {said}", file=sys.stderr)


@contextmanager
def progress_on_stderr(*, enabled: bool = True) -> Iterator[OnProgress]:
    """A function to call with (frames done, frames in all or None); shows frames/s and the time left.

    On a terminal it is a bar, which is gone when the block is left. Elsewhere (a log, a CI job) it is a line every
    10 s.
    """
    console = Console(stderr=True)
    if not enabled:
        yield lambda n_done, n_total: None
    elif console.is_terminal:
        with _progress_bar(console) as show:
            yield show
    else:
        yield ProgressLines()


@contextmanager
def _progress_bar(console: Console) -> Iterator[OnProgress]:
    bar = Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]} frames/s"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    with bar:
        task = bar.add_task("frames", total=None, rate="  -")

        def show(n_done: int, n_total: int | None) -> None:
            rate = bar.tasks[0].speed
            bar.update(task, completed=n_done, total=n_total, rate="  -" if rate is None else f"{rate:.1f}")

        yield show


class ProgressLines:
    """Says on stderr how far the work is, at most every 10 s; nothing of work that is shorter.

    Frames/s count from the first frame on: what comes before it (opening, loading of compiled code) is done once.
    ``clock`` gives seconds that only grow.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._said_s = self._begun_s = clock()
        self._n_done = self._n_at_first = 0

    def __call__(self, n_done: int, n_total: int | None) -> None:
        """Take note of the frames that are done, of all that are expected (None: unknown)."""
        now_s = self._clock()
        if self._n_done == 0 or n_done < self._n_done:  # work has begun, or other work, such as the next clip
            self._begun_s, self._n_at_first = now_s, n_done
        if now_s - self._said_s >= LINE_EVERY_S and n_done > self._n_at_first and now_s > self._begun_s:
            self._said_s = now_s
            rate_hz = (n_done - self._n_at_first) / (now_s - self._begun_s)
            of_all = f" of {n_total}" if n_total is not None else ""
            left = f", {(n_total - n_done) / rate_hz:.0f} s left" if n_total is not None and rate_hz > 0 else ""
            print(f"ttcvid: {n_done}{of_all} frames, {rate_hz:.1f} frames/s{left}", file=sys.stderr)
        self._n_done = n_done


class _StderrHandler(logging.Handler):
    """Log lines in the form of our errors, written to whatever stderr is at that moment."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        # Not click.echo: that would bypass rich, which puts what is printed above its bar.
        print(f"ttcvid: {record.levelname.lower()}: {on_one_line(record.getMessage())}", file=sys.stderr)


def log_to_stderr(*, quiet: bool = False, verbose: bool = False) -> None:
    """Send what ttcvid logs to stderr: warnings; with ``verbose`` more; with ``quiet`` nothing below an error."""
    logger = logging.getLogger(LOGGER_NAME)
    logger.handlers = [_StderrHandler()]
    logger.propagate = False
    logger.setLevel(logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING)
