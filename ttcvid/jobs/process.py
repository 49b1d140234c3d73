"""What is set for the whole process, so that threads side by side neither fight for cores nor for pages of memory."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

import cv2

# Parameters of glibc's mallopt, from malloc.h, and bytes up to which freed memory is kept.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BYTES, _LARGEST_KEPT_BLOCK_BYTES = 128 << 20, 32 << 20


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


def keep_freed_memory() -> None:
    """Let the allocator keep the buffers of one picture for the next, instead of handing them back to the system.

    AKAZE takes and frees some 20 MB a picture. To get them as fresh, cleared pages each time costs 7 ms of 85 ms a
    frame, and more where two threads ask at once. Only glibc has this setting; elsewhere nothing is done.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        libc.mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        libc.mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT_BLOCK_BYTES)
