"""What to know of the inner loops, which are compiled when they are first used and then kept on disk."""

from __future__ import annotations

from ttcvid.geometry.compiled import has_place_on_disk, part_on_disk

# No run uses all of them: below this part, most are still to be compiled.
_LEAST_PART = 0.5


def compilation_note() -> str:
    """Why the first frame will be long in coming; empty where it will not."""
    if not has_place_on_disk():
        return "compiling, which takes a minute"
    return "compiling, which takes a minute the first time" if part_on_disk() < _LEAST_PART else ""


def compilation_complaint() -> str | None:
    """Where nothing can be kept, every run compiles."""
    if has_place_on_disk():
        return None
    return (
        "no folder to keep compiled code in: every run takes a minute longer; "
        "set NUMBA_CACHE_DIR to a folder that may be written to"
    )
