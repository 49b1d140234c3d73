"""What stands on stderr while a command works."""

import pytest

from ttcvid.cli.progress import ProgressLines, progress_on_stderr


def test_without_a_terminal_a_line_says_every_10_s_how_far_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    now_s = 0.0
    lines = ProgressLines(clock=lambda: now_s)
    for n_done in range(1, 45):
        now_s = 0.5 * n_done
        lines(n_done, 60)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.splitlines() == [
        "ttcvid: 20 of 60 frames, 2.0 frames/s, 20 s left",
        "ttcvid: 40 of 60 frames, 2.0 frames/s, 10 s left",
    ]


def test_where_the_number_of_frames_is_unknown_no_time_is_promised(capsys: pytest.CaptureFixture[str]) -> None:
    now_s = 0.0
    lines = ProgressLines(clock=lambda: now_s)
    now_s = 10.0
    lines(5, None)
    assert capsys.readouterr().err == "ttcvid: 5 frames, 0.5 frames/s\n"


def test_the_rate_is_that_of_the_clip_at_hand(capsys: pytest.CaptureFixture[str]) -> None:
    now_s = 0.0
    lines = ProgressLines(clock=lambda: now_s)
    now_s = 9.0
    lines(900, 900)
    lines(1, 100)
    now_s = 14.0
    lines(10, 100)
    assert capsys.readouterr().err == "ttcvid: 10 of 100 frames, 2.0 frames/s, 45 s left\n"


def test_quiet_says_nothing(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ttcvid.cli.progress.LINE_EVERY_S", 0.0)
    for enabled, n_lines in ((False, 0), (True, 1)):
        with progress_on_stderr(enabled=enabled) as progress:
            progress(1, 2)
        assert len(capsys.readouterr().err.splitlines()) == n_lines
