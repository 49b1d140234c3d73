"""Many clips at once: what two jobs gain over one, and what is left when clips, workers and disks fail.

python benchmarks/batch.py [--clips 6] [--frames 100] [--repeats 2] [--check]
python benchmarks/batch.py --stress [--clips 200] [--keep FOLDER] [--check]

Throughput: the same clip under several names is analysed with one job and with two, in turns; the best of the repeats
counts for each.

Stress: generated clips, a tenth of them broken in five ways; two workers are killed while they work, the batch itself
is stopped by SIGTERM and killed by SIGKILL and started again each time, and one clip's folder lies on a disk that is
full (a tmpfs; left out, and said so, where this process may mount none: try unshare -rm). At the end every good clip
has to be complete, every bad one named with its reason, and no clip analysed to its end twice; the tables have to be
those of a batch that nobody disturbed.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
from report import REPOSITORY, Bar, Report
from runs import TTCVID, data_folder

from ttcvid.jobs.batch import JOURNAL_NAME
from ttcvid.jobs.batch_table import ClipRow, read_rows

sys.path.insert(0, str(REPOSITORY / "tests"))
from moving_clips import approach, swaying, write_clip

GAIN_BAR = Bar(1.25, at_least=True)
NONE_BAR = Bar(0)
CLIP = "driving_clips/kitti_speed_300.mp4"
DISK_BYTES = 64 * 1024
"""The full disk takes a few small files, and no result."""
DEADLINE_S = 3600.0


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
    report.command(
        ["ttcvid", "batch", "clips", "-o", "out", "--focal-px", "721", "--end", str(n_frames), "--jobs", "1|2"]
    )
    rates: dict[int, float] = {}
    for turn in range(repeats):
        for jobs in (1, 2):
            out = folder / f"out{jobs}_{turn}"
            command = [
                TTCVID,
                "batch",
                clips,
                "-o",
                out,
                "--focal-px",
                721,
                "--end",
                n_frames,
                "--jobs",
                jobs,
                "--json",
            ]
            done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True)
            rates[jobs] = max(rates.get(jobs, 0.0), n_clips * n_frames / json.loads(done.stdout)["time_s"])
    report.say(f"load of the machine (1 minute): {os.getloadavg()[0]:.1f}")
    for jobs, rate in rates.items():
        report.figure(f"{jobs} at a time", rate, "frames/s")
    report.figure("two at a time over one", rates[2] / rates[1], "x", GAIN_BAR)


BREAKS: tuple[Callable[[bytes], bytes], ...] = (
    lambda content: b"",
    lambda content: b"no video at all",
    lambda content: content[: len(content) // 2],
    lambda content: bytes(len(content)),
    lambda content: content[200:],
)
"""Ways to break an mp4 so that it cannot be opened."""


def stress(report: Report, folder: Path, n_clips: int) -> None:
    """A disturbed batch, beside one that nobody disturbs."""
    report.heading(f"Stress: {n_clips} clips")
    clips = folder / "clips"
    bad = make_clips(clips, n_clips)
    out = folder / "out"
    command = [
        TTCVID,
        "batch",
        str(clips),
        "-o",
        str(out),
        "--jobs",
        "2",
        "--focal-px",
        "200",
        "--no-overlay",
        "--no-report",
    ]
    command += ["--image-size", "192x128"]
    report.command(["ttcvid", *command[1:]])
    full = next(name for name in sorted(names_of(clips)) if name not in bad and name.startswith("video"))
    with full_disk(out / full) as has_full_disk:
        report.say("one folder on a full disk" if has_full_disk else "no full disk: this process may mount none")
        started_s = time.monotonic()
        killed = disturbed(command, out, n_clips)
        first = subprocess.run(command, capture_output=True, text=True, check=False)
    report.say(f"disturbed: {killed}; then exit code {first.returncode}: {first.stdout.strip()}")
    rows = {row.clip: row for row in read_rows(out)}
    expected = bad | ({full} if has_full_disk else set())
    report_rows(report, rows, expected)
    if has_full_disk:
        report.say(f"of the full disk: {rows[full].reason}")
        last = subprocess.run(command, capture_output=True, text=True, check=False)
        report.say(f"with room on the disk: {last.stdout.strip()}")
        report_rows(report, {row.clip: row for row in read_rows(out)}, bad)
    report.figure("time of all", time.monotonic() - started_s, "s")
    twice = [clip for clip, n in done_in(out).items() if n > 1]
    report.figure("clips analysed to their end twice", len(twice), "", NONE_BAR)
    reference = folder / "undisturbed"
    undisturbed = [word if word != str(out) else str(reference) for word in command]
    subprocess.run(undisturbed, capture_output=True, text=True, check=False)
    report.figure("tables that differ from those of a batch in one go", n_different(out, reference), "", NONE_BAR)


def make_clips(folder: Path, n_clips: int) -> set[str]:
    """Videos, a tenth of them broken; returns the names of these."""
    folder.mkdir(parents=True)
    contents = [
        write_clip(folder.parent / f"content{k}.mp4", pictures(12 + 2 * k)).read_bytes()
        for k, pictures in enumerate((approach, swaying, approach))
    ]
    bad = set()
    for number in range(n_clips):
        name = f"video{number:03d}"
        content = contents[number % len(contents)]
        if number % 10 == 3:
            content = BREAKS[number // 10 % len(BREAKS)](content)
            bad.add(name)
        (folder / f"{name}.mp4").write_bytes(content)
    return bad


def names_of(folder: Path) -> set[str]:
    return {path.stem for path in folder.iterdir()}


@contextmanager
def full_disk(folder: Path) -> Iterator[bool]:
    """A small disk in the place of a folder, full from the beginning; False where none can be mounted."""
    folder.mkdir(parents=True)
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "none", str(folder)], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        folder.rmdir()
        yield False
        return
    try:
        yield True
    finally:
        subprocess.run(["umount", str(folder)], check=True)
        folder.rmdir()


def disturbed(command: list[str], out: Path, n_clips: int) -> str:
    """Run the batch three times and disturb each: two workers killed, SIGTERM, SIGKILL; says what was done."""
    said = []
    for what in (None, signal.SIGTERM, signal.SIGKILL):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        n_before = sum(done_in(out).values())
        wait_for(lambda: sum(done_in(out).values()), n_before + max(1, n_clips // 8), process)
        if what is None:
            for _ in range(2):
                kill_a_worker(process)
                wait_for(lambda: sum(done_in(out).values()), sum(done_in(out).values()) + 1, process)
            said.append("two workers killed")
        number = what or signal.SIGKILL
        children = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(number)
        stopped_s = time.monotonic()
        process.wait(DEADLINE_S)
        time_s = time.monotonic() - stopped_s
        _, alive = psutil.wait_procs(children, timeout=5.0)
        said.append(
            f"{number.name} ended it in {time_s:.1f} s, {len(alive)} of {len(children)} processes left after 5 s"
        )
    return ", ".join(said)


def kill_a_worker(leader: subprocess.Popen[bytes]) -> None:
    """Kill a process that the batch has begun for clips."""
    workers = [p for p in psutil.Process(leader.pid).children() if any("spawn_main" in word for word in p.cmdline())]
    workers[0].kill()


def wait_for(count: Callable[[], int], n: int, process: subprocess.Popen[bytes]) -> None:
    """Wait until so many are counted."""
    end_s = time.monotonic() + DEADLINE_S
    while count() < n:
        if process.poll() is not None or time.monotonic() > end_s:
            raise SystemExit(f"the batch ended by itself, exit code {process.poll()}")
        time.sleep(0.05)


def done_in(out: Path) -> Counter[str]:
    """How often each clip was analysed to its end."""
    path = out / JOURNAL_NAME
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return Counter(line["clip"] for line in map(json.loads, lines) if line["outcome"] in ("complete", "truncated"))


def report_rows(report: Report, rows: dict[str, ClipRow], expected_bad: set[str]) -> None:
    good = [row for row in rows.values() if row.clip not in expected_bad]
    failed = {row.clip for row in rows.values() if row.state == "failed"}
    report.figure("good clips", len(good))
    report.figure("good clips that are not complete", sum(row.state != "complete" for row in good), "", NONE_BAR)
    report.figure("bad clips", len(expected_bad))
    unnamed = [clip for clip in expected_bad if clip not in failed or not rows[clip].reason]
    report.figure("bad clips without their reason", len(unnamed), "", NONE_BAR)


def n_different(out: Path, reference: Path) -> int:
    """Tables of one folder that are not byte for byte those of the other."""
    names = {str(path.relative_to(top)) for top in (out, reference) for path in top.rglob("*.parquet")}
    return sum(_content(out / name) != _content(reference / name) for name in names)


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.exists() else None


if __name__ == "__main__":
    sys.exit(main())
