"""Real clips without a collision: false warnings, and who is found of those that can be seen by eye.

python benchmarks/real.py [--jobs 2] [--out FOLDER] [--only NAME]
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from pathlib import Path

# One thread of linear algebra in each process: set before numpy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from real_clips.clips import CLIPS, ClipDone, ClipTask, do_clip
from real_clips.judging import report_clips
from report import REPOSITORY, Report
from runs import data_folder, until_stopped
from scenario_suite.running import run_all


def analyzed_clips(out: Path, n_jobs: int, only: str = "") -> Sequence[ClipDone]:
    """All clips whose name contains ``only``, analysed below ``out``, in their own order."""
    return done_in_order([ClipTask(clip, data_folder(), out) for clip in CLIPS if only in clip.name], n_jobs, do_clip)


def done_in_order(tasks: Sequence[ClipTask], n_jobs: int, work: Callable[[ClipTask], ClipDone]) -> Sequence[ClipDone]:
    """The tasks done side by side, each told as it is finished, in the order that they were given in."""
    done = {}
    for one in run_all(tasks, n_jobs, work):
        print(f"{one.task.clip.name} ({one.task.clip.setting})  {one.seconds:.0f} s  {one.error or ''}", flush=True)
        done[one.task.folder] = one
    return [done[task.folder] for task in tasks]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2, help="processes side by side")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "out" / "real", help="where the folders belong")
    parser.add_argument("--only", default="", help="clips whose name contains this")
    arguments = parser.parse_args()
    report_clips(Report(), analyzed_clips(arguments.out, arguments.jobs, arguments.only))


if __name__ == "__main__":
    until_stopped(main)
