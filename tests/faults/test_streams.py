"""Whatever becomes of standard output and error, the result is there, and the exit code is that of the work."""

import os
import subprocess
from pathlib import Path

import pytest
from attacked_runs import DEADLINE_S, PROGRAM, is_whole
from moving_clips import write_approaching_tracks

from ttcvid.cli.main import main


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    tracks = write_approaching_tracks(tmp_path / "tracks.csv", n=5, n_tracks=20)
    options = ["--image-size", "192x128", "--no-overlay", "--no-report", "-o", str(tmp_path / "out")]
    return [str(PROGRAM), "analyze", str(tracks), *options]


def in_shell(command: list[str], streams: str) -> subprocess.CompletedProcess[str]:
    line = f'"$0" "$@" {streams}'
    words = ["bash", "-o", "pipefail", "-c", line, *command]
    return subprocess.run(words, capture_output=True, text=True, timeout=DEADLINE_S, check=False)


@pytest.mark.parametrize("streams", ["2>/dev/full", "2> >(exec 0<&-)", "| true"])
def test_a_result_outlives_the_streams(command: list[str], streams: str, tmp_path: Path) -> None:
    done = in_shell([*command, "-v"], streams)
    assert done.returncode == 0, done
    assert "Traceback" not in done.stdout + done.stderr
    assert is_whole(tmp_path / "out")


def test_an_error_keeps_its_exit_code_where_it_cannot_be_told(tmp_path: Path) -> None:
    done = in_shell([str(PROGRAM), "analyze", str(tmp_path / "missing.mp4")], "2>/dev/full")
    assert (done.returncode, done.stdout) == (3, "")


def test_a_failed_check_is_none_the_less_failed_where_nobody_reads_on(command: list[str], tmp_path: Path) -> None:
    """Of a reader that has gone (``| head``), a check must not take its success."""
    for out, end in (("out", "5"), ("other", "3")):
        assert main([*command[1:-1], str(tmp_path / out), "--end", end]) == 0
    compare = [str(PROGRAM), "compare", str(tmp_path / "out"), str(tmp_path / "other")]
    assert in_shell(compare, "| true").returncode == 1


def test_what_is_printed_does_not_land_in_a_file_that_took_the_number_of_a_closed_stream(
    command: list[str], tmp_path: Path
) -> None:
    done = in_shell(command, "0<&- >&- 2>&-")
    assert done.returncode == 0
    assert is_whole(tmp_path / "out")
    assert (tmp_path / "out" / "frames.parquet").read_bytes()[:4] == b"PAR1"


def test_a_reader_that_takes_nothing_costs_log_lines_alone(command: list[str], tmp_path: Path) -> None:
    """Standard error is a full pipe that does not wait."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    try:
        while True:
            os.write(writer, b"x" * 4096)
    except BlockingIOError:
        pass
    done = subprocess.run([*command, "-v"], stdout=subprocess.PIPE, stderr=writer, timeout=DEADLINE_S, check=False)
    os.close(writer)
    os.close(reader)
    assert done.returncode == 0
    assert is_whole(tmp_path / "out")
