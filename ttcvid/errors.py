"""Known failures: each becomes one line on stderr and an exit code, never a traceback."""

from __future__ import annotations

import datetime
import reprlib
from typing import Any

_CONTROLS = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))}
_CONTROLS |= {ord("\n"): r"\n", ord("\r"): r"\r", ord("\t"): r"\t"}

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 100
_SHORT.maxlevel = 3


def quoted(value: Any) -> str:
    """A value as messages quote it: in short, and numpy's numbers, dates and nothing as a file has them.

    >>> quoted("a"), quoted(None), quoted(datetime.date(2026, 1, 2)), len(quoted("x" * 10_000))
    ("'a'", 'nothing', '2026-01-02', 100)
    """
    if value is None:
        return "nothing"
    if isinstance(value, datetime.date):
        return value.isoformat()
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:
        value = value.item()
    return _SHORT.repr(value)


def on_one_line(text: str) -> str:
    r"""A text in which names of files may stand: their ends of lines and orders to terminals as escapes.

    >>> print(on_one_line("two\nlines\x1b[2J.mp4"))
    two\nlines\x1b[2J.mp4
    """
    return text.translate(_CONTROLS)


def counted(n: int, thing: str) -> str:
    """A number of things, in words.

    >>> counted(1, "warning"), counted(0, "warning")
    ('1 warning', '0 warnings')
    """
    return f"{n} {thing}" + ("" if n == 1 else "s")


class TtcvidError(Exception):
    """Root of every failure that a user can mend.

    The message is one line that names file, field, value, what was expected and the remedy.
    """

    exit_code = 2


class UsageError(TtcvidError):
    """An option, argument, configuration value or output place cannot be used as given."""

    exit_code = 2


class OutputError(TtcvidError):
    """A result cannot be written: the place exists, is not writable, or the disk is full."""

    exit_code = 2


class InputError(TtcvidError):
    """The clip, image folder or track table cannot be read."""

    exit_code = 3


class CalibrationError(TtcvidError):
    """A camera, horizon or mask file cannot be read or does not fit the clip."""

    exit_code = 3


class UndeterminedError(TtcvidError):
    """What was asked for cannot be told from this input: too little in it, or nothing that fits."""

    exit_code = 5


class NotComparableError(TtcvidError):
    """A result or baseline cannot be compared: it is unreadable, not whole, or of another schema."""

    exit_code = 2
