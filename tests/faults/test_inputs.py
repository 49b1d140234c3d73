"""Hostile and damaged inputs: nothing false is told of them, nothing else is opened, nothing hangs."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from moving_clips import FPS, approach, write_approaching_tracks, write_clip, write_frames

from ttcvid.errors import InputError
from ttcvid.jobs import provenance
from ttcvid.jobs.analyze import analyze
from ttcvid.jobs.provenance import digest_in_background
from ttcvid.jobs.run import Run

NOT_UTF8 = os.fsdecode(b"caf\xe9")

TIMES_OF = """
import sys
from ttcvid.sources import open_source
for path in sys.argv[1:]:
    with open_source(path) as source:
        print([frame.t_s for frame in source], source.info.nominal_dt_s)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="MALLOC_PERTURB_ is glibc's")
def test_times_do_not_come_from_memory_that_is_free(tmp_path: Path) -> None:
    clips = [write_clip(tmp_path / name, approach(4)) for name in ("a.mp4", "a.mkv")]
    command = [sys.executable, "-c", TIMES_OF, *map(str, clips)]
    # glibc overwrites what is freed: of a stream that is read after its container was closed only nonsense is left
    environment = {**os.environ, "MALLOC_PERTURB_": "255"}
    printed = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60).stdout
    assert printed == f"{[i / FPS for i in range(4)]} {1 / FPS}\n" * 2


def video(folder: Path) -> tuple[Path, dict[str, object]]:
    return write_clip(folder / "clip.mp4", approach(4)), {"focal_px": 300.0}


def pictures(folder: Path) -> tuple[Path, dict[str, object]]:
    return write_frames(folder / "frames", approach(4)), {"focal_px": 300.0, "fps": 10.0}


def tracks(folder: Path) -> tuple[Path, dict[str, object]]:
    return write_approaching_tracks(folder / "tracks.csv"), {"focal_px": 300.0, "image_size": "192x128"}


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes on Linux")
@pytest.mark.parametrize("make", [video, pictures, tracks], ids=lambda make: make.__name__)
def test_a_name_that_is_not_utf8_is_a_name_like_any_other(
    tmp_path: Path, make: Callable[[Path], tuple[Path, dict[str, object]]]
) -> None:
    made, options = make(tmp_path)
    input_ = made.rename(tmp_path / f"{NOT_UTF8}{made.suffix}")
    out = tmp_path / f"{NOT_UTF8}_ttc"
    run = analyze(input_, out, **options)
    assert run.state == "complete"
    again = Run.open(out)
    assert again.manifest["input"]["path"] == str(input_)
    assert len(again.frames) == again.manifest["counts"]["frames"]


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes on Linux")
def test_the_summary_prints_a_name_as_it_is(tmp_path: Path) -> None:
    table, _ = tracks(tmp_path)
    arguments = [str(table), "--image-size", "192x128", "--no-overlay", "-q", "-o", f"{NOT_UTF8}_ttc"]
    command = [sys.executable, "-m", "ttcvid", "analyze", *arguments]
    printed = subprocess.run(command, cwd=tmp_path, capture_output=True, check=True, timeout=60).stdout
    assert printed.startswith(b"caf\xe9_ttc: complete, 12 frames")


@pytest.mark.parametrize("error", [UnicodeEncodeError("utf-8", "x", 0, 1, "no"), MemoryError(), InputError("gone")])
def test_whatever_the_hash_thread_fails_of_is_raised_where_its_result_is_awaited(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(files: tuple[Path, ...]) -> None:
        raise error

    monkeypatch.setattr(provenance, "digest_of", fail)
    with pytest.raises(type(error)):
        digest_in_background(()).result(timeout=10)


@pytest.mark.parametrize("name", ["2026-11-24T13:05", "concat:a|b"])
def test_an_output_folder_may_have_any_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """FFmpeg takes what precedes a colon for a protocol."""
    monkeypatch.chdir(tmp_path)
    table, options = tracks(tmp_path)
    run = analyze(table.name, name, end=2, **options)
    assert run.overlay is not None
    assert run.overlay.stat().st_size == json.loads((Path(name) / "manifest.json").read_text())["files"]["overlay.mp4"]
