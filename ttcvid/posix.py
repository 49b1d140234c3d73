"""What not every system has: all of it stands here, each with what is done where it is absent.

What works everywhere through a library is not here: locks of files (filelock), processes and their memory (psutil).
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from pathlib import Path

NEVER_WAIT = getattr(os, "O_NONBLOCK", 0)
"""Flag of `os.open`: to open a pipe without a writer does not wait. Windows has no pipes among its files."""
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""Flag of `os.open`: a link is an error. On Windows, where links take special rights, they are followed."""
BINARY = getattr(os, "O_BINARY", 0)
"""Flag of `os.open`: ends of lines stay as they are. Only Windows changes them."""


def can_copy_process() -> bool:
    """Whether this process may have a copy (a fork); elsewhere a thread does its work.

    Windows has none, on macOS the system's libraries do not bear it, and a daemon may have none.
    """
    return sys.platform == "linux" and not multiprocessing.current_process().daemon


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
