"""Calls carried out on an existing Dask cluster, in the manner of `LocalWorker`.

The cluster's workers see the same files under the same paths, and have the same ttcvid installed. Dask is an extra:
nothing of it is imported before it is asked for.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any, Self, TypeVar

from ttcvid.errors import TtcvidError, UsageError
from ttcvid.jobs.processes.sent_errors import as_sendable
from ttcvid.jobs.processes.workers import OnNews, WorkerLostError

R = TypeVar("R")

CONNECT_WAIT_S = 5.0
CLOSE_WAIT_S = 1.0
AHEAD_FACTOR = 2
"""Clips handed out for each thread of the cluster: the next one is there when one is done."""
LEAST_AHEAD = 4
"""A cluster that grows with its work has no worker at first, and gets some for what waits."""


class Cluster:
    """The connection to a scheduler.

    Raises
    ------
    UsageError
        Dask is not installed, or no scheduler answers at ``address``.
    """

    def __init__(self, address: str) -> None:
        try:
            import distributed
        except ImportError:
            raise UsageError("--scheduler needs Dask: install it with: pip install 'ttcvid[dask]'") from None
        connected: Any = distributed.Client  # Dask has hardly any types
        # What it says of connections is said in our own words where it matters.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        try:
            self.client = connected(address, timeout=CONNECT_WAIT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise UsageError(
                f"--scheduler {address}: no Dask scheduler answers there ({reason}): start one with 'dask scheduler', "
                "and give the address that it prints"
            ) from None

    def workers(self, jobs: int | None) -> list[ClusterWorker]:
        """As many as clips are to be handed out at a time; None: by the size of the cluster."""
        n_threads = sum(self.client.nthreads().values())
        n = max(LEAST_AHEAD, AHEAD_FACTOR * n_threads) if jobs is None else jobs
        return [ClusterWorker(self) for _ in range(n)]

    def others(self, avoid: str) -> list[str] | None:
        """The workers but one; None where there is no other."""
        if not avoid:
            return None
        return [address for address in self.client.nthreads() if address != avoid] or None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        with suppress(TimeoutError):
            self.client.close(CLOSE_WAIT_S)


class ClusterWorker:
    """One call at a time, on whichever worker of the cluster is free."""

    def __init__(self, cluster: Cluster) -> None:
        self.name = ""
        self._cluster = cluster
        self._future: Any = None
        self._is_closed = False

    def call(self, function: Callable[..., R], *arguments: Any, on_news: OnNews | None = None, avoid: str = "") -> R:
        """What ``function`` returns or raises on the cluster; news do not come from there."""
        from distributed import CancelledError, KilledWorker

        try:
            others = self._cluster.others(avoid)
            if self._is_closed:
                raise WorkerLostError("not handed out: the work is being stopped")
            self._future = self._cluster.client.submit(carried_out, function, arguments, workers=others, pure=False)
            self.name, result, error = self._future.result()
        except (CancelledError, KilledWorker, OSError, ModuleNotFoundError) as lost:
            self.name = avoid or "a worker of the cluster"
            raise WorkerLostError(_words(lost)) from None
        if error is not None:
            raise error
        return result  # type: ignore[no-any-return]  # what the function of type R returned

    def close(self) -> None:
        """Take back what no worker has begun; what one has begun, it ends."""
        self._is_closed = True
        if self._future is not None:
            with suppress(Exception):  # of a connection that is gone: then there is nothing to take back
                self._future.cancel(force=True)


def _words(lost: BaseException) -> str:
    if isinstance(lost, ModuleNotFoundError):
        return f"the cluster's workers cannot do it ({lost}): install the same ttcvid on all of them"
    kind = type(lost).__name__
    return f"a worker of the cluster, or the connection to it, was lost ({kind}): is there enough memory?"


def carried_out(function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[str, Any, BaseException | None]:
    """On the cluster: the worker's address, and what the function returns or raises."""
    from distributed import get_worker

    logging.getLogger("ttcvid").addHandler(logging.NullHandler())
    address = str(get_worker().address)
    try:
        return address, function(*arguments), None
    except TtcvidError as error:
        return address, None, error
    except Exception as error:  # told to whoever asked, with its traceback
        return address, None, as_sendable(error)
