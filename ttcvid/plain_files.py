"""Plain files, and nothing else: what is a pipe, a device, a folder or far too large is refused before it is read.

To open a pipe that nobody writes to waits for ever, ``/dev/zero`` never ends, and a link may lead to a file of others.
Refusals are OSErrors, so that whoever reads says in its own words which file is meant and what was expected of it.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from ttcvid.posix import BINARY, NEVER_WAIT, NO_LINK

_LEAST_READ_BYTES = 65_536
NOT_PLAIN = "it is no plain file"


def open_plain(path: Path) -> BinaryIO:
    """Open a plain file, or a link to one, to be read; OSError for anything else."""
    return os.fdopen(_plain_descriptor(path, os.O_RDONLY), "rb")


def read_plain(path: Path, max_bytes: int) -> bytes:
    """The content of a plain file; OSError where it is none, or has more than ``max_bytes``."""
    with open_plain(path) as file:
        # Python takes all the memory that it is asked to read into, however short the file is.
        at_once = max(_LEAST_READ_BYTES, min(os.fstat(file.fileno()).st_size, max_bytes) + 1)
        content = b""
        while len(content) <= max_bytes and (more := file.read(at_once)):
            content += more
    if len(content) > max_bytes:
        raise OSError(errno.EFBIG, f"it has more than {max_bytes / 1e6:g} MB", str(path))
    return content


def open_own(path: Path) -> BinaryIO:
    """Open a file that ttcvid alone writes, to be read and changed; made where there is none.

    OSError where a link, another name of the same file, or no plain file stands there: it belongs to somebody else.
    """
    file = os.fdopen(_plain_descriptor(path, os.O_RDWR | os.O_CREAT | NO_LINK), "r+b")
    if os.fstat(file.fileno()).st_nlink > 1:
        file.close()
        raise OSError(errno.EMLINK, "it has another name elsewhere", str(path))
    return file


def make_anew(path: Path) -> BinaryIO:
    """Open a new file to be written; what had the name loses it, and stays as it is where it has another one.

    OSError where a folder has the name.
    """
    path.unlink(missing_ok=True)
    return path.open("xb")


def kind_of(path: Path) -> str:
    """What stands at a path itself, in a word: ``nothing``, ``file``, ``folder``, ``link`` or ``device`` (or pipe)."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return "nothing"
    kinds = {stat.S_IFREG: "file", stat.S_IFDIR: "folder", stat.S_IFLNK: "link"}
    return kinds.get(stat.S_IFMT(mode), "device")


def printable(text: str) -> str:
    r"""A text in which names of files may stand: what is not UTF-8 in them as escapes.

    >>> import os
    >>> printable(os.fsdecode(b"caf\xe9.mp4"))
    'caf\\xe9.mp4'
    """
    return os.fsencode(text).decode("utf-8", "backslashreplace")


def _plain_descriptor(path: Path, flags: int) -> int:
    descriptor = os.open(path, flags | NEVER_WAIT | BINARY, 0o666)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, NOT_PLAIN, str(path))
    return descriptor
