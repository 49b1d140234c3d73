"""Memory of this process and of those that it has started."""

import mmap
import multiprocessing
import time
from collections.abc import Callable
from multiprocessing.synchronize import Event

import numpy as np
import psutil
import pytest

from ttcvid.jobs.processes.memory import PeakMemory, resident_mb

pytestmark = pytest.mark.skipif(not psutil.LINUX, reason="shared pages count in parts on Linux alone")
BLOCK_MB = 100


def block() -> np.ndarray:
    """New pages of the system: an allocator may keep some that earlier tests have touched."""
    taken = np.frombuffer(mmap.mmap(-1, BLOCK_MB * 1_000_000), dtype=np.uint8)
    taken[:] = 1
    return taken


def hold(is_there: Event, may_end: Event) -> None:
    taken = block()
    is_there.set()
    may_end.wait()
    del taken


def test_memory_of_a_process_that_was_started_counts() -> None:
    context = multiprocessing.get_context("fork")
    is_there, may_end = context.Event(), context.Event()
    before_mb = resident_mb()
    process = context.Process(target=hold, args=(is_there, may_end))
    process.start()
    is_there.wait()
    grown_mb = resident_mb() - before_mb
    may_end.set()
    process.join()
    # What both share counts once: not another whole interpreter. What is shared with other programs counts in parts,
    # and these come and go.
    assert 0.9 * BLOCK_MB < grown_mb < BLOCK_MB + 0.7 * before_mb


def wait_until(is_so: Callable[[], bool]) -> None:
    """At most 20 s: on a busy machine the thread that watches comes late."""
    for _ in range(400):
        if is_so():
            return
        time.sleep(0.05)


def test_the_peak_stays_when_the_memory_is_free_again() -> None:
    with PeakMemory() as memory:
        before_mb = resident_mb()
        taken = block()
        wait_until(lambda: memory._sampled_mb > before_mb + 0.9 * BLOCK_MB)
        del taken
        assert resident_mb() < before_mb + BLOCK_MB / 2
        assert memory.peak_mb > before_mb + 0.9 * BLOCK_MB
