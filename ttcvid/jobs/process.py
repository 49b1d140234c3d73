"""What is set for the whole process, so that threads side by side neither fight for cores nor for pages of memory."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import cv2

# Parameters of glibc's mallopt, from malloc.h; bytes up to which freed memory is kept, and stocks (arenas) of it.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_KEPT_BYTES, _LARGEST_KEPT_BLOCK_BYTES, _MOST_STOCKS = 128 << 20, 32 << 20, 2

# Objects made before the youngest are looked through for garbage in circles.
_OBJECTS_PER_COLLECTION = 20_000

# How long a thread that computes in Python lets another one wait for the interpreter.
_LONGEST_WAIT_S = 0.0005


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """One OpenCV thread a call: decoding, tracking, geometry and drawing already run side by side on the cores.

    Features of AKAZE take 36 instead of 62 ms a frame when two frames run side by side with one thread each.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


@contextmanager
def rare_garbage_collections() -> Iterator[None]:
    """Look for garbage in circles less often: at Python's own pace it stops all threads for 0.5 ms a frame.

    An analysis leaves none to speak of: its arrays go when the last reference does.
    """
    before = gc.get_threshold()
    gc.set_threshold(_OBJECTS_PER_COLLECTION, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


@contextmanager
def quick_thread_switches() -> Iterator[None]:
    """Threads that come back from OpenCV, PyAV or compiled code get the interpreter within half a millisecond.

    At Python's own 5 ms each of the dozens of calls of a frame may wait longer for its turn than it took itself, with
    a core idle meanwhile: up to a third of the frames a second, for no processor time.
    """
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(_LONGEST_WAIT_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)


def share_freed_memory() -> None:
    """Let all threads take the memory that another picture has left, instead of fresh pages of the system.

    AKAZE takes and frees some 20 MB a picture; as fresh, cleared pages they cost 7 ms of 85 ms a frame. And each thread
    would keep a stock of its own, 20 MB that are never needed at once. Only glibc has these settings; elsewhere nothing
    is done. Call before the threads begin.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        libc.mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        libc.mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT_BLOCK_BYTES)
        libc.mallopt(_M_ARENA_MAX, _MOST_STOCKS)
