"""Many clips at once: each with a result folder of its own, a table of all, and nothing done twice."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

from filelock import FileLock, Timeout

from ttcvid.errors import OutputError, TtcvidError, UsageError, counted
from ttcvid.jobs.batch.clip import BatchResult, BatchTask, analyze_clip
from ttcvid.jobs.batch.index_page import INDEX_NAME, refuse_foreign_index, write_index
from ttcvid.jobs.batch.inputs import BatchClip, read_inputs
from ttcvid.jobs.batch.table import (
    FAILED,
    PENDING,
    TABLE_NAME,
    ClipRow,
    printable,
    refuse_foreign_table,
    write_rows,
)
from ttcvid.jobs.processes.crew import Attempt, Call, Crew
from ttcvid.jobs.processes.stopping import StopSignals
from ttcvid.jobs.processes.workers import LocalWorker, Worker
from ttcvid.jobs.settings.configuration import configure_each
from ttcvid.jobs.settings.layers import Layer, layer_from_arguments
from ttcvid.posix import usable_cores
from ttcvid.sinks.failures import output_errors
from ttcvid.sinks.folder import OutputFolder
from ttcvid.sinks.manifest import MANIFEST_NAME

JOURNAL_NAME, LOCK_NAME = "journal.jsonl", ".ttcvid-batch.lock"
RESERVED_NAMES = frozenset((TABLE_NAME, JOURNAL_NAME, INDEX_NAME))
N_TRIES = 2
CORES_OF_ANALYSIS = 2
"""An analysis that may begin processes of its own keeps as many cores busy."""
EXIT_PARTLY, EXIT_INTERRUPTED = 4, 130


@dataclass
class Progress:
    """How far a batch has come: ``n_done`` of ``n_clips``; ``n_kept`` had a result before, ``n_failed`` have none.

    ``n_frames`` are those analysed now, in clips that are done and in those under way.
    """

    n_clips: int
    n_done: int = 0
    n_kept: int = 0
    n_failed: int = 0
    started_s: float = field(default_factory=time.monotonic)
    frames_of_done: int = 0
    frames_under_way: dict[str, int] = field(default_factory=dict)

    @property
    def n_frames(self) -> int:
        """Frames analysed now."""
        return self.frames_of_done + sum(list(self.frames_under_way.values()))

    @property
    def time_s(self) -> float:
        """Time since the beginning."""
        return time.monotonic() - self.started_s

    @property
    def time_left_s(self) -> float | None:
        """Time that the rest will take, if its clips are like those analysed; None before the first one is done."""
        n_analyzed = self.n_done - self.n_kept
        return self.time_s / n_analyzed * (self.n_clips - self.n_done) if n_analyzed else None


OnProgress = Callable[[Progress], None]
OnFailure = Callable[[str, str, bool], None]
"""Called with the name of a clip, the reason, and whether it will be tried again."""


@dataclass(frozen=True)
class Batch:
    """What became of a batch: a row a clip, in the order of their names."""

    folder: Path
    rows: tuple[ClipRow, ...]
    n_kept: int
    n_frames: int
    time_s: float
    is_interrupted: bool = False

    @property
    def failed(self) -> tuple[ClipRow, ...]:
        """The clips without a result."""
        return tuple(row for row in self.rows if row.state == FAILED)

    @property
    def exit_code(self) -> int:
        """0: every clip is complete; 4: some failed, or end early; 130: stopped by a signal."""
        if self.is_interrupted:
            return EXIT_INTERRUPTED
        return EXIT_PARTLY if any(row.state != "complete" for row in self.rows) else 0

    def _counts(self) -> dict[str, int]:
        states = ("complete", "truncated", FAILED, PENDING)
        return {state: sum(row.state == state for row in self.rows) for state in states}

    def summary(self) -> str:
        """One line: how many clips came out how."""
        counts = self._counts()
        parts = [f"{counts['complete']} of {counted(len(self.rows), 'clip')} complete"]
        parts += [f"{counts[state]} {state}" for state in ("truncated", FAILED, PENDING) if counts[state]]
        parts += [f"{self.n_kept} from before"] if self.n_kept else []
        n_events = sum(row.n_events or 0 for row in self.rows)
        rate = f" ({self.n_frames / self.time_s:.0f} frames/s)" if self.n_frames else ""
        parts += [counted(n_events, "warning"), f"{counted(self.n_frames, 'frame')} in {self.time_s:.1f} s{rate}"]
        page = str(self.folder / INDEX_NAME)
        return f"{self.folder}: {'; '.join([', '.join(parts[:-2]), *parts[-2:], page])}"

    def summary_json(self) -> str:
        """The summary as one JSON object."""
        content = {
            "folder": str(self.folder),
            "exit_code": self.exit_code,
            "counts": self._counts(),
            "n_kept": self.n_kept,
            "n_frames": self.n_frames,
            "time_s": self.time_s,
            "failed": {row.clip: row.reason for row in self.failed},
        }
        return json.dumps(content, sort_keys=True)


def batch(
    inputs: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    config: str | Path | None = None,
    **options: Any,
) -> Batch:
    """Analyse many clips, several at a time, each into a folder of its own below ``out``.

    A script that calls this does so below ``if __name__ == "__main__":``, because its processes import the script.

    Parameters
    ----------
    inputs : Clips, folders, patterns, lists of clips (``.txt``) and tables of clips (``.csv``), see docs/batch.md.
    out : Folder of the batch. What it holds already and is the same is kept; what was left undone is done.
    jobs : Clips at a time, each in a process of its own; default 1. On a cluster, clips handed out at a time; default
        twice the threads of its workers.
    scheduler : Address of the scheduler of a Dask cluster that does the work instead of this machine.
    config : A TOML configuration file. ``TTCVID_*`` variables and ``./ttcvid.toml`` count as on the command line.
    **options : The options of `analyze` for all clips; those of a table of clips are stronger.

    Returns
    -------
    `Batch`: what became of each clip.

    Raises
    ------
    TtcvidError
        The inputs, the configuration or the folder cannot be used; a clip that fails is a row with its reason.
    KeyboardInterrupt
        After Ctrl-C; finished clips are kept, and the same call goes on from there.
    """
    given = [inputs] if isinstance(inputs, str | Path) else inputs
    result = run_batch(
        [str(path) for path in given],
        Path(out),
        layer_from_arguments(options),
        config=Path(config) if config is not None else None,
        jobs=jobs,
        scheduler=scheduler,
    )
    if result.is_interrupted:
        raise KeyboardInterrupt
    return result


def run_batch(
    inputs: Sequence[str],
    out: Path,
    for_all: Layer,
    *,
    config: Path | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    on_progress: OnProgress | None = None,
    on_failure: OnFailure | None = None,
) -> Batch:
    """`batch` with the settings of all clips as a layer, telling of its progress."""
    if jobs is not None and jobs < 1:
        raise UsageError(f"jobs = {jobs}: expected at least 1")
    clips = read_inputs(inputs, out)
    tasks = _tasks(clips, out, for_all, config)
    with output_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with _lock(out), _workers(jobs, scheduler) as workers:
        former = refuse_foreign_table(out)
        refuse_foreign_index(out)
        done = _Work(tasks, on_progress, on_failure)
        with _journal(out) as journal, StopSignals("stopping: finished clips are kept") as stop:
            done.carry_out(workers[: len(tasks)], stop, journal)
        if stop.is_requested and scheduler is None:
            done.discard_unfinished()
        present = {row.clip for row in done.rows}
        # A clip of a former batch that was not named now keeps its row, as long as it has a result.
        others = [row for row in former if row.clip not in present and (out / row.clip / MANIFEST_NAME).exists()]
        rows = sorted([*done.rows, *others], key=lambda row: row.clip.casefold())
        write_rows(out, rows)
        write_index(out, rows)
    progress = done.progress
    return Batch(out, done.rows, progress.n_kept, progress.n_frames, progress.time_s, stop.is_requested)


def _tasks(clips: Sequence[BatchClip], out: Path, for_all: Layer, config: Path | None) -> list[BatchTask]:
    for clip in clips:
        if clip.name in RESERVED_NAMES:
            raise UsageError(f"{clip.place}: no clip can be called {clip.name!r}: give it another name")
    configurations = configure_each(for_all, (clip.layer for clip in clips), config)
    return [
        BatchTask(clip.name, clip.input, out.absolute() / clip.name, configuration)
        for clip, configuration in zip(clips, configurations, strict=True)
    ]


@contextlib.contextmanager
def _workers(jobs: int | None, scheduler: str | None) -> Iterator[Sequence[Worker]]:
    """Processes that keep to their share of the cores, or workers of a cluster."""
    if scheduler is None:
        n = 1 if jobs is None else jobs
        has_cores = usable_cores() >= CORES_OF_ANALYSIS * n
        yield [LocalWorker(may_have_children=has_cores) for _ in range(n)]
        return
    from ttcvid.jobs.processes.cluster import Cluster

    with Cluster(scheduler) as cluster:
        yield cluster.workers(jobs)


class _Work:
    """The clips of a batch on their way to rows."""

    def __init__(
        self, tasks: Sequence[BatchTask], on_progress: OnProgress | None, on_failure: OnFailure | None
    ) -> None:
        self._tasks = tasks
        self._on_progress = on_progress
        self._on_failure = on_failure
        self._rows = {task.clip: ClipRow(task.clip, printable(task.input), PENDING) for task in tasks}
        self.progress = Progress(len(tasks))

    @property
    def rows(self) -> tuple[ClipRow, ...]:
        """A row a clip, in the order of the clips."""
        return tuple(self._rows.values())

    def carry_out(self, workers: Sequence[Worker], stop: StopSignals, journal: TextIO) -> None:
        """Analyse all clips, until the last one is done or a stop is requested."""
        with Crew(workers, self._analyzed, N_TRIES) as crew:
            for attempt in crew.attempts(self._tasks):
                if attempt is not None:
                    self._note(attempt, journal)
                if self._on_progress is not None:
                    self._on_progress(self.progress)
                if stop.is_requested:
                    break

    def _analyzed(self, call: Call, task: BatchTask) -> BatchResult:
        def count(n_frames: int) -> None:
            self.progress.frames_under_way[task.clip] = n_frames

        try:
            return call(analyze_clip, task, on_news=count)
        finally:
            self.progress.frames_under_way.pop(task.clip, None)

    def _note(self, attempt: Attempt[BatchTask, BatchResult], journal: TextIO) -> None:
        clip, result = attempt.item.clip, attempt.value
        reason = _reason(attempt.error)
        if result is not None:
            self._rows[clip] = result.row
            self.progress.n_kept += result.is_kept
            self.progress.frames_of_done += 0 if result.is_kept else result.row.n_frames or 0
        else:
            if attempt.is_last:
                self._rows[clip] = ClipRow(clip, printable(attempt.item.input), FAILED, reason)
            if self._on_failure is not None:
                self._on_failure(clip, reason, not attempt.is_last)
        self.progress.n_failed += attempt.is_last and result is None
        self.progress.n_done += attempt.is_last
        outcome = FAILED if result is None else "kept" if result.is_kept else result.row.state
        line = {
            "clip": clip,
            "outcome": outcome,
            "try": attempt.number,
            "worker": attempt.worker,
            "time_s": round(attempt.time_s, 3),
            "reason": reason,
        }
        with output_errors(Path(journal.name)):
            journal.write(json.dumps(line) + "\n")
            journal.flush()

    def discard_unfinished(self) -> None:
        """Clear away what the workers had begun; where that fails, the next run does it."""
        for task in self._tasks:
            if self._rows[task.clip].state == PENDING and task.folder.is_dir():
                with contextlib.suppress(TtcvidError):
                    OutputFolder.create(task.folder, overwrite=True).abandon()
                with contextlib.suppress(OSError):
                    task.folder.rmdir()  # only if nothing is in it


def _reason(error: Exception | None) -> str:
    if error is None or isinstance(error, TtcvidError):
        return " ".join(str(error or "").split())
    return f"{type(error).__name__}: {' '.join(str(error).split())}: an error in ttcvid itself, please report it"


@contextlib.contextmanager
def _lock(out: Path) -> Iterator[None]:
    """Keep a second batch out of the folder; the system gives the lock back when this process ends, however it ends."""
    lock = FileLock(out / LOCK_NAME)
    with output_errors(out):
        try:
            lock.acquire(blocking=False)
        except Timeout:
            raise OutputError(f"{out}: another batch is writing there: wait for it, or choose another folder") from None
    try:
        yield
    finally:
        lock.release()


@contextlib.contextmanager
def _journal(out: Path) -> Iterator[TextIO]:
    """A file that gets a line for every try, for people who look into what happened when."""
    path = out / JOURNAL_NAME
    with output_errors(path):
        stream = path.open("a", encoding="utf-8")
    with stream:
        yield stream
