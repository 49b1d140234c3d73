"""What attacks share: commands run to their end in processes, and what has to hold whatever happened to them."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import psutil

PROGRAM = Path(sys.executable).with_name("ttcvid")
DEADLINE_S = 180.0
"""No command on a clip of a second takes longer, even where it compiles on a busy machine."""
ORPHAN_S = 5.0
"""Helpers of a process that was killed may live on for so long."""


def run(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    """A command of ttcvid, its output as text; TimeoutExpired where it hangs."""
    given: dict[str, object] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    command = [PROGRAM, *map(os.fsencode, map(str, arguments))]
    return subprocess.run(command, text=True, errors="replace", timeout=DEADLINE_S, check=False, **given)  # type: ignore[call-overload,no-any-return]


def is_whole(folder: Path) -> bool:
    """Whether there is a manifest; if so, every file that it lists has to be there with its size, and be readable."""
    manifest = folder / "manifest.json"
    if not manifest.exists():
        return False
    content = json.loads(manifest.read_text())
    assert content["state"] in ("complete", "truncated", "interrupted")
    assert {name: (folder / name).stat().st_size for name in content["files"]} == content["files"]
    return True


def wait_until_gone(processes: list[psutil.Process]) -> None:
    """All have to end by themselves in time."""
    _, alive = psutil.wait_procs(processes, timeout=ORPHAN_S)
    for process in alive:
        process.kill()
    assert not alive


def contents(folder: Path) -> dict[str, bytes | None]:
    """Everything below a folder, with what files hold: to be the same before and after an attack."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() and not path.is_symlink() else None
        for path in sorted(folder.rglob("*"))
    }


def n_seconds_since(start_s: float) -> float:
    return time.monotonic() - start_s
