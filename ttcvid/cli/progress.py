"""What a command says on stderr while it works: a progress bar on a terminal, and log lines."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

LOGGER_NAME = "ttcvid"


@contextmanager
def progress_on_terminal(note: str = "", *, enabled: bool = True) -> Iterator[Callable[[int, int | None], None]]:
    """A function to call with (frames done, frames in all or None); shows frames/s and the time left.

    The bar appears where stderr is a terminal, and is gone when the block is left. The ``note`` stands there until the
    first frame is done.
    """
    console = Console(stderr=True)
    bar = Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]} frames/s"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=console,
        transient=True,
        disable=not (enabled and console.is_terminal),
    )
    with bar:
        task = bar.add_task("frames", total=None, rate="  -", note=note)

        def show(n_done: int, n_total: int | None) -> None:
            rate = bar.tasks[0].speed
            bar.update(task, completed=n_done, total=n_total, rate="  -" if rate is None else f"{rate:.1f}", note="")

        yield show


class _StderrHandler(logging.Handler):
    """Log lines in the form of our errors, written to whatever stderr is at that moment."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        # Not click.echo: that would bypass rich, which puts what is printed above its bar.
        print(f"ttcvid: {record.levelname.lower()}: {record.getMessage()}", file=sys.stderr)


def log_to_stderr(*, quiet: bool = False, verbose: bool = False) -> None:
    """Send what ttcvid logs to stderr: warnings; with ``verbose`` more; with ``quiet`` nothing below an error."""
    logger = logging.getLogger(LOGGER_NAME)
    logger.handlers = [_StderrHandler()]
    logger.propagate = False
    logger.setLevel(logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING)
