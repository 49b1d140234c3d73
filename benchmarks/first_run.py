"""What a first run costs: `ttcvid analyze` of the demo's clip without compiled code on disk, and again with it.

python benchmarks/first_run.py [--slowest 10]

Prints wall-clock and processor seconds of both, how many functions were compiled, and, with --slowest, those that take
longest by themselves (compiled anew, one after the other: a minute more). Wall-clock seconds are those of this machine
as busy as it is; processor seconds hold for two idle cores at half of them.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from report import REPOSITORY, Bar, Report
from runs import TTCVID

FIRST_RUN_BAR_S = 30.0
"""Of DESIGN, section 7: a first run takes at most so much longer than the second, on two idle cores."""
_EACH = """
import sys, time
sys.path.insert(0, "benchmarks")
from ttcvid.compiled import entry_points
from ttcvid.jobs.processes.compilation import import_compiled
import_compiled()
for entry in entry_points():
    start_s = time.process_time()
    entry.compile()
    print(f"{time.process_time() - start_s:.2f} {entry.module}.{entry.function.__name__}")
"""


@dataclass(frozen=True)
class Cost:
    """Wall-clock and processor seconds of a command and all processes that it began."""

    wall_s: float
    cpu_s: float


def main() -> None:
    """Simulate the clip, analyse it twice, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--slowest", type=int, default=0, metavar="N", help="also list the functions that take longest")
    arguments = parser.parse_args()
    report = Report()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = REPOSITORY / "ttcvid" / "jobs" / "demo_scene.yaml"
        measured([str(TTCVID), "simulate", str(scene), "-q", "-o", str(folder / "scene")], folder / "other_code")
        words = [str(TTCVID), "analyze", "scene/clip.mp4", "--platform", "vehicle", "--overwrite", "-o", "result"]
        code = folder / "code"
        first, second = (measured(words, code, folder) for _ in range(2))
        n_compiled = len(list(code.rglob("*.nbi")))
        wall_s, cpu_s = first.wall_s - second.wall_s, first.cpu_s - second.cpu_s
        print(f"first run {first.wall_s:.1f} s ({first.cpu_s:.1f} s of processors), second {second.wall_s:.1f} s")
        print(f"compiled functions on disk: {n_compiled}; more wall-clock time here: {wall_s:.1f} s")
        report.figure("first run longer than the second by, on two cores", cpu_s / 2.0, "s", Bar(FIRST_RUN_BAR_S))
        if arguments.slowest:
            for line in slowest(folder / "code_of_each", arguments.slowest):
                print(line)
    sys.exit(report.exit_code(check=True))


def measured(words: list[str], code: Path, folder: Path | None = None) -> Cost:
    """Run a command that has to succeed, with compiled code kept in ``code``."""
    before, start_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, cwd=folder, env=_environment(code), check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return Cost(time.perf_counter() - start_s, cpu_s)


def slowest(code: Path, n: int) -> list[str]:
    """Seconds and name of the entry points that take longest, what they call included unless another had it before."""
    words = [sys.executable, "-c", _EACH]
    done = subprocess.run(words, cwd=REPOSITORY, env=_environment(code), check=True, capture_output=True, text=True)
    return sorted(done.stdout.splitlines(), key=lambda line: -float(line.split()[0]))[:n]


def _environment(code: Path) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("TTCVID_")}
    return kept | {"NUMBA_CACHE_DIR": str(code)}


if __name__ == "__main__":
    main()
