"""What attacks share: commands run to their end, or killed on the way, and what has to hold whatever happened."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Self
from xml.etree import ElementTree

import pyarrow.parquet as pq
import yaml

PROGRAM = Path(sys.executable).with_name("ttcvid")
DEADLINE_S = 300.0
"""No command on a clip of a second takes longer, even where it compiles on a busy machine."""
ORPHAN_S = 5.0
"""Helpers of a process that was killed may live on for so long."""


# What Python says in a process whose parent is killed while it begins it: before any line of ours runs.
_ORPHAN_AT_BIRTH = re.compile(
    r"Traceback \(most recent call last\):\n  File \"<string>\", line 1, in <module>\n"
    r"(?:(?: +.*/multiprocessing/spawn\.py.*|    .*)\n)+EOFError: Ran out of input\n"
)


@dataclass(frozen=True)
class Outcome:
    """How a command ended: ``exit_code`` is -9 where it was killed; what it printed."""

    exit_code: int
    duration_s: float
    stdout: str
    stderr: str

    @property
    def errors(self) -> list[str]:
        """Lines of standard error that are neither warnings nor progress."""
        lines = self.stderr.splitlines()
        return [line for line in lines if not line.startswith("ttcvid: ") or line.startswith("ttcvid: error:")]


class Attacker:
    """Runs commands of ttcvid in copies of one process that has imported everything."""

    def __enter__(self) -> Self:
        self._folder = tempfile.TemporaryDirectory()
        server = Path(__file__).with_name("fork_server.py")
        self._server = subprocess.Popen(
            [sys.executable, str(server)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        return self

    def __exit__(self, *error: object) -> None:
        assert self._server.stdin is not None
        self._server.stdin.close()
        self._server.wait()
        assert self._server.stdout is not None
        self._server.stdout.close()
        self._folder.cleanup()

    def run(
        self,
        arguments: list[str],
        folder: Path,
        *,
        kill_after_s: float | None = None,
        largest_file_bytes: int | None = None,
    ) -> Outcome:
        """Run a command in a folder; it may not hang, leave a process behind, or print a traceback."""
        printed = [Path(self._folder.name) / name for name in ("stdout", "stderr")]
        task = {
            "arguments": arguments,
            "folder": str(folder),
            "kill_after_s": kill_after_s,
            "largest_file_bytes": largest_file_bytes,
            "deadline_s": DEADLINE_S,
            "orphan_s": ORPHAN_S,
            "stdout": str(printed[0]),
            "stderr": str(printed[1]),
        }
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.write(json.dumps(task) + "\n")
        self._server.stdin.flush()
        answer = json.loads(self._server.stdout.readline())
        stdout, stderr = (path.read_text(errors="backslashreplace") for path in printed)
        assert answer["exit_code"] is not None, f"{arguments} hangs: {stderr}"
        assert answer["n_orphans"] == 0, arguments
        ours = stderr if kill_after_s is None else _ORPHAN_AT_BIRTH.sub("", stderr)
        assert "Traceback" not in stdout + ours, f"{arguments}: {stderr}"
        assert "an error in ttcvid itself" not in stderr, f"{arguments}: {stderr}"
        return Outcome(answer["exit_code"], answer["duration_s"], stdout, stderr)


def is_whole(folder: Path) -> bool:
    """Whether there is a manifest; if so, every file that it lists has to be there with its size."""
    manifest = folder / "manifest.json"
    if not manifest.exists():
        return False
    content = json.loads(manifest.read_text())
    assert content["state"] in ("complete", "truncated", "interrupted")
    assert {name: (folder / name).stat().st_size for name in content["files"]} == content["files"]
    return True


def assert_sound(folder: Path) -> None:
    """No file with a name of its own is a part of one, and no manifest lies; what is hidden may be anything."""
    for path in folder.rglob("*"):
        if any(part.startswith(".") for part in path.relative_to(folder).parts) or not path.is_file():
            continue
        if path.name == "manifest.json":
            assert is_whole(path.parent)
        elif path.suffix == ".parquet":
            pq.read_table(path)
        elif path.suffix in (".yaml", ".json"):
            assert yaml.safe_load(path.read_text()) is not None, path
        elif path.suffix == ".xml":
            ElementTree.parse(path)
        elif path.suffix == ".html":
            assert path.read_text().rstrip().endswith("</html>"), path
        else:
            assert path.stat().st_size > 0, path


def contents(folder: Path) -> dict[str, bytes | None]:
    """Everything below a folder with what files hold, links not followed: the same before and after an attack."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() and not path.is_symlink() else None
        for path in sorted(folder.rglob("*"))
    }
