"""A text file that is either whole or as it was before."""

from __future__ import annotations

from pathlib import Path

from ttcvid.sinks.failures import output_errors


def write_whole(path: Path, text: str) -> None:
    """Write ``text``, so that a file of that name is never a part of it, nor lost where the disk is full.

    What is no file (a pipe, ``/dev/stdout``) is written as it is. OutputError where it cannot be done.
    """
    with output_errors(path):
        if path.exists() and not path.is_file():
            path.write_text(text, encoding="utf-8")
            return
        target = path.resolve()  # a link stays one
        partial = target.with_name(f".{target.name}.partial")
        try:
            partial.write_text(text, encoding="utf-8")
            partial.replace(target)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
