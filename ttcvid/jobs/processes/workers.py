"""A process that carries out calls, one after another, for the process that began it, and ends with it.

The two are joined by a pipe. A worker whose leader dies, however it dies, reads the end of the pipe and ends itself; a
leader whose worker dies reads the same and tells its caller. No signal, no identifier of a process and no feature of
one system is needed for either.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

from ttcvid.errors import TtcvidError
from ttcvid.jobs.processes.sent_errors import as_sendable
from ttcvid.jobs.processes.stopping import SIGNALS

R = TypeVar("R")
OnNews = Callable[[Any], None]

_NEWS, _RESULT, _FAILURE = "news", "result", "failure"
_END_WAIT_S = 2.0
"""A process ends within milliseconds; one that the system holds on to is not waited for any longer."""


class WorkerLostError(TtcvidError):
    """The process of a call was ended from outside, so nobody knows how the call would have ended."""


class Worker(Protocol):
    """Whoever carries out calls: a process of this machine, or of a cluster."""

    @property
    def name(self) -> str:
        """Who carried out the last call; empty before the first."""
        ...

    def call(self, function: Callable[..., R], *arguments: Any, on_news: OnNews | None = None, avoid: str = "") -> R:
        """What ``function`` returns or raises there.

        With ``on_news`` the function gets a keyword argument of that name: what it is called with arrives here. A
        worker called ``avoid`` does not do it, where there is another.
        """
        ...

    def close(self) -> None:
        """End the worker, and a call that is under way with `WorkerLostError`. May come from any thread."""
        ...


class LocalWorker:
    """A process of this machine, begun at the first call and again after it died.

    Parameters
    ----------
    is_fresh_each_call : Every call has a new process: what one leaves in memory is not measured in the next.
    may_have_children : Whether the calls may begin processes of their own, to use more than about one core.
    """

    def __init__(self, *, is_fresh_each_call: bool = False, may_have_children: bool = True) -> None:
        self.name = ""
        self._is_fresh_each_call = is_fresh_each_call
        self._may_have_children = may_have_children
        self._process: SpawnProcess | None = None
        self._connection: Connection | None = None
        self._is_closed = False
        self._lock = threading.Lock()

    def call(self, function: Callable[..., R], *arguments: Any, on_news: OnNews | None = None, avoid: str = "") -> R:
        """What ``function`` returns or raises in the process; the process called ``avoid`` is replaced by a new one."""
        if self._is_fresh_each_call or avoid == self.name:
            self._end()
        connection = self._begun()
        try:
            connection.send_bytes(pickle.dumps((function, arguments, on_news is not None)))
            kind, content = connection.recv()
            while kind == _NEWS:
                if on_news is not None:
                    on_news(content)
                kind, content = connection.recv()
        except (EOFError, ConnectionError):
            # All that the process has begun has let go of the pipe as well: nothing of it is left.
            raise WorkerLostError(_words(self._end())) from None
        if kind == _RESULT:
            return content  # type: ignore[no-any-return]  # what the function of type R returned
        if not isinstance(content, TtcvidError):
            self._end()  # whatever state an unforeseen error left there
        raise content

    def close(self) -> None:
        """Kill the process."""
        with self._lock:
            self._is_closed = True
            if self._process is not None:
                self._process.kill()

    def _begun(self) -> Connection:
        with self._lock:
            if self._is_closed:
                raise WorkerLostError("no new process: the work is being stopped")
            if self._connection is None:
                context = multiprocessing.get_context("spawn")
                self._connection, theirs = context.Pipe()
                self._process = context.Process(
                    target=_serve, args=(theirs,), name="ttcvid-worker", daemon=not self._may_have_children
                )
                self._process.start()
                # Closed here, so that the last word of a process that dies is the end of the pipe.
                theirs.close()
                self.name = f"process {self._process.pid}"
            return self._connection

    def _end(self) -> int | None:
        """End the process; its exit code, negative for a signal, None where there was no process."""
        with self._lock:
            process, connection = self._process, self._connection
            self._process = self._connection = None
        if process is None or connection is None:
            return None
        connection.close()  # at the end of the pipe it ends itself
        process.join(_END_WAIT_S)
        process.kill()
        process.join(_END_WAIT_S)
        return process.exitcode


def _words(exit_code: int | None) -> str:
    if exit_code is None or exit_code <= 0:
        return "the process of the analysis was ended from outside: is there enough memory?"
    return (
        f"the process of the analysis ended with exit code {exit_code}: a script of your own that calls ttcvid needs "
        'the line: if __name__ == "__main__":'
    )


def _serve(connection: Connection) -> None:
    """What the process does: its main thread watches the pipe, another one works."""
    # Ctrl-C goes to all processes of a terminal, and a job's end to all of the job; the leader says what becomes of it.
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    # What is to be known of a clip stands in its manifest; lines of several clips at once would be mixed up.
    logging.getLogger("ttcvid").addHandler(logging.NullHandler())
    calls: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_carry_out, args=(calls, connection), name="ttcvid-calls", daemon=True).start()
    while True:
        try:
            calls.put(connection.recv_bytes())
        except (EOFError, OSError):
            os._exit(0)


def _carry_out(calls: SimpleQueue[bytes], connection: Connection) -> None:
    def tell(content: Any) -> None:
        connection.send((_NEWS, content))

    while True:
        try:
            function, arguments, has_news = pickle.loads(calls.get())
            said = (_RESULT, function(*arguments, **({"on_news": tell} if has_news else {})))
            content = pickle.dumps(said)
        except BaseException as error:
            content = pickle.dumps((_FAILURE, as_sendable(error)))
        try:
            connection.send_bytes(content)
        except OSError:
            return  # the leader is gone, and the main thread knows
