"""Many clips at once: what two jobs gain over one, and what is left when clips, workers and disks fail.

python benchmarks/batch.py [--clips 6] [--frames 100] [--repeats 2] [--check]
python benchmarks/batch.py --stress [--clips 200] [--keep FOLDER] [--check]

Throughput: the same clip under several names is analysed with one job and with two, in turns; the best of the repeats
counts for each. Means something only on a machine that does nothing else: its load is printed.

Stress: generated clips, a tenth of them broken in five ways; two workers are killed while they work, the batch is
stopped by SIGTERM, started again, killed by SIGKILL and started again, and one clip's folder lies on a disk that is
full (a tmpfs; left out, and said so, where this process may mount none: try unshare -rm). At the end every good clip
has to be complete, every bad one named with its reason, no clip analysed to its end twice, and the tables have to be
those of a batch that nobody disturbed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from batch_stress import stress
from report import Bar, Report
from runs import TTCVID, data_folder

GAIN_BAR = Bar(1.25, at_least=True)
CLIP = "driving_clips/kitti_speed_300.mp4"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stress", action="store_true")
    parser.add_argument("--clips", type=int)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder for clips and results")
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    report = Report()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        if arguments.stress:
            stress(report, folder, arguments.clips or 200)
        else:
            throughput(report, folder, arguments.clips or 6, arguments.frames, arguments.repeats)
    return report.exit_code(arguments.check)


def throughput(report: Report, folder: Path, n_clips: int, n_frames: int, repeats: int) -> None:
    """Frames/s of one job and of two."""
    report.heading(f"Throughput: {n_clips} clips of {n_frames} frames, 1242x375, {os.cpu_count()} cores")
    clips = folder / "clips"
    clips.mkdir(parents=True)
    for number in range(n_clips):
        (clips / f"clip{number}.mp4").symlink_to(data_folder() / CLIP)
    options = ["--focal-px", "721", "--end", str(n_frames), "--json", "--jobs"]
    report.command(["ttcvid", "batch", "clips", "-o", "out", *options, "1|2"])
    rates: dict[int, float] = {}
    for turn in range(repeats):
        for jobs in (1, 2):
            command = [str(TTCVID), "batch", str(clips), "-o", str(folder / f"out{jobs}_{turn}"), *options, str(jobs)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            rates[jobs] = max(rates.get(jobs, 0.0), n_clips * n_frames / json.loads(done.stdout)["time_s"])
    report.say(f"load of the machine (1 minute): {os.getloadavg()[0]:.1f}")
    for jobs, rate in rates.items():
        report.figure(f"{jobs} at a time", rate, "frames/s")
    report.figure("two at a time over one", rates[2] / rates[1], "x", GAIN_BAR)


if __name__ == "__main__":
    sys.exit(main())
