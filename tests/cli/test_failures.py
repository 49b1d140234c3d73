"""What goes wrong is one line with the right exit code, and leaves nothing that looks complete."""

import os
from collections.abc import Callable
from pathlib import Path

import av.error
import numpy as np
import pytest
from moving_clips import approach, write_approaching_tracks, write_audio, write_clip, write_frames

from ttcvid.cli.main import main
from ttcvid.errors import UsageError


@pytest.fixture(autouse=True)
def clean_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in list(os.environ):
        if name.startswith("TTCVID_"):
            monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def fails_with(capsys: pytest.CaptureFixture[str], arguments: list[str], exit_code: int, *parts: str) -> str:
    """Run a command that has to fail; ``parts`` have to stand in its one line."""
    assert main(arguments) == exit_code
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = [line for line in printed.err.splitlines() if not line.startswith("ttcvid: warning:")]
    assert len(lines) == 1
    assert lines[0].startswith("ttcvid: error: ")
    for part in parts:
        assert part in lines[0]
    assert not list(Path.cwd().rglob("manifest.json"))
    return lines[0]


def clip(n: int = 4) -> str:
    return str(write_clip(Path("clip.mp4"), approach(n)))


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["analyse"], ["unknown command 'analyse'", "did you mean 'analyze'"]),
        (["analyze"], ["Missing argument 'INPUT'"]),
        (["analyze", "clip.mp4", "--bogus"], ["--bogus"]),
        (["analyze", "clip.mp4", "--tracker", "sift"], ["--tracker", "sift", "klt"]),
        (["analyze", "clip.mp4", "--focal-px", "nan"], ["--focal-px", "nan", "finite number"]),
        (["analyze", "clip.mp4", "--focal-px", "-5"], ["--focal-px", "-5", "greater than 0"]),
        (["analyze", "clip.mp4", "--focal-px", "700", "--hfov", "60"], ["--focal-px", "--hfov", "only one"]),
        (["analyze", "clip.mp4", "--stride", "0"], ["--stride", "greater than or equal to 1"]),
        (["analyze", "clip.mp4", "--start", "noon"], ["--start", "noon", "4.5s"]),
        (["analyze", "clip.mp4", "--set", "tracking.max_trakcs=5"], ["max_trakcs", "did you mean 'max_tracks'"]),
        (["analyze", "clip.mp4", "--config", "missing.toml"], ["missing.toml"]),
        (["analyze", ""], ["INPUT is empty"]),
        (["analyze", "a.mp4", "b.mp4"], ["2 inputs", "a.mp4 to b.mp4", "'ttcvid batch'", "pattern in quotes"]),
        (["analyze", "clip.mp4", "-o", ""], ["follows -o is empty", "leave it out"]),
        (["demo", "--overwrite", "--out="], ["follows --out is empty", "leave it out"]),
        (["analyze", "a.csv", "--image-size", "999999x999999"], ["--image-size", "at most 100000 px"]),
    ],
)
def test_wrong_usage(arguments: list[str], parts: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    fails_with(capsys, arguments, 2, *parts)


def write_text_as_mp4() -> str:
    Path("notes.mp4").write_text("not a clip\n" * 50)
    return "notes.mp4"


def write_empty() -> str:
    Path("empty.mp4").write_bytes(b"")
    return "empty.mp4"


def write_mixed_sizes() -> str:
    write_frames(Path("mixed"), [*approach(2), np.zeros((64, 64), np.uint8)])
    return "mixed"


def write_tracks_without_column() -> str:
    Path("tracks.csv").write_text("frame,t_s,track_id,x_px\n0,0,1,5\n")
    return "tracks.csv"


def write_tracks_with(line: str) -> str:
    path = write_approaching_tracks(Path("tracks.csv"), n=3, n_tracks=4)
    path.write_text(path.read_text() + line)
    return str(path)


@pytest.mark.parametrize(
    ("make", "options", "parts"),
    [
        (lambda: "missing.mp4", [], ["missing.mp4", "no such file"]),
        (write_empty, [], ["empty.mp4", "empty"]),
        (write_text_as_mp4, [], ["notes.mp4"]),
        (lambda: str(write_audio(Path("talk.m4a"))), [], ["talk.m4a"]),
        (write_mixed_sizes, ["--fps", "10"], ["mixed", "64x64", "192x128"]),
        (write_tracks_without_column, ["--image-size", "192x128"], ["tracks.csv", "y_px"]),
        (lambda: write_tracks_with("2,0.2,9,nan,5\n"), ["--image-size", "192x128"], ["tracks.csv", "x_px"]),
        (lambda: write_tracks_with("2,0.2,1,50,5\n"), ["--image-size", "192x128"], ["tracks.csv", "track_id"]),
    ],
    ids=["missing", "empty", "text", "audio", "mixed", "column", "nan", "duplicate"],
)
def test_bad_input(
    make: Callable[[], str], options: list[str], parts: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    fails_with(capsys, ["analyze", make(), *options], 3, *parts)
    assert not list(Path.cwd().glob("*_ttc"))


def test_pipes_and_devices_are_called_what_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo("pipe.mp4")
    for name, says in (("pipe.mp4", "is a pipe or a device"), ("/dev/null", "is a pipe or a device"), ("-", "save it")):
        fails_with(capsys, ["analyze", name], 3, name, says, "save it as a file")


def test_a_folder_is_no_mask(capsys: pytest.CaptureFixture[str]) -> None:
    fails_with(capsys, ["analyze", clip(), "--mask", "."], 3, "is a folder; expected a mask")


def test_a_missing_scene_is_unreadable_input(capsys: pytest.CaptureFixture[str]) -> None:
    fails_with(capsys, ["simulate", "missing.yaml"], 3, "missing.yaml", "No such file")


def test_a_video_larger_than_can_be_encoded_is_refused_before_it_is_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    tracks = write_approaching_tracks(Path("tracks.csv"), n=3, n_tracks=4)
    says = "a video of 100000x90000 cannot be encoded (at most 16384 px a side)"
    fails_with(capsys, ["analyze", str(tracks), "--image-size", "100000x90000"], 2, says, "--no-overlay")


def test_pictures_without_times_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    fails_with(capsys, ["analyze", str(write_frames(Path("frames"), approach(3)))], 2, "frames", "--fps")


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        ("fx_px: .nan\nfy_px: 700\ncx_px: 96\ncy_px: 64\nimage_size: [192, 128]\n", ["fx_px", "nan"]),
        ("image_size: [640, 480]\nfx_px: 700\nfy_px: 700\ncx_px: 320\ncy_px: 240\n", ["640x480", "192x128"]),
        ("!!python/object/apply:os.system ['touch broken_in']\n", []),
        ("a: [1, 2\n", []),
        ("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b, *c]\n", []),
        ("", []),
    ],
    ids=["nan", "size", "hostile", "malformed", "alias", "empty"],
)
def test_bad_camera_file(content: str, parts: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    Path("camera.yaml").write_text(content)
    fails_with(capsys, ["analyze", clip(), "--camera", "camera.yaml"], 3, "camera.yaml", *parts)
    assert not Path("broken_in").exists()
    assert not Path("clip_ttc").exists()


def test_output_folder_that_exists_is_kept(capsys: pytest.CaptureFixture[str]) -> None:
    Path("out").mkdir()
    Path("out/mine.txt").write_text("keep")
    for options in ([], ["--overwrite"]):
        fails_with(capsys, ["analyze", clip(), "-o", "out", *options], 2, "out", "-o")
    assert [path.name for path in Path("out").iterdir()] == ["mine.txt"]


def test_output_folder_that_cannot_be_made(capsys: pytest.CaptureFixture[str]) -> None:
    Path("file").write_text("")
    fails_with(capsys, ["analyze", clip(), "-o", "file/out"], 2, "file/out", "-o")


def test_output_folder_of_the_input_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    frames = write_frames(Path("frames"), approach(3))
    fails_with(capsys, ["analyze", "frames", "--fps", "10", "-o", "frames", "--overwrite"], 2, "holds the input")
    assert len(list(frames.iterdir())) == 3


def test_an_unexpected_error_is_one_line_too_and_never_exit_code_1(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of\ntwo lines")

    monkeypatch.setattr("ttcvid.jobs.analyze.run_analysis.analyze_frames", broken)
    fails_with(capsys, ["analyze", clip()], UsageError.exit_code, "ZeroDivisionError", "TTCVID_DEBUG=1")
    assert not Path("clip_ttc").exists()
    monkeypatch.setenv("TTCVID_DEBUG", "1")
    assert main(["analyze", "clip.mp4"]) == UsageError.exit_code
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("error", [EOFError, BrokenPipeError, av.error.EOFError])
def test_an_end_of_file_is_no_interruption_and_a_pipe_that_breaks_within_is_no_success(
    error: type[Exception], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise error(32, "of a helper")

    monkeypatch.setattr("ttcvid.jobs.analyze.run_analysis.analyze_frames", broken)
    fails_with(capsys, ["analyze", clip()], UsageError.exit_code, "an error in ttcvid itself")
