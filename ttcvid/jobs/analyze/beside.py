"""Part of an analysis in a process of its own: what computes in Python has an interpreter, and a core, for itself.

Threads share one interpreter, and geometry keeps it busy for as long as decoding, tracking, drawing and encoding take
together. The process is a copy of this one (a fork), so that it begins at once, with everything imported. Where
processes cannot be copied, a thread does the work, with the same results.
"""

from __future__ import annotations

import gc
import multiprocessing
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from enum import Enum
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from numba.core.compiler_lock import global_compiler_lock

from ttcvid.errors import TtcvidError
from ttcvid.jobs.processes.sent_errors import as_sendable
from ttcvid.jobs.processes.side_by_side import ReadAhead
from ttcvid.posix import can_copy_process, end_with_parent

T = TypeVar("T")
R = TypeVar("R")
Stream = Callable[[Iterable[T]], Iterator[R]]

# A copy made while it is held holds it itself, and may make copies of its own.
_FORKING = threading.RLock()
AHEAD_ITEMS = 2
"""Items that may be on their way to the other process: as few as keep it busy, since each has its picture waiting.
Where that process has one of its own, as many are on their way to that."""


@contextmanager
def beside(function: Stream[T, R], items: Iterable[T], ahead: int = AHEAD_ITEMS) -> Iterator[Iterable[R]]:
    """What ``function(items)`` yields, worked out beside the caller; the block ends whatever runs there.

    At most ``ahead`` items are made before they are wanted.
    """
    if can_copy_process():
        with OtherProcess(function, items, ahead) as results:
            yield results
    else:
        with ReadAhead(items, ahead) as made, ReadAhead(function(made)) as results:
            yield results


class _Says(Enum):
    """What comes from the other process: it has taken an item, made a result, come to the end, or failed."""

    taken = 1
    result = 2
    end = 3
    failure = 4


class OtherProcess(Generic[T, R]):
    """Iterates over ``function(items)``: the items are made here, in a thread, and the function runs in a process.

    Items and results are pickled; order is kept. An exception that ``items`` raises is raised here after the results of
    the items before it, one of ``function`` after the results before it. However this process ends, the other one ends
    with it; it may have one of its own.

    Raises
    ------
    TtcvidError
        The other process was ended from outside (out of memory).
    """

    def __init__(self, function: Stream[T, R], items: Iterable[T], ahead: int = AHEAD_ITEMS) -> None:
        self._items = items
        self._function = function
        self._thread = threading.Thread(target=self._send_items, name="ttcvid-send", daemon=True)
        self._has_room = threading.Semaphore(ahead)
        self._is_cancelled = False
        self._error: BaseException | None = None

    def __enter__(self) -> Self:
        context = multiprocessing.get_context("fork")
        # One at a time: another copy made in between would hold the far end of this pipe open. And not while a thread
        # compiles: the lock of the compiler would stay locked in the copy.
        with _FORKING, global_compiler_lock, warnings.catch_warnings():
            # Python 3.12 warns of other locks. The copy takes none but the interpreter's own, which are made again: it
            # has arrays in and arrays out, and logs nothing.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._connection, theirs = context.Pipe()
            self._process = context.Process(
                target=_serve, args=(self._function, theirs, self._connection), name="ttcvid-geometry"
            )
            self._process.start()
            # Its end is closed here, so that the last word of a process that dies is the end of the stream.
            theirs.close()
        try:
            self._thread.start()
        except BaseException:
            self._process.kill()
            self._process.join()
            raise
        return self

    def __iter__(self) -> Iterator[R]:
        while True:
            try:
                says, content = self._connection.recv()
            except (EOFError, ConnectionError):
                raise TtcvidError(
                    "the process of the geometry was ended from outside: is there enough memory?"
                ) from None
            if says == _Says.taken:
                self._has_room.release()
            elif says == _Says.result:
                yield content
            elif says == _Says.failure:
                raise content
            else:
                break
        self._end_sending()
        if self._error is not None:
            raise self._error

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        # Whatever it had to say has been said, or nobody wants it any more.
        self._process.kill()
        self._end_sending()
        self._process.join()
        self._connection.close()

    def _end_sending(self) -> None:
        self._is_cancelled = True
        self._has_room.release()
        self._thread.join()

    def _send_items(self) -> None:
        try:
            for item in self._items:
                self._has_room.acquire()
                if self._is_cancelled or not self._send(False, item):
                    return
        except BaseException as error:
            self._error = error
        self._send(True, None)

    def _send(self, is_end: bool, item: T | None) -> bool:
        """Whether the other process is there to take it; whoever iterates over the results is told if it is not."""
        try:
            self._connection.send((is_end, item))
        except ConnectionError:
            return False
        return True


class _AbandonedError(Exception):
    """The process that wants the results is gone."""


def _serve(function: Stream[Any, Any], connection: Connection, other_end: Connection) -> None:
    """What the other process does."""
    end_with_parent()
    other_end.close()
    # What is there stays: to look through it for garbage would write to pages that both processes share.
    gc.freeze()
    # Ctrl-C goes to all processes of a terminal, and a job's end to all of the job; the one that began says what
    # becomes of it, and ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    # Where part of the function runs beside it, a thread of that takes the items while this one sends results.
    sending = threading.Lock()

    def say(says: _Says, content: Any) -> None:
        with sending:
            connection.send((says, content))

    try:
        for result in function(_received(connection, say)):
            say(_Says.result, result)
        last: tuple[_Says, BaseException | None] = (_Says.end, None)
    except (_AbandonedError, ConnectionError):
        return
    except BaseException as error:
        last = (_Says.failure, as_sendable(error))
    with suppress(ConnectionError):  # nobody is there who wants to know
        say(*last)


def _received(connection: Connection, say: Callable[[_Says, Any], None]) -> Iterator[Any]:
    while True:
        try:
            is_end, item = connection.recv()
        except (EOFError, ConnectionError):
            raise _AbandonedError from None
        if is_end:
            return
        say(_Says.taken, None)
        yield item
