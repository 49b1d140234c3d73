"""What no former run has compiled is compiled ahead, by several processes, and told."""

import os
import subprocess
import sys

FEW_SOURCES = """
from pathlib import Path
import ttcvid
from ttcvid.jobs.processes import compilation
geometry = Path(ttcvid.__file__).parent / "geometry"
compilation._sources = lambda: [geometry / "medians.py", geometry / "camera" / "pinhole.py"]
compilation.usable_cores = lambda: {cores}
"""
COMPILE = """
told = []
print(compilation.compile_missing(lambda *progress: told.append(progress)), told[:1], sorted(told[1:])[-1:])
"""


LOAD = """
def n_loaded():
    compilation.load_compiled.cache_clear()
    compilation.load_compiled()
    return sum(bool(entry.function.signatures) for entry in compilation.entry_points())
print(n_loaded(), compilation.compile_missing(), n_loaded() == len(compilation.entry_points()) > 0)
"""


def compiled_in_new_process(folder, cores, script=COMPILE):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    command = [sys.executable, "-c", FEW_SOURCES.format(cores=cores) + script]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return run.stdout.strip()


def test_what_is_missing_is_compiled_once_by_several_processes(tmp_path):
    first = compiled_in_new_process(tmp_path, cores=2)
    n_total = first.split("(0, ")[1].split(")")[0]
    assert first == f"True [(0, {n_total})] [({n_total}, {n_total})]"
    assert len(list(tmp_path.rglob("medians.*.nbc"))) >= 2
    assert compiled_in_new_process(tmp_path, cores=2) == "False [] []"


def test_all_is_loaded_from_disk_and_nothing_before_it_is_there(tmp_path):
    assert compiled_in_new_process(tmp_path, cores=2, script=LOAD) == "0 True True"


def test_other_files_are_compiled_again_when_a_source_file_changes(tmp_path, monkeypatch):
    from ttcvid.jobs.processes import compilation

    source = tmp_path / "loops.py"
    source.write_text("@compiled")
    before = compilation._digest([source])
    assert compilation._digest([source]) == before
    source.write_text("@compiled\n")
    assert compilation._digest([source]) != before
