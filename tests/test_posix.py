"""What not every system has stands in one module, and has a fallback there."""

import ast
import os
from pathlib import Path

import pytest

import ttcvid
from ttcvid import posix

PACKAGE = Path(ttcvid.__file__).parent
POSIX_MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"}
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


def posix_only(path: Path) -> set[str]:
    """What a file uses of modules and names that not every system has."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
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
    assert posix_only(Path(posix.__file__)) == {"sys.platform"}


def test_on_windows_no_folder_is_opened_and_no_process_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FileNotFoundError):
        posix.sync_folder(tmp_path / "missing")
    monkeypatch.setattr("sys.platform", "win32")
    posix.sync_folder(tmp_path / "missing")
    assert not posix.can_copy_process()
    assert not posix.streams_are_files()


def test_where_the_system_does_not_tell_of_cores_all_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("os.sched_getaffinity", raising=False)
    assert posix.usable_cores() == os.cpu_count()
