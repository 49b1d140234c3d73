"""Memory of this process and of those that it has started, at present and at its highest."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Self

import psutil

_MB = 1e6
# Reading the memory of a process takes some milliseconds.
_SAMPLE_PERIOD_S = 0.2


class PeakMemory:
    """While entered, watches the memory: ``peak_mb`` is the highest of five readings a second, in 10^6 bytes."""

    def __init__(self) -> None:
        self._sampled_mb = 0.0
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="ttcvid-memory", daemon=True)

    @property
    def peak_mb(self) -> float:
        """The highest so far."""
        self._sample()
        return self._sampled_mb

    def __enter__(self) -> Self:
        self._sample()
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._is_over.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._is_over.wait(_SAMPLE_PERIOD_S):
            self._sample()

    def _sample(self) -> None:
        self._sampled_mb = max(self._sampled_mb, resident_mb())


def resident_mb() -> float:
    """Resident memory now of this process and of those that it has started, in 10^6 bytes.

    On Linux each page counts by the part of it that is theirs: one that n processes share, be they ours or not, is
    1 / n of a page in each. Other systems do not tell: there it counts whole in each.
    """
    this = psutil.Process()
    return sum(_resident_bytes(process) for process in [this, *this.children(recursive=True)]) / _MB


def _resident_bytes(process: psutil.Process) -> int:
    """0 once the process has ended, or where it became one of another user."""
    try:
        return int(process.memory_full_info().pss if psutil.LINUX else process.memory_info().rss)
    except (psutil.NoSuchProcess, psutil.AccessDenied):
        return 0
