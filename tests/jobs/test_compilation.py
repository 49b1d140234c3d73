"""What no former run has compiled is compiled ahead, by several processes, and told."""

import sys
from pathlib import Path

import pytest
from copies_of_process import in_copy

from ttcvid import compiled
from ttcvid.jobs.processes import compilation

MADE = """
from ttcvid.compiled import compiled_for

@compiled_for("(f8,)")
def one(x):
    return {factor} * x

@compiled_for("(f8,)")
def other(x):
    return {factor} + x
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of two modules with compiled functions."""
    folder = tmp_path / "made"
    folder.mkdir()
    for name, factor in (("first", 1.0), ("second", 2.0)):
        (folder / f"{name}.py").write_text(MADE.format(factor=factor))
    return folder


def _of_package(package: Path, function):
    """What a function says where the compiled functions are those of a package."""
    sys.path.insert(0, str(package.parent))
    compilation._PACKAGE = package
    compiled._ENTRY_POINTS.clear()
    compilation.usable_cores = lambda: 2
    return function()


def _compile():
    told = []
    return compilation.compile_missing(lambda *progress: told.append(progress)), told[:1], sorted(told[1:])[-1:]


def _load():
    compilation.load_compiled()
    return sum(bool(entry.function.signatures) for entry in compiled.entry_points())


def test_what_is_missing_is_compiled_once_by_several_processes(package):
    assert in_copy(_of_package, package, _compile) == (True, [(0, 4)], [(4, 4)])
    assert len(list(package.rglob("*.nbc"))) == 4
    assert in_copy(_of_package, package, _compile) == (False, [], [])


def test_all_is_loaded_from_disk_and_nothing_before_all_is_there(package):
    assert in_copy(_of_package, package, _load) == 0
    in_copy(_of_package, package, _compile)
    assert in_copy(_of_package, package, _load) == 4


def test_other_files_are_compiled_again_when_a_source_file_changes(tmp_path, monkeypatch):
    source = tmp_path / "loops.py"
    source.write_text("@compiled")
    before = compilation._digest([source])
    assert compilation._digest([source]) == before
    source.write_text("@compiled\n")
    assert compilation._digest([source]) != before
