"""Stopped by Ctrl-C, killed hard, or out of space: what is left tells what it is."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import av
import pytest
from copies_of_process import CommandInCopy
from moving_clips import approach, swaying, write_clip

from ttcvid.cli.main import main
from ttcvid.errors import InputError, TtcvidError
from ttcvid.jobs.analyze.beside import AHEAD_ITEMS
from ttcvid.jobs.runs.run import Run

N_LONG = 600
DEADLINE_S = 60.0


@pytest.fixture(scope="module")
def long_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    period = swaying(60)
    return write_clip(tmp_path_factory.mktemp("long") / "long.mp4", period * (N_LONG // 60), key_every=30)


def start(clip: Path, out: Path, **limits: int) -> CommandInCopy:
    options = ["-o", out, "--set=overlay.crf=0", "--set=overlay.preset=ultrafast"]
    return CommandInCopy(out.parent, "analyze", clip, *options, **limits)


def wait_until_it_writes(process: CommandInCopy, out: Path) -> None:
    """Until the overlay has its first bytes: frames have gone through by then."""
    overlay = out / ".ttcvid-partial" / "overlay.mp4"
    end_s = time.monotonic() + DEADLINE_S
    while not (overlay.exists() and overlay.stat().st_size > 0):
        assert process.is_running(), process.ended(0)
        assert time.monotonic() < end_s
        time.sleep(0.005)


def n_video_frames(path: Path) -> int:
    with av.open(str(path)) as container:
        return sum(1 for _ in container.decode(video=0))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_keeps_what_is_done(number: signal.Signals, long_clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = start(long_clip, out)
    wait_until_it_writes(process, out)
    process.send_signal(number)
    exit_code, stdout, stderr = process.ended(DEADLINE_S)
    assert exit_code == 130, stderr
    assert "interrupted" in stdout
    assert "Traceback" not in stderr
    run = Run.open(out)
    n = run.manifest["counts"]["frames"]
    assert run.state == "interrupted"
    assert 0 < n < N_LONG
    assert list(run.frames.frame) == list(range(n))
    assert n_video_frames(out / "overlay.mp4") == n


@pytest.mark.usefixtures("geometry_in_a_process")
def test_a_signal_between_two_frames_ends_after_the_present_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = write_clip(tmp_path / "clip.mp4", swaying(60))

    def stop_at_five(n_done: int, n_total: int | None) -> None:
        if n_done == 5:
            os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr("ttcvid.cli.progress.progress_on_stderr", lambda *_, **__: _Always(stop_at_five))
    assert main(["analyze", str(clip), "-o", str(tmp_path / "out")]) == 130
    # Motions and rows each have a frame, and some waiting.
    on_their_way = 2 * (1 + AHEAD_ITEMS)
    assert 5 <= Run.open(tmp_path / "out").manifest["counts"]["frames"] <= 5 + on_their_way
    assert signal.getsignal(signal.SIGINT) is before


class _Always:
    def __init__(self, value: object) -> None:
        self._value = value

    def __enter__(self) -> object:
        return self._value

    def __exit__(self, *error: object) -> None:
        pass


@pytest.mark.parametrize("delay_s", [0.0, pytest.param(0.2, marks=pytest.mark.exhaustive)])
def test_killed_hard_leaves_nothing_that_passes_for_a_result(delay_s: float, long_clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = start(long_clip, out)
    wait_until_it_writes(process, out)
    time.sleep(delay_s)
    process.send_signal(signal.SIGKILL)
    assert process.ended(DEADLINE_S)[0] == -signal.SIGKILL
    assert not list(out.glob("*.parquet"))
    with pytest.raises(InputError, match=r"no finished run"):
        Run.open(out)
    short = write_clip(tmp_path / "short.mp4", approach(3))
    assert main(["analyze", str(short), "-o", str(out), "-q"]) == 2
    assert main(["analyze", str(short), "-o", str(out), "-q", "--overwrite"]) == 0
    assert sorted(path.name for path in out.iterdir()) == sorted([*Run.open(out).manifest["files"], "manifest.json"])


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    """Stands for a full disk: no file may grow over 10 kB."""
    out = tmp_path / "out"
    process = start(write_clip(tmp_path / "clip.mp4", swaying(30)), out, largest_file_bytes=10_000)
    exit_code, stdout, stderr = process.ended(DEADLINE_S)
    errors = [line for line in stderr.splitlines() if "warning" not in line]
    assert exit_code == 2
    assert stdout == ""
    assert len(errors) == 1
    assert "cannot be written" in errors[0]
    assert not out.exists()


def test_a_folder_without_manifest_or_no_folder_is_no_run(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "missing"):
        with pytest.raises(TtcvidError, match=str(place)):
            Run.open(place)


SIGNAL_WHILE_IMPORTING = """
import atexit, os, signal, sys
from ttcvid.cli.main import main

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "click":
            os.kill(os.getpid(), signal.{signal})

sys.meta_path.insert(0, Finder())
sys.argv[1:] = ["analyze", "clip.mp4"]
code = main()
for _ in range({n_more}):
    os.kill(os.getpid(), signal.{signal})
sys.exit(code)
"""


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("n_more", [0, 2])
def test_a_signal_before_anything_is_imported_is_one_line(number: str, n_more: int) -> None:
    script = SIGNAL_WHILE_IMPORTING.format(signal=number, n_more=n_more)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 130
    assert done.stderr == "ttcvid: error: interrupted, nothing was written\n"


def test_output_that_cannot_be_written_is_no_fault_of_ours() -> None:
    script = "import sys; from ttcvid.cli.main import main; sys.exit(main(['--version']))"
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", script], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "standard output cannot be written (No space left on device)" in done.stderr
