"""Failures of disk and folder as one-line errors that say what to do."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ttcvid.errors import OutputError

_REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space or choose another place with -o",
    errno.EDQUOT: "the disk quota is used up: free some space or choose another place with -o",
    errno.EFBIG: "the file is larger than allowed here: choose another place with -o or analyse less of the clip",
    errno.EACCES: "permission denied: choose another place with -o or change the folder's permissions",
    errno.EPERM: "operation not permitted: choose another place with -o or change the folder's permissions",
    errno.EROFS: "the file system is read-only: choose another place with -o",
    errno.EEXIST: "a part of the path is a file, not a folder: choose another place with -o",
    errno.ENOTDIR: "a part of the path is a file, not a folder: choose another place with -o",
    errno.ENAMETOOLONG: "the name is too long: choose a shorter one with -o",
    errno.ENOENT: "its folder does not exist (any more): make it, or choose another place",
}


@contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Turn an `OSError` (PyAV's and pyarrow's included) raised while ``path`` is written into an `OutputError`."""
    try:
        yield
    except OSError as error:
        code = error.errno if error.errno is not None else 0
        reason = _REMEDIES.get(code) or " ".join(str(error).split()) or type(error).__name__
        raise OutputError(f"{path}: cannot be written, {reason}") from error
