"""Compiled functions are kept on disk, and made anew when their file or what they use of others changes."""

import inspect
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.sigutils import normalize_signature

import ttcvid
from ttcvid.geometry.compiled import compiled, entry_points
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


SCRIPT = """
import numpy as np
from ttcvid.geometry import compiled, medians
if {ahead}:
    for entry in compiled.entry_points():
        entry.compile()
print(compiled.has_place_on_disk(), medians.median(np.arange(5.0)), sum(medians._median.stats.cache_hits.values()))
"""


# Numba asks each of these for a place; a folder that root may not write to is not to be had everywhere.
WITHOUT_PLACE = "from numba.core import caching; caching.CacheImpl._locator_classes = []"


def printed_by_median(folder, before="", ahead=False):
    """Whether there is a place, a median, and how often its code came from disk, in a new process."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    run = subprocess.run(
        [sys.executable, "-c", before + SCRIPT.format(ahead=ahead)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return run.stdout.split()


@pytest.mark.parametrize("ahead", [False, True])
def test_what_a_former_run_has_compiled_is_found_on_disk(tmp_path, ahead):
    assert printed_by_median(tmp_path, ahead=ahead) == ["True", "2.0", "0"]
    assert printed_by_median(tmp_path) == ["True", "2.0", "1"]


def test_without_a_place_on_disk_it_is_compiled_all_the_same(tmp_path):
    assert printed_by_median(tmp_path, WITHOUT_PLACE) == ["False", "2.0", "0"]


def test_an_entry_point_says_a_type_for_each_of_its_arguments():
    import_compiled()
    for entry in entry_points():
        types, _ = normalize_signature(entry.signature)
        assert len(types) == len(inspect.signature(entry.function.py_func).parameters), entry


ANALYSIS = """
import sys
from contextlib import nullcontext
import ttcvid
from ttcvid.geometry.compiled import entry_points
from ttcvid.jobs.analyze import command as job
from ttcvid.simulate import TrackOptions
# In this process, where the calls can be counted.
job.beside = lambda function, items, *_: nullcontext(function(items))
scene, out = sys.argv[1:]
ttcvid.simulate(scene, out + "/scene", tracks=TrackOptions(n_tracks=150), n_frames=24)
ttcvid.analyze(out + "/scene/tracks.parquet", out + "/run", camera=out + "/scene/camera.yaml", platform="vehicle")
used = [entry for entry in entry_points() if entry.function.signatures]
print(len(used), *(entry.signature for entry in used if len(entry.function.signatures) > 1), sep="\\n")
"""


@pytest.mark.slow
def test_an_analysis_calls_each_entry_point_with_the_types_that_it_says(tmp_path):
    scene = PACKAGE / "jobs" / "demo_scene.yaml"
    command = [sys.executable, "-c", ANALYSIS, str(scene), str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    n_used, *others = run.stdout.split("\n")
    assert int(n_used) > 60
    assert "".join(others) == ""


CALLEE = """
import numpy as np
from ttcvid.geometry.compiled import compiled

@compiled
def doubled(x):
    return 2.0 * x

@compiled
def sums(x):
    return doubled(x) + 1.0
"""
CALLER = """
from callee import ONE, doubled
from ttcvid.geometry.compiled import compiled

@compiled
def other_sums(x):
    return doubled(x) + ONE
"""
USES_CALLEE = "from callee import doubled; print(doubled(3.0), doubled.stats.cache_hits.total())"
USES_BOTH = "from callee import doubled, sums; print(doubled(3.0), sums(3.0), sums.stats.cache_hits.total())"


def test_a_function_that_calls_one_from_disk_can_be_compiled_and_found_there_itself(tmp_path):
    (tmp_path / "callee.py").write_text(CALLEE)
    environment = {**os.environ, "PYTHONPATH": f"{PACKAGE.parent}:{tmp_path}"}

    def printed(code):
        command = [sys.executable, "-c", code]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()

    assert printed(USES_CALLEE) == ["6.0", "0"]
    assert printed(USES_CALLEE) == ["6.0", "1"]
    assert printed(USES_BOTH) == ["6.0", "7.0", "0"]
    assert printed(USES_BOTH) == ["6.0", "7.0", "1"]


@pytest.mark.parametrize(("before", "after", "value"), [("2.0 *", "3.0 *", "10.0"), ("ONE = 1.0", "ONE = 2.0", "8.0")])
def test_a_function_is_compiled_anew_when_what_it_uses_of_another_file_changes(tmp_path, before, after, value):
    callee = tmp_path / "callee.py"
    callee.write_text(CALLEE + "ONE = 1.0\n")
    (tmp_path / "caller.py").write_text(CALLER)
    environment = {**os.environ, "PYTHONPATH": f"{PACKAGE.parent}:{tmp_path}"}

    def printed():
        code = "from caller import other_sums; print(other_sums(3.0), other_sums.stats.cache_hits.total())"
        command = [sys.executable, "-c", code]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()

    assert printed() == ["7.0", "0"]
    assert printed() == ["7.0", "1"]
    callee.write_text(callee.read_text().replace(before, after))
    assert printed() == [value, "0"]
