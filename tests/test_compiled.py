"""Compiled functions are kept on disk, and made anew when their file or what they use of others changes."""

import importlib
import inspect
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from copies_of_process import in_copy
from numba.core import caching
from numba.core.sigutils import normalize_signature

import ttcvid
from ttcvid.compiled import compiled, entry_points, has_place_on_disk
from ttcvid.jobs.processes.compilation import import_compiled

PACKAGE = Path(ttcvid.__file__).parent


@compiled
def _finite_sums(xy, path):
    count = 0
    for i in range(len(xy)):
        count += np.isfinite(xy[i, 0] + xy[i, 1] + path[i, 0] + path[i, 2])
    return count


def test_compiled_sums_that_hold_a_nan_are_not_finite():
    xy, path = np.ones((6, 2)), np.ones((6, 3))
    xy[2, 1], path[3, 0], path[4, 2] = np.nan, np.nan, np.inf
    assert _finite_sums(xy, path) == 3


MADE = """
import numpy as np
from ttcvid.compiled import compiled, compiled_for

@compiled
def doubled(x):
    return 2.0 * x

@compiled
def sums(x):
    return doubled(x) + 1.0

@compiled_for("(f8[:],)")
def total(values):
    return values.sum()

ONE = 1.0
"""
CALLER = """
from made import ONE, doubled
from ttcvid.compiled import compiled

@compiled
def other_sums(x):
    return doubled(x) + ONE
"""
BY_MODULE = """
import made
from ttcvid.compiled import compiled

@compiled
def sums_by_module(x):
    return made.doubled(x) + made.ONE
"""


@pytest.fixture
def called(tmp_path: Path) -> Callable[..., list[tuple[float, int]]]:
    """Values of functions of the module made here, and how many came from disk, in a copy of this process."""
    (tmp_path / "made.py").write_text(MADE)
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "by_module.py").write_text(BY_MODULE)
    return lambda *names, **options: in_copy(_called, tmp_path, names, options)


def _called(folder, names, options):
    # Texts that differ by one figure within a second are the same to Python's own compiled files.
    sys.dont_write_bytecode = True
    sys.path.insert(0, str(folder))
    if not options.get("has_place", True):
        # Numba asks each of these for a place; a folder that root may not write to is not to be had everywhere.
        caching.CacheImpl._locator_classes = []
    modules = [importlib.import_module(name) for name in ("made", "caller", "by_module")]
    assert has_place_on_disk() == options.get("has_place", True)
    if options.get("ahead"):
        for entry in entry_points():
            if entry.module == "made":
                entry.compile()
    functions = [next(vars(module)[name] for module in modules if name in vars(module)) for name in names]
    return [
        (function(ARGUMENTS[name]), function.stats.cache_hits.total())
        for name, function in zip(names, functions, strict=True)
    ]


ARGUMENTS = {"doubled": 3.0, "sums": 3.0, "other_sums": 3.0, "sums_by_module": 3.0, "total": np.arange(3.0)}


@pytest.mark.parametrize("ahead", [False, True])
def test_what_a_former_run_has_compiled_is_found_on_disk(called, ahead):
    assert called("total", ahead=ahead) == [(3.0, 0)]
    assert called("total") == [(3.0, 1)]


def test_without_a_place_on_disk_it_is_compiled_all_the_same(called):
    assert called("total", has_place=False) == [(3.0, 0)]


def test_an_entry_point_says_a_type_for_each_of_its_arguments():
    import_compiled()
    for entry in entry_points():
        types, _ = normalize_signature(entry.signature)
        assert len(types) == len(inspect.signature(entry.function.py_func).parameters), entry


ANALYSIS = """
import sys
from contextlib import nullcontext
import ttcvid
from ttcvid.compiled import entry_points
from ttcvid.jobs.analyze import run_analysis as job
from ttcvid.simulate import TrackOptions
# In this process, where the calls can be counted.
job.beside = lambda function, items, *_: nullcontext(function(items))
scene, out = sys.argv[1:]
ttcvid.simulate(scene, out + "/scene", tracks=TrackOptions(n_tracks=400), n_frames=10)
ttcvid.analyze(out + "/scene/tracks.parquet", out + "/run", camera=out + "/scene/camera.yaml", platform="vehicle",
    overlay=False, report=False)
used = [entry for entry in entry_points() if entry.function.signatures]
more = [entry.signature for entry in used if len(entry.function.signatures) > 1]
print(len(used) / len(entry_points()), *more, sep="\\n")
"""


@pytest.mark.slow
def test_an_analysis_calls_each_entry_point_with_the_types_that_it_says(tmp_path):
    scene = PACKAGE / "jobs" / "demo_scene.yaml"
    command = [sys.executable, "-c", ANALYSIS, str(scene), str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    used_part, *others = run.stdout.split("\n")
    assert float(used_part) > 0.5
    assert "".join(others) == ""


def test_a_function_that_calls_one_from_disk_can_be_compiled_and_found_there_itself(called):
    assert called("doubled") == [(6.0, 0)]
    assert called("doubled") == [(6.0, 1)]
    assert called("doubled", "sums") == [(6.0, 1), (7.0, 0)]
    assert called("doubled", "sums") == [(6.0, 1), (7.0, 1)]


@pytest.mark.parametrize("name", ["other_sums", "sums_by_module"])
def test_a_function_is_compiled_anew_when_what_it_uses_of_another_file_changes(called, tmp_path, name):
    assert called(name) == [(7.0, 0)]
    assert called(name) == [(7.0, 1)]
    for before, after, value in (("2.0 *", "3.0 *", 10.0), ("ONE = 1.0", "ONE = 2.0", 8.0)):
        (tmp_path / "made.py").write_text(MADE.replace(before, after))
        assert called(name) == [(value, 0)]
