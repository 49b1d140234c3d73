"""Many clips at once: threads that hand them to workers, a second try for what failed, and an end at any time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from queue import Empty, Queue
from types import TracebackType
from typing import Generic, Protocol, Self, TypeVar

from ttcvid.jobs.processes.workers import Worker

T = TypeVar("T")
R = TypeVar("R")

TICK_S = 0.2
"""So often whoever waits for results can look at the clock and at signals."""
END_WAIT_S = 1.5
"""So long is waited for killed workers to let go of their files."""


class Call(Protocol):
    """`Worker.call` of the worker that an item was given to."""

    def __call__(self, function: Callable[..., R], *arguments: object, on_news: Callable[..., None] | None = None) -> R:
        """What the function returns or raises there."""
        ...


@dataclass(frozen=True)
class Attempt(Generic[T, R]):
    """One try at an item: its ``value``, or the ``error``; ``number`` counts from 1.

    ``is_last`` is False where a failed item will be tried again.
    """

    item: T
    number: int
    worker: str
    time_s: float
    value: R | None
    error: Exception | None
    is_last: bool


@dataclass(frozen=True)
class _Task(Generic[T]):
    item: T
    number: int
    avoid: str


class Crew(Generic[T, R]):
    """Works through items on several workers at once.

    ``work(call, item)`` runs in a thread of this process, and hands what takes long to its worker by ``call``. An item
    whose work raises is tried again, up to ``n_tries`` times in all, after all others and by another worker. Leaving
    the ``with`` block ends the workers, whatever they are doing.
    """

    def __init__(self, workers: Sequence[Worker], work: Callable[[Call, T], R], n_tries: int = 1) -> None:
        self._workers = workers
        self._work = work
        self._n_tries = n_tries
        self._tasks: Queue[_Task[T] | None] = Queue()
        self._done: Queue[Attempt[T, R]] = Queue()
        self._is_over = False
        self._threads = [
            threading.Thread(target=self._hand_out, args=(worker,), name="ttcvid-crew", daemon=True)
            for worker in workers
        ]

    def attempts(self, items: Sequence[T]) -> Iterator[Attempt[T, R] | None]:
        """Every try, as it ends; None at least every `TICK_S` while there is nothing to tell."""
        for item in items:
            self._tasks.put(_Task(item, 1, ""))
        n_open = len(items)
        while n_open:
            try:
                attempt = self._done.get(timeout=TICK_S)
            except Empty:
                yield None
                continue
            if attempt.is_last:
                n_open -= 1
            else:
                self._tasks.put(_Task(attempt.item, attempt.number + 1, attempt.worker))
            yield attempt

    def _hand_out(self, worker: Worker) -> None:
        while (task := self._tasks.get()) is not None and not self._is_over:
            self._done.put(self._tried(worker, task))

    def _tried(self, worker: Worker, task: _Task[T]) -> Attempt[T, R]:
        started_s = time.monotonic()
        value: R | None = None
        failure: Exception | None = None
        try:
            value = self._work(partial(worker.call, avoid=task.avoid), task.item)
        except Exception as error:  # of whatever kind: it belongs to this item, and whoever asked for it judges it
            failure = error
        is_last = failure is None or task.number >= self._n_tries
        time_s = time.monotonic() - started_s
        return Attempt(task.item, task.number, worker.name, time_s, value, failure, is_last)

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._is_over = True
        for worker in self._workers:
            worker.close()
        for _thread in self._threads:
            self._tasks.put(None)
        end_s = time.monotonic() + END_WAIT_S
        for thread in self._threads:
            thread.join(max(0.0, end_s - time.monotonic()))
