"""What not every system has stands in one module, and has a fallback there."""

import ast
import ctypes
import os
import subprocess
import sys
from pathlib import Path

import pytest

import ttcvid
from ttcvid import posix

PACKAGE = Path(ttcvid.__file__).parent
POSIX_MODULES = {"ctypes", "fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"}
POSIX_NAMES = {
    ("os", "fork"),
    ("os", "getpgid"),
    ("os", "killpg"),
    ("os", "mkfifo"),
    ("os", "name"),
    ("os", "O_NOFOLLOW"),
    ("os", "O_NONBLOCK"),
    ("os", "sched_getaffinity"),
    ("os", "setsid"),
    ("os", "uname"),
    ("signal", "SIGKILL"),
    ("sys", "platform"),
}
WORDS = POSIX_MODULES | {name for _, name in POSIX_NAMES} | {"/proc"}
"""A file without any of these needs no parsing."""


def posix_only(path: Path) -> set[str]:
    """What a file uses of modules and names that not every system has."""
    found, text = set[str](), path.read_text(encoding="utf-8")
    if not any(word in text for word in WORDS):
        return found
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & POSIX_MODULES
        elif isinstance(node, ast.ImportFrom) and node.module in POSIX_MODULES:
            found.add(node.module)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            found |= {f"{module}.{name}" for module, name in POSIX_NAMES & {(node.value.id, node.attr)}}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith("/proc"):
            found.add("/proc")
    return found


def test_no_other_module_asks_for_the_system() -> None:
    files = [path for path in PACKAGE.rglob("*.py") if path != Path(posix.__file__)]
    assert {path.name: posix_only(path) for path in files if posix_only(path)} == {}
    assert posix_only(Path(posix.__file__)) == {"ctypes", "signal.SIGKILL", "sys.platform"}


def test_on_windows_no_folder_is_opened_and_no_process_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FileNotFoundError):
        posix.sync_folder(tmp_path / "missing")
    monkeypatch.setattr("sys.platform", "win32")
    posix.sync_folder(tmp_path / "missing")
    posix.end_with_parent()
    assert not posix.can_copy_process()
    assert not posix.streams_are_files()


def test_where_the_system_does_not_tell_of_cores_all_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("os.sched_getaffinity", raising=False)
    assert posix.usable_cores() == os.cpu_count()


@pytest.mark.skipif(sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "mallopt"), reason="needs glibc")
def test_buffers_of_pictures_are_taken_again_without_fresh_pages() -> None:
    """In a process and a thread of their own: the setting stays, and threads have memory of their own."""
    script = """
import resource, threading
import numpy as np
from ttcvid.posix import share_freed_memory

def work():
    counts = []
    for _ in range(5):
        pictures = [np.ones((500, 1000), np.float32) for _ in range(20)]
        del pictures
        counts.append(resource.getrusage(resource.RUSAGE_THREAD).ru_minflt)
    print(counts[-1] - counts[1])

share_freed_memory()
thread = threading.Thread(target=work)
thread.start()
thread.join()
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    n_fresh_pages_of_three_rounds = int(run.stdout)
    assert n_fresh_pages_of_three_rounds < 1000  # of 29 000
