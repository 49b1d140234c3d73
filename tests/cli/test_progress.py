"""What stands on stderr while a command works."""

import pytest

from ttcvid.cli.main import main
from ttcvid.cli.progress import ProgressLines, compile_first, progress_on_stderr
from ttcvid.jobs.processes.compilation import OnCompiled


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
    lines(1, None)
    now_s = 10.0
    lines(6, None)
    assert capsys.readouterr().err == "ttcvid: 6 frames, 0.5 frames/s\n"


def test_what_comes_before_the_first_frame_is_no_part_of_the_rate(capsys: pytest.CaptureFixture[str]) -> None:
    now_s = 0.0
    lines = ProgressLines(clock=lambda: now_s)
    now_s = 15.0
    lines(1, 85)
    assert capsys.readouterr().err == ""
    now_s = 16.0
    lines(5, 85)
    assert capsys.readouterr().err == "ttcvid: 5 of 85 frames, 4.0 frames/s, 20 s left\n"


def test_the_rate_is_that_of_the_clip_at_hand(capsys: pytest.CaptureFixture[str]) -> None:
    now_s = 0.0
    lines = ProgressLines(clock=lambda: now_s)
    now_s = 9.0
    lines(900, 900)
    lines(1, 100)
    now_s = 14.0
    lines(10, 100)
    assert capsys.readouterr().err == "ttcvid: 10 of 100 frames, 1.8 frames/s, 50 s left\n"


def test_quiet_says_nothing(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ttcvid.cli.progress.LINE_EVERY_S", 0.0)
    for enabled, n_lines in ((False, 0), (True, 1)):
        with progress_on_stderr(enabled=enabled) as progress:
            progress(1, 2)
            progress(2, 2)
        assert len(capsys.readouterr().err.splitlines()) == n_lines


def test_it_is_said_that_something_is_compiled_and_when_it_is_done(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def compile_three(on_compiled: OnCompiled = lambda n_done, n_total: None) -> bool:
        for n_done in (0, 1, 3):
            on_compiled(n_done, 3)
        return True

    monkeypatch.setattr("ttcvid.jobs.processes.compilation.compile_missing", compile_three)
    compile_first()
    said = ["ttcvid: compiling, once on this machine", "ttcvid: 3 functions compiled"]
    assert capsys.readouterr().err.splitlines() == said
    compile_first(enabled=False)
    assert capsys.readouterr().err == ""


def test_nothing_is_said_where_all_is_compiled(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ttcvid.jobs.processes.compilation.compile_missing", lambda on_compiled: False)
    compile_first()
    assert capsys.readouterr().err == ""


def test_doctor_compiles_ahead_where_it_is_told_to(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = []
    monkeypatch.setattr("ttcvid.jobs.processes.compilation.compile_missing", compiled.append)
    for options, n_compiled in (([], 0), (["--warm"], 1)):
        assert main(["doctor", *options]) == 0
        assert len(compiled) == n_compiled
