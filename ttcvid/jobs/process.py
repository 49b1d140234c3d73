"""What is set for the whole process, so that threads side by side neither fight for cores nor for pages of memory."""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Iterator
from contextlib import contextmanager

import cv2

# Parameters of glibc's mallopt, from malloc.h; bytes up to which freed memory is kept, and stocks (arenas) of it.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_KEPT_BYTES, _LARGEST_KEPT_BLOCK_BYTES, _MOST_STOCKS = 128 << 20, 32 << 20, 2

# Objects made before the youngest are looked through for garbage in circles.
_OBJECTS_PER_COLLECTION = 20_000


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
