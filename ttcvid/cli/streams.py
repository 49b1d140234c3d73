"""Standard output and error of the program, such that a log or a reader that is gone does not cost a result."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import TYPE_CHECKING, Any, TextIO

from ttcvid.posix import streams_are_files

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


def guard_standard_streams() -> None:
    """Standard error may be lost (a full disk, a closed pipe), and standard output may have no reader any more.

    What is closed leads nowhere from now on: the next file opened would get its number, and take in what libraries
    print there. Output that cannot be written for another reason than a missing reader stays an error. On Windows,
    where a console is no file, the streams stay as they are.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(descriptor)
    if not streams_are_files():
        return
    sys.stdout = _guarded(sys.stdout, 1, BrokenPipeError, "surrogateescape")
    sys.stderr = _guarded(sys.stderr, 2, OSError, "backslashreplace")


class _GuardedFile(io.FileIO):
    """A file opened for writing that takes what fails in one of the ``forgiven`` ways for written."""

    def __init__(self, descriptor: int, forgiven: type[OSError]) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._forgiven = forgiven

    def write(self, content: ReadableBuffer, /) -> int:
        """Number of bytes written, or forgiven."""
        try:
            n_written = super().write(content)
            if n_written is None:
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        except self._forgiven:
            return memoryview(content).nbytes
        return n_written


def _guarded(stream: TextIO | None, descriptor: int, forgiven: type[OSError], errors: str) -> Any:
    """The stream opened again, with what becomes of a file's name that is no text: printed as it is, or as escapes."""
    if stream is None:
        return None
    file = io.BufferedWriter(_GuardedFile(descriptor, forgiven))
    return io.TextIOWrapper(file, stream.encoding, errors, line_buffering=descriptor == 2)
