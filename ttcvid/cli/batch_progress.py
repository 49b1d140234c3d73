"""How far a batch has come: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.progress import Progress as Bar

from ttcvid.cli.progress import LINE_EVERY_S

if TYPE_CHECKING:
    from ttcvid.jobs.batch.run_batch import OnFailure, OnProgress, Progress


@contextmanager
def batch_progress(*, enabled: bool = True) -> Iterator[tuple[OnProgress, OnFailure]]:
    """Two functions to call: with the progress, and with each failure; both write to stderr."""
    console = Console(stderr=True)
    bar = Bar(
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("clips"),
        TextColumn("{task.fields[words]}"),
        console=console,
        transient=True,
        disable=not (enabled and console.is_terminal),
    )
    next_line_s = time.monotonic() + LINE_EVERY_S

    def on_progress(progress: Progress) -> None:
        nonlocal next_line_s
        bar.update(task, completed=progress.n_done, total=progress.n_clips, words=words_of(progress))
        if bar.disable and enabled and time.monotonic() >= next_line_s:
            line = f"ttcvid: {progress.n_done} of {progress.n_clips} clips, {words_of(progress)}"
            print(line, file=sys.stderr, flush=True)
            next_line_s = time.monotonic() + LINE_EVERY_S

    def on_failure(clip: str, reason: str, is_tried_again: bool) -> None:
        if enabled:
            kind, more = ("warning", ": it will be tried again") if is_tried_again else ("error", "")
            # Not click.echo: that would bypass rich, which puts what is printed above its bar.
            print(f"ttcvid: {kind}: clip {clip}: {reason}{more}", file=sys.stderr, flush=True)

    with bar:
        task = bar.add_task("clips", total=None, words="")
        yield on_progress, on_failure


def words_of(progress: Progress) -> str:
    """Failures, frames/s and the time left."""
    parts = [f"{progress.n_failed} failed"] if progress.n_failed else []
    parts.append(f"{progress.n_frames / max(progress.time_s, 1e-3):.0f} frames/s")
    if progress.time_left_s is not None:
        minutes, seconds = divmod(round(progress.time_left_s), 60)
        hours, minutes = divmod(minutes, 60)
        parts.append(f"{hours}:{minutes:02d}:{seconds:02d} left")
    return ", ".join(parts)
