"""Decoding, tracking and drawing side by side: threads joined by short queues.

OpenCV and PyAV release the interpreter lock, so threads suffice for them (for geometry they do not: `beside`). Order is
always kept, so results do not depend on timing. Queues are bounded, so memory does not depend on the length of a clip.
A failure in a thread is raised in the thread that uses it; leaving the ``with`` block ends the thread, whatever
happened.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from queue import Empty, Queue
from types import TracebackType
from typing import Generic, Self, TypeVar

T = TypeVar("T")
R = TypeVar("R")

READ_AHEAD_ITEMS = 3
WRITE_BEHIND_ITEMS = 3
WAITING_BYTES = 20_000_000
"""What may wait in each queue: three pictures of 2 million pixels with their colours, one of 5, none of 4K (8)."""
MAP_WORKERS = 2
MAP_AHEAD_ITEMS = 4
"""Items in work or waiting for their turn: two a worker, so that none idles while an item is taken."""
_DRAIN_WAIT_S = 0.02


def waiting_items(item_bytes: float, most: int) -> int:
    """How many items of this size may wait in a queue: ``most``, fewer of large ones, none of very large ones."""
    return int(min(most, WAITING_BYTES // item_bytes))


class _End:
    """Marks the end of a queue, with the failure that ended it, if one did."""

    def __init__(self, error: BaseException | None = None) -> None:
        self.error = error


class ReadAhead(Generic[T]):
    """Iterates over ``items`` in a thread of its own, some items ahead of whoever iterates over this.

    An exception that ``items`` raises is raised here after the items before it.
    """

    def __init__(self, items: Iterable[T], depth: int = READ_AHEAD_ITEMS) -> None:
        self._items = items
        self._queue: Queue[T | _End] = Queue(maxsize=depth)
        self._is_cancelled = threading.Event()
        self._thread = threading.Thread(target=self._read, name="ttcvid-read", daemon=True)

    def _read(self) -> None:
        try:
            for item in self._items:
                self._queue.put(item)
                if self._is_cancelled.is_set():
                    break
            if isinstance(self._items, Generator):
                # What it has begun ends here and now, not whenever nobody refers to it any more.
                self._items.close()
            self._queue.put(_End())
        except BaseException as error:
            self._queue.put(_End(error))

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __iter__(self) -> Iterator[T]:
        while not isinstance(item := self._queue.get(), _End):
            yield item
        if item.error is not None:
            raise item.error

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._is_cancelled.set()
        while self._thread.is_alive():
            # Makes room for a thread that waits to put an item.
            try:
                self._queue.get(timeout=_DRAIN_WAIT_S)
            except Empty:
                continue
        self._thread.join()


class WriteBehind(Generic[T]):
    """Calls ``write`` on each item that is ``put``, in order, in a thread of its own.

    A failure of ``write`` is raised by the next ``put``, or on leaving the ``with`` block, which waits until every
    item has been written. When the block is left by an exception, items still waiting are dropped.
    """

    def __init__(self, write: Callable[[T], None], depth: int = WRITE_BEHIND_ITEMS) -> None:
        self._write = write
        self._queue: Queue[T | _End] = Queue(maxsize=depth)
        self._is_dropping = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="ttcvid-write", daemon=True)

    def put(self, item: T) -> None:
        """Hand over an item; waits while the queue is full."""
        self._raise_failure()
        self._queue.put(item)

    def _work(self) -> None:
        # Goes on taking items after a failure, so that ``put`` never waits for ever.
        while not isinstance(item := self._queue.get(), _End):
            if self._is_dropping.is_set():
                continue
            try:
                self._write(item)
            except BaseException as error:
                self._error = error
                self._is_dropping.set()

    def _raise_failure(self) -> None:
        if self._error is not None:
            raise self._error

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if kind is not None:
            self._is_dropping.set()
        self._queue.put(_End())
        self._thread.join()
        if kind is None:
            self._raise_failure()


def map_ahead(
    function: Callable[[T], R], items: Iterable[T], workers: int = MAP_WORKERS, ahead: int = MAP_AHEAD_ITEMS
) -> Iterator[R]:
    """Results of ``function`` over ``items``, in order, worked out by ``workers`` threads up to ``ahead`` items early.

    ``items`` is iterated in the calling thread, and may fail there while results of earlier items are still awaited.
    """
    with ThreadPoolExecutor(workers, thread_name_prefix="ttcvid-map") as pool:
        pending: deque[Future[R]] = deque()
        try:
            for item in items:
                pending.append(pool.submit(function, item))
                if len(pending) >= ahead:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()
