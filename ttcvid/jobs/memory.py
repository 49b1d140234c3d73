"""Memory of this process and of those that it has started, at present and at its highest."""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import threading
from pathlib import Path
from types import TracebackType
from typing import Self

_MB = 1e6
_PROC = Path("/proc")
# Reading the memory of a process takes some milliseconds.
_SAMPLE_PERIOD_S = 0.2


class PeakMemory:
    """While entered, watches the memory: ``peak_mb`` is the highest so far, in 10^6 bytes.

    What several processes share counts once. Off Linux an analysis has one process alone, whose peak is known.
    """

    def __init__(self) -> None:
        self._sampled_mb = 0.0
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="ttcvid-memory", daemon=True)

    @property
    def peak_mb(self) -> float:
        """The highest so far."""
        return max(self._sampled_mb, _own_peak_mb())

    def __enter__(self) -> Self:
        if _PROC.is_dir():
            self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._is_over.set()
        if self._thread.is_alive():
            self._thread.join()

    def _watch(self) -> None:
        while not self._is_over.wait(_SAMPLE_PERIOD_S):
            self._sampled_mb = max(self._sampled_mb, resident_mb())


def resident_mb() -> float:
    """Resident memory now of this process and of those that it has started, in 10^6 bytes; Linux only.

    Each page counts by the part of it that is theirs: one that n processes share, be they ours or not, is 1 / n of a
    page in each. A kernel that does not tell this counts it whole in each.
    """
    processes = [os.getpid(), *(process.pid for process in multiprocessing.active_children())]
    return sum(_resident_kilobytes(_PROC / str(pid)) for pid in processes) * 1024 / _MB


def _resident_kilobytes(process: Path) -> int:
    return _kilobytes(process / "smaps_rollup", "Pss:") or _kilobytes(process / "status", "VmRSS:")


def _kilobytes(file: Path, field: str) -> int:
    """A field of a file of the kernel's, 0 once the process has ended, or where the kernel does not tell."""
    try:
        lines = file.read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith(field)), 0)


def _own_peak_mb() -> float:
    """Peak of this process alone.

    On Linux from the kernel's own count, because what ``getrusage`` says of a new process begins with its parent's.
    """
    if _PROC.is_dir():
        return _kilobytes(_PROC / "self" / "status", "VmHWM:") * 1024 / _MB
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / _MB if sys.platform == "darwin" else peak * 1024 / _MB
