"""A batch that is disturbed in every way that was thought of, beside one that nobody disturbs."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
from report import REPOSITORY, Bar, Report
from runs import TTCVID

from ttcvid.jobs.batch.run_batch import JOURNAL_NAME
from ttcvid.jobs.batch.table import ClipRow, read_rows
from ttcvid.sinks.folder import PARTIAL_NAME

if str(REPOSITORY / "tests") not in sys.path:
    sys.path.append(str(REPOSITORY / "tests"))
from moving_clips import approach, swaying, write_clip

NONE_BAR, STOP_BAR_S = Bar(0), Bar(4.0)
"""Two seconds are promised for a stop; machines that measure it have other things to do."""
DISK_BYTES = 64 * 1024
"""The full disk takes a few small files, and no result."""
GONE_WITHIN_S = 5.0
DEADLINE_S = 3600.0
OPTIONS = ("--jobs", "2", "--focal-px", "200", "--no-overlay", "--no-report")

BREAKS: tuple[Callable[[bytes], bytes], ...] = (
    lambda content: b"",
    lambda content: b"no video at all",
    lambda content: content[: len(content) // 2],
    lambda content: bytes(len(content)),
    lambda content: content[200:],
)
"""Ways to break an mp4 so that it cannot be opened."""


def stress(report: Report, folder: Path, n_clips: int) -> None:
    """Disturb a batch, and report what is left of it."""
    report.heading(f"Stress: {n_clips} clips")
    clips, out, reference = folder / "clips", folder / "out", folder / "undisturbed"
    bad = make_clips(clips, n_clips)
    full = min(path.stem for path in clips.iterdir() if path.stem not in bad)
    command = [str(TTCVID), "batch", str(clips), *OPTIONS, "-o", str(out)]
    report.command(["ttcvid", *command[1:]])
    started_s = time.monotonic()
    with full_disk(out / full) as is_full:
        report.say(f"{full} lies on a full disk" if is_full else "no full disk: this process may mount none")
        disturb(report, command, out, n_clips)
        last = subprocess.run(command, capture_output=True, text=True, check=False)
    report.say(f"exit code {last.returncode}: {last.stdout.strip()}")
    report_rows(report, out, bad | ({full} if is_full else set()))
    if is_full:
        last = subprocess.run(command, capture_output=True, text=True, check=False)
        report.say(f"with room on the disk: {last.stdout.strip()}")
        report_rows(report, out, bad)
    report.figure("time of all", time.monotonic() - started_s, "s")
    twice = [clip for clip, n in done_in(out).items() if n > 1]
    report.figure("clips analysed to their end twice", len(twice), "", NONE_BAR)
    subprocess.run([*command[:-1], str(reference)], capture_output=True, check=False)
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
        name, content = f"video{number:03d}", contents[number % len(contents)]
        if number % 10 == 3:
            content = BREAKS[number // 10 % len(BREAKS)](content)
            bad.add(name)
        (folder / f"{name}.mp4").write_bytes(content)
    return bad


@contextmanager
def full_disk(folder: Path) -> Iterator[bool]:
    """A disk too small for a result in the place of a folder; False where none can be mounted."""
    folder.mkdir(parents=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "none", str(folder)]
    try:
        is_full = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        is_full = False
    if not is_full:
        folder.rmdir()
    try:
        yield is_full
    finally:
        if is_full:
            subprocess.run(["umount", str(folder)], check=True)
            folder.rmdir()


def disturb(report: Report, command: list[str], out: Path, n_clips: int) -> None:
    """Kill two workers at their work, stop the batch, start it again, and kill it."""
    n_more = max(1, n_clips // 8)
    process = begun(command)
    for _ in range(2):
        wait_for_clips(out, n_more, process)
        kill_a_worker(process)
    report.say("two workers killed")
    wait_for_clips(out, 1, process)
    end(report, process, signal.SIGTERM)
    report.figure("unfinished results that it leaves", len(list(out.glob(f"*/{PARTIAL_NAME}"))), "", NONE_BAR)
    process = begun(command)
    wait_for_clips(out, n_more, process)
    end(report, process, signal.SIGKILL)


def begun(command: list[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def end(report: Report, process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    """End the batch by a signal, and report how long that takes and what is left of it."""
    children = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(number)
    stopped_s = time.monotonic()
    process.wait(DEADLINE_S)
    report.figure(f"{number.name} ends it within", time.monotonic() - stopped_s, "s", STOP_BAR_S)
    _, alive = psutil.wait_procs(children, timeout=GONE_WITHIN_S)
    report.figure(f"of its {len(children)} processes are left after 5 s", len(alive), "", NONE_BAR)


def kill_a_worker(leader: subprocess.Popen[bytes]) -> None:
    """Kill a process that the batch has begun for clips."""
    workers = [p for p in psutil.Process(leader.pid).children() if any("spawn_main" in word for word in p.cmdline())]
    workers[0].kill()


def wait_for_clips(out: Path, n_more: int, process: subprocess.Popen[bytes]) -> None:
    """Wait until so many more clips are done."""
    n = sum(done_in(out).values()) + n_more
    end_s = time.monotonic() + DEADLINE_S
    while sum(done_in(out).values()) < n:
        if process.poll() is not None or time.monotonic() > end_s:
            raise RuntimeError(f"the batch ended by itself, exit code {process.poll()}")
        time.sleep(0.02)


def done_in(out: Path) -> Counter[str]:
    """How often each clip was analysed to its end."""
    path = out / JOURNAL_NAME
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return Counter(line["clip"] for line in map(json.loads, lines) if line["outcome"] in ("complete", "truncated"))


def report_rows(report: Report, out: Path, expected_bad: set[str]) -> None:
    """Whether every good clip is complete, and every bad one named."""
    rows: dict[str, ClipRow] = {row.clip: row for row in read_rows(out)}
    good = [row for row in rows.values() if row.clip not in expected_bad]
    n_open = sum(row.state != "complete" for row in good)
    report.figure(f"of {len(good)} good clips are not complete", n_open, "", NONE_BAR)
    unnamed = [clip for clip in expected_bad if rows[clip].state != "failed" or not rows[clip].reason]
    report.figure(f"of {len(expected_bad)} bad clips are without their reason", len(unnamed), "", NONE_BAR)


def n_different(out: Path, reference: Path) -> int:
    """Tables of one folder that are not byte for byte those of the other."""
    names = {str(path.relative_to(top)) for top in (out, reference) for path in top.rglob("*.parquet")}
    return sum(_content(out / name) != _content(reference / name) for name in names)


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.exists() else None
