"""What is said of a batch while it works."""

from typing import Any

import pytest

from ttcvid.cli import batch_progress as module
from ttcvid.cli.batch_progress import batch_progress, words_of
from ttcvid.jobs.batch.run_batch import Progress


class Clock:
    """Stands for the module ``time``."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr("ttcvid.jobs.batch.run_batch.time", clock)
    return clock


def progress(**values: Any) -> Progress:
    return Progress(n_clips=10, started_s=100.0, **values)


def test_rate_failures_and_time_left_are_those_of_clips_analysed_now(clock: Clock) -> None:
    clock.now_s = 150.0
    half = progress(n_done=6, n_kept=1, n_failed=2, frames_of_done=400, frames_under_way={"clip": 100})
    assert words_of(half) == "2 failed, 10 frames/s, 0:00:40 left"
    assert words_of(progress(n_done=3, n_kept=3)) == "0 frames/s"


def test_without_a_terminal_it_is_a_line_every_ten_seconds(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with batch_progress() as (on_progress, on_failure):
        for now_s in (101.0, 109.9, 110.0, 110.2, 119.9, 120.1):
            clock.now_s = now_s
            on_progress(progress(n_done=2, frames_of_done=100))
        on_failure("one", "no video", True)
        on_failure("one", "no video", False)
    assert capsys.readouterr().err.splitlines() == [
        "ttcvid: 2 of 10 clips, 10 frames/s, 0:00:40 left",
        "ttcvid: 2 of 10 clips, 5 frames/s, 0:01:20 left",
        "ttcvid: warning: clip one: no video: it will be tried again",
        "ttcvid: error: clip one: no video",
    ]


def test_quiet_says_nothing(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with batch_progress(enabled=False) as (on_progress, on_failure):
        clock.now_s = 200.0
        on_progress(progress(n_done=2))
        on_failure("one", "no video", False)
    assert capsys.readouterr().err == ""
