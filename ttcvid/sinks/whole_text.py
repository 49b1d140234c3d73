"""A text file that is either whole or as it was before."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from ttcvid.plain_files import make_anew
from ttcvid.sinks.failures import output_errors


def write_whole(path: Path, text: str) -> None:
    """Write ``text``, so that a file of that name is never a part of it, nor lost where the disk is full.

    Who may read and write the file stays as it was. What is no file (a pipe), and what is open already
    (``/dev/stdout``), is written as it is. OutputError where it cannot be done.
    """
    with output_errors(path):
        mode = _mode_of(path)
        if mode is not None and (not stat.S_ISREG(mode) or path.is_relative_to("/dev")):
            path.write_text(text, encoding="utf-8")
            return
        if mode is not None and not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        target = path.resolve()  # a link stays one
        partial = target.with_name(f".{target.name}.partial")
        try:
            with make_anew(partial) as file:
                # what is not UTF-8 in the name of a file is written as an escape
                file.write(text.encode("utf-8", "backslashreplace"))
            if mode is not None:
                partial.chmod(stat.S_IMODE(mode))
            partial.replace(target)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise


def _mode_of(path: Path) -> int | None:
    """Kind and permissions of what stands there, or where links lead; None for nothing. OSError if they go round."""
    try:
        return path.stat().st_mode
    except FileNotFoundError:
        return None
