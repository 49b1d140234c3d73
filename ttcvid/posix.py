"""What not every system has: all of it stands here, each with what is done where it is absent.

What works everywhere through a library is not here: locks of files (filelock), processes and their memory (psutil).
The program's start needs this module: what takes time to import is imported inside functions.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

NEVER_WAIT = getattr(os, "O_NONBLOCK", 0)
"""Flag of `os.open`: to open a pipe without a writer does not wait. Windows has no pipes among its files."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""Flag of `os.open`: a link is an error. On Windows, where links take special rights, they are followed."""
BINARY = getattr(os, "O_BINARY", 0)
"""Flag of `os.open`: ends of lines stay as they are. Only Windows changes them."""

# Of Linux' prctl, from prctl.h: the signal that a process gets when its parent ends.
_PR_SET_PDEATHSIG = 1
# Parameters of glibc's mallopt, from malloc.h; bytes up to which freed memory is kept, and stocks (arenas) of it.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_LARGE_BLOCK_BYTES = 4 << 20
_KEPT_BYTES, _LARGEST_KEPT_BLOCK_BYTES, _MOST_STOCKS = 32 << 20, 32 << 20, 2


def can_copy_process() -> bool:
    """Whether this process may have a copy (a fork); elsewhere a thread does its work.

    Windows has none, on macOS the system's libraries do not bear it, and a daemon may have none.
    """
    if sys.platform != "linux":
        return False
    import multiprocessing

    return not multiprocessing.current_process().daemon


def end_with_parent() -> None:
    """Let the system end this process as soon as the thread that made it ends; elsewhere than on Linux nothing is done.

    Pipes tell that as well, but only who reads from them or writes to them.
    """
    if sys.platform != "linux":
        return
    import ctypes
    import signal

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))


def sync_folder(folder: Path) -> None:
    """Put the names in a folder onto the disk, so that what was renamed stays renamed after a crash.

    Windows opens no folders: there it is left to the system when that happens.
    """
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def usable_cores() -> int:
    """Cores that this process may use; where the system does not tell, all that there are."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def streams_are_files() -> bool:
    """Whether standard output and error can be written as files are; on Windows a console is none."""
    return sys.platform != "win32"


def give_back_large_blocks() -> None:
    """Give what a large picture took back to the system at once, instead of keeping it for another of the same size.

    Pictures of 4K in colour take blocks of 8 to 25 MB from several threads, and what is left between them cannot be
    used: with it an analysis takes 713 MB, without 590 (25 frames of 3840x2160, overlay). Only glibc has this setting;
    elsewhere nothing is done. Call before the threads begin.
    """
    if sys.platform != "linux":
        return
    import ctypes

    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        libc.mallopt(_M_MMAP_THRESHOLD, _LARGE_BLOCK_BYTES)


def share_freed_memory() -> None:
    """Let all threads take the memory that another picture has left, instead of fresh pages of the system.

    AKAZE takes and frees some 20 MB a picture. As fresh, cleared pages these cost 15 ms of 140 ms of processor time a
    frame (1242x375, 0.3 million of 0.4 million page faults in 60 frames). A search for corners takes 3 ms less of 8.
    Only glibc has these settings; elsewhere nothing is done. Call before the threads begin.
    """
    if sys.platform != "linux":
        return
    import ctypes

    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        libc.mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        libc.mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT_BLOCK_BYTES)
        libc.mallopt(_M_ARENA_MAX, _MOST_STOCKS)
