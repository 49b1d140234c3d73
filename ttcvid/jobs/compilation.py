"""What to know of the inner loops, which are compiled when they are first used and then kept on disk."""

from __future__ import annotations

from ttcvid.geometry.compiled import damaged_on_disk, has_place_on_disk, part_on_disk

# No run uses all of them: below this part, most are still to be compiled.
_LEAST_PART = 0.5


def compiles_once() -> bool:
    """Whether a run now would compile most of them, and the next one none."""
    return has_place_on_disk() and part_on_disk() < _LEAST_PART


def compilation_note() -> str:
    """Why the first frame will be long in coming; empty where it will not."""
    if not has_place_on_disk():
        return "compiling, which takes a minute"
    return "compiling, which takes a minute the first time" if compiles_once() else ""


def compilation_complaint() -> str | None:
    """Where nothing can be kept, every run compiles."""
    if has_place_on_disk():
        return None
    return (
        "no folder to keep compiled code in: every run takes a minute longer; "
        "set NUMBA_CACHE_DIR to a folder that may be written to"
    )


def damage_complaint() -> str | None:
    """Where copies of former runs are damaged, those are compiled anew."""
    damaged = damaged_on_disk()
    if not damaged:
        return None
    others = f" and {len(damaged) - 1} more beside it" if len(damaged) > 1 else ""
    return f"{damaged[0]}{others}: damaged compiled code, compiled anew when it is used: remove it if this stays"
