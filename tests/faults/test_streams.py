"""Whatever becomes of standard output and error, the result is there, and the exit code is that of the work."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from attacked_runs import DEADLINE_S, PROGRAM, is_whole
from copies_of_process import CommandInCopy
from moving_clips import write_approaching_tracks

from ttcvid.cli.main import main

STDOUT, STDERR = 1, 2


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    tracks = write_approaching_tracks(tmp_path / "tracks.csv", n=5, n_tracks=20)
    options = ["--image-size", "192x128", "--no-overlay", "--no-report", "-o", str(tmp_path / "out")]
    return ["analyze", str(tracks), *options]


def to_full_disk() -> None:
    os.dup2(os.open("/dev/full", os.O_WRONLY), STDERR)


def to_nobody(stream: int) -> None:
    """A pipe whose reader has gone (``| head``)."""
    reader, writer = os.pipe()
    os.close(reader)
    os.dup2(writer, stream)


def to_one_who_takes_nothing() -> None:
    """A full pipe that does not wait."""
    _, writer = os.pipe()
    os.set_blocking(writer, False)
    try:
        while True:
            os.write(writer, b"x" * 4096)
    except BlockingIOError:
        pass
    os.dup2(writer, STDERR)


def ended(folder: Path, redirect: Callable[[], None], *words: object) -> tuple[int | None, str]:
    """Exit code, and what it printed to the streams that still lead to where it can be read."""
    exit_code, stdout, stderr = CommandInCopy(folder, *words, redirect=redirect).ended(DEADLINE_S)
    return exit_code, stdout + stderr


@pytest.mark.parametrize(
    "redirect",
    [to_full_disk, lambda: to_nobody(STDERR), lambda: to_nobody(STDOUT), to_one_who_takes_nothing],
    ids=["full disk", "nobody reads errors", "nobody reads output", "a reader that takes nothing"],
)
def test_a_result_outlives_the_streams(redirect: Callable[[], None], words: list[str], tmp_path: Path) -> None:
    exit_code, printed = ended(tmp_path, redirect, *words, "-v")
    assert exit_code == 0, printed
    assert "Traceback" not in printed
    assert is_whole(tmp_path / "out")


def test_an_error_keeps_its_exit_code_where_it_cannot_be_told(tmp_path: Path) -> None:
    assert ended(tmp_path, to_full_disk, "analyze", tmp_path / "missing.mp4") == (3, "")


def test_a_failed_check_is_none_the_less_failed_where_nobody_reads_on(words: list[str], tmp_path: Path) -> None:
    """Of a reader that has gone (``| head``), a check must not take its success."""
    for out, end in (("out", "5"), ("other", "3")):
        assert main([*words[:-1], str(tmp_path / out), "--end", end]) == 0
    compare = ["compare", tmp_path / "out", tmp_path / "other"]
    assert ended(tmp_path, lambda: to_nobody(STDOUT), *compare)[0] == 1


def test_what_is_printed_does_not_land_in_a_file_that_took_the_number_of_a_closed_stream(
    words: list[str], tmp_path: Path
) -> None:
    """A process of its own: what is closed when Python starts is none of its streams."""
    line = ["bash", "-c", '"$0" "$@" 0<&- >&- 2>&-', str(PROGRAM), *words]
    assert subprocess.run(line, timeout=DEADLINE_S, check=False).returncode == 0
    assert is_whole(tmp_path / "out")
    assert (tmp_path / "out" / "frames.parquet").read_bytes()[:4] == b"PAR1"
