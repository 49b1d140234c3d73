"""One clip of a batch: what a worker does with it, in whatever process of whatever machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import ttcvid
from ttcvid.errors import UsageError
from ttcvid.jobs.batch.same_run import finished_run
from ttcvid.jobs.batch.table import ClipRow, row_of_run
from ttcvid.jobs.settings.configuration import Configuration

OnFrames = Callable[[int], None]
NEWS_PERIOD_S = 0.5
"""Frames are counted for people: more often than this, telling of them would only cost time."""


@dataclass(frozen=True)
class BatchTask:
    """What is to be done with one clip; all paths are absolute. ``version`` is that of the process that asks."""

    clip: str
    input: str
    folder: Path
    configuration: Configuration
    version: str = ttcvid.__version__


@dataclass(frozen=True)
class BatchResult:
    """The row of a clip that has a result; ``is_kept``: a former one, which needed no analysis."""

    row: ClipRow
    is_kept: bool


def analyze_clip(task: BatchTask, on_news: OnFrames | None = None) -> BatchResult:
    """Analyse a clip, unless its folder has the same result already; ``on_news`` hears of frames that are done.

    Raises
    ------
    TtcvidError
        As `run_analysis`.
    """
    if ttcvid.__version__ != task.version:
        raise UsageError(
            f"this worker has ttcvid {ttcvid.__version__}, the batch {task.version}: install the same on all machines"
        )
    options = task.configuration.options.model_copy(update={"overwrite": True})
    configuration = replace(task.configuration, options=options)
    former = finished_run(task.folder, task.input, configuration)
    if former is not None:
        return BatchResult(row_of_run(task.clip, task.input, former), is_kept=True)
    from ttcvid.jobs.analyze.run_analysis import run_analysis

    told = _Told(on_news)
    arguments = ("batch", task.input)
    run = run_analysis(task.input, task.folder, configuration, arguments=arguments, on_frame=told.add)
    return BatchResult(row_of_run(task.clip, task.input, run), is_kept=False)


class _Told:
    """Tells of the number of frames done, now and then."""

    def __init__(self, on_news: OnFrames | None) -> None:
        self._on_news = on_news
        self._next_s = 0.0

    def add(self, n_done: int, n_total: int | None) -> None:
        if self._on_news is not None and time.monotonic() >= self._next_s:
            self._on_news(n_done)
            self._next_s = time.monotonic() + NEWS_PERIOD_S
