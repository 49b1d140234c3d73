"""Damaged copies of compiled code on disk are compiled anew, and never run."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from ttcvid.cli.main import main
from ttcvid.copies_on_disk import damaged_copies

TIMES_TWO = """
from ttcvid.compiled import compiled

@compiled
def scaled(x):
    return 2.0 * x
"""
TIMES_THREE = TIMES_TWO.replace("2.0", "3.0")


@pytest.fixture(autouse=True)
def compiled_beside_the_source(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    # Texts that differ by one figure within a second are the same to Python's own compiled files.
    monkeypatch.setattr("sys.dont_write_bytecode", True)


def imported(folder: Path, source: str) -> ModuleType:
    """The module anew, as another process has it: what was compiled before is known from the disk alone."""
    path = folder / "scaling.py"
    path.write_text(source)
    spec = importlib.util.spec_from_file_location("scaling", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def n_found_on_disk(module: ModuleType) -> int:
    return sum(module.scaled.stats.cache_hits.values())


def copies(folder: Path, ending: str) -> list[Path]:
    return sorted((folder / "__pycache__").glob(f"*{ending}"))


def empty(path: Path) -> None:
    path.write_bytes(b"")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def scramble(path: Path) -> None:
    path.write_bytes(np.random.default_rng(1).bytes(path.stat().st_size))


@pytest.mark.parametrize("damage", [empty, cut, flip, scramble])
@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
def test_a_damaged_copy_is_replaced(tmp_path: Path, ending: str, damage: Callable[[Path], None]) -> None:
    assert imported(tmp_path, TIMES_TWO).scaled(3.0) == 6.0
    (copy,) = copies(tmp_path, ending)
    damage(copy)
    assert damaged_copies(copy.parent) == [copy]
    module = imported(tmp_path, TIMES_TWO)
    assert module.scaled(3.0) == 6.0
    assert n_found_on_disk(module) == 0
    assert damaged_copies(copy.parent) == []
    module = imported(tmp_path, TIMES_TWO)
    assert module.scaled(3.0) == 6.0
    assert n_found_on_disk(module) == 1


def test_what_cannot_be_replaced_does_not_end_the_run(tmp_path: Path) -> None:
    imported(tmp_path, TIMES_TWO).scaled(3.0)
    (copy,) = copies(tmp_path, ".nbi")
    copy.unlink()
    copy.mkdir()
    assert imported(tmp_path, TIMES_TWO).scaled(3.0) == 6.0
    assert damaged_copies(copy.parent) == [copy]


def test_code_of_a_former_source_is_not_run_where_the_index_was_written_and_the_code_not(tmp_path: Path) -> None:
    """A run that is killed between the two leaves the new index with the old code."""
    imported(tmp_path, TIMES_TWO).scaled(3.0)
    (code,) = copies(tmp_path, ".nbc")
    former = code.read_bytes()
    imported(tmp_path, TIMES_THREE).scaled(3.0)
    assert copies(tmp_path, ".nbc") == [code]
    code.write_bytes(former)
    assert imported(tmp_path, TIMES_THREE).scaled(3.0) == 9.0


def test_doctor_names_a_damaged_copy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = tmp_path / "median-1.py311-checked.nbi"
    damaged.write_bytes(b"")
    monkeypatch.setattr("ttcvid.compiled._folders", lambda: [tmp_path])
    assert main(["doctor"]) == 1
    assert str(damaged) in capsys.readouterr().out
