"""What is set for the whole process, so that threads side by side do not fight for cores."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import cv2

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
