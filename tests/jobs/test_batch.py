"""Many clips from inputs to tables: what is kept, what is done again, and what is said of clips that fail.

Clips are analysed in this process, but for the tests of processes and signals themselves.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq
import pytest
from moving_clips import approach, write_approaching_tracks, write_clip

import ttcvid
from ttcvid.cli.main import main
from ttcvid.errors import InputError, OutputError, UsageError
from ttcvid.jobs.batch import JOURNAL_NAME, Batch
from ttcvid.jobs.batch_table import read_rows
from ttcvid.jobs.workers import WorkerLostError
from ttcvid.schema import TABLE_NAMES

DEADLINE_S = 60.0
TRACKS = {"image_size": "192x128", "focal_px": 200, "overlay": False}


class WorkerHere:
    """Carries out calls in this process; ``fault`` is called with each clip before."""

    name = "here"

    def __init__(self, fault: Callable[[str], None] = lambda clip: None) -> None:
        self.fault = fault

    def call(self, function: Callable[..., Any], *arguments: Any, on_news: Any = None, avoid: str = "") -> Any:
        self.fault(arguments[0].clip)
        return function(*arguments, on_news=on_news)

    def close(self) -> None:
        pass


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> WorkerHere:
    worker = WorkerHere()
    monkeypatch.setattr("ttcvid.jobs.batch.LocalWorker", lambda **_: worker)
    return worker


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """Tables of tracks: the clips that are analysed fastest."""
    folder = tmp_path / "clips"
    folder.mkdir()
    for number in range(4):
        write_approaching_tracks(folder / f"clip{number}.csv", n=8 + number)
    return folder


def analyzed(clips: Path, out: Path, **options: Any) -> Batch:
    return ttcvid.batch(f"{clips}/*.csv", out, **{**TRACKS, **options})


def tables(out: Path) -> dict[str, bytes]:
    """The content of every table below a folder."""
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*.parquet"))}


def outcomes(out: Path) -> list[tuple[str, str]]:
    lines = [json.loads(line) for line in (out / JOURNAL_NAME).read_text().splitlines()]
    return [(line["clip"], line["outcome"]) for line in lines]


@pytest.mark.usefixtures("here")
def test_every_clip_has_a_folder_and_a_row(clips: Path, tmp_path: Path) -> None:
    result = analyzed(clips, tmp_path / "out")
    assert result.exit_code == 0
    rows = read_rows(tmp_path / "out")
    assert rows == result.rows
    assert [(row.clip, row.state, row.n_frames) for row in rows] == [
        (f"clip{number}", "complete", 8 + number) for number in range(4)
    ]
    run = ttcvid.Run.open(tmp_path / "out/clip3")
    assert rows[3].input_sha256 == run.manifest["input"]["sha256"]
    assert rows[3].n_objects == run.manifest["counts"]["objects"]
    assert rows[3].warnings == tuple(run.manifest["warnings"])
    assert "4 of 4 clips complete" in result.summary()
    assert set(tables(tmp_path / "out")) == {
        "batch.parquet",
        *(f"clip{number}/{name}.parquet" for number in range(4) for name in TABLE_NAMES),
    }


@pytest.mark.usefixtures("here")
def test_the_same_batch_again_does_nothing_and_leaves_the_same_tables(clips: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    analyzed(clips, out)
    before = tables(out)
    made = [path.stat().st_mtime_ns for path in sorted(out.glob("*/*"))]
    again = analyzed(clips, out)
    assert (again.n_kept, again.n_frames, again.exit_code) == (4, 0, 0)
    assert tables(out) == before
    assert [path.stat().st_mtime_ns for path in sorted(out.glob("*/*"))] == made


def change_input(clips: Path, out: Path) -> dict[str, Any]:
    write_approaching_tracks(clips / "clip1.csv", n=9, n_tracks=41)
    return {}


def change_setting(clips: Path, out: Path) -> dict[str, Any]:
    return {"tracking": {"max_tracks": 900}}


def change_version(clips: Path, out: Path) -> dict[str, Any]:
    manifest = json.loads((out / "clip1/manifest.json").read_text())
    manifest["versions"]["numpy"] = "1.0"
    (out / "clip1/manifest.json").write_text(json.dumps(manifest))
    return {}


def lose_a_table(clips: Path, out: Path) -> dict[str, Any]:
    (out / "clip1/events.parquet").unlink()
    return {}


def lose_the_manifest(clips: Path, out: Path) -> dict[str, Any]:
    (out / "clip1/manifest.json").rename(out / "clip1/.ttcvid-partial")
    (out / "clip1/.ttcvid-partial").unlink()
    for path in (out / "clip1").iterdir():
        path.unlink()
    return {}


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("change", "n_kept"),
    [(change_input, 3), (change_setting, 0), (change_version, 3), (lose_a_table, 3), (lose_the_manifest, 3)],
)
def test_what_is_no_longer_the_same_is_done_again(
    change: Callable[[Path, Path], dict[str, Any]], n_kept: int, clips: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    analyzed(clips, out)
    options = change(clips, out)
    again = analyzed(clips, out, **options)
    assert again.n_kept == n_kept
    assert all((out / row.clip / "events.parquet").exists() for row in again.rows)
    assert analyzed(clips, out, **options).n_kept == 4


@pytest.mark.usefixtures("here")
def test_the_content_of_a_camera_file_counts_not_its_place(clips: Path, tmp_path: Path, small_camera: str) -> None:
    camera = tmp_path / "camera.yaml"
    camera.write_text(small_camera)
    options = {"focal_px": None, "image_size": None}
    analyzed(clips, tmp_path / "out", camera=camera, **options)
    (tmp_path / "elsewhere").mkdir()
    moved = camera.rename(tmp_path / "elsewhere/camera.yaml")
    assert analyzed(clips, tmp_path / "out", camera=moved, **options).n_kept == 4
    moved.write_text(small_camera.replace("200", "210"))
    assert analyzed(clips, tmp_path / "out", camera=moved, **options).n_kept == 0


@pytest.fixture
def small_camera() -> str:
    return "image_size: [192, 128]\nfx_px: 200\nfy_px: 200\ncx_px: 95.5\ncy_px: 63.5\n"


def test_a_clip_that_fails_is_tried_again_and_named_with_its_reason(
    clips: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], here: WorkerHere
) -> None:
    (clips / "clip1.csv").write_text("frame,t_s,track_id,x_px,y_px\n0,zero,1,2,3\n")
    lost = {"clip2": 1, "clip3": 2}

    def fault(clip: str) -> None:
        lost[clip] = lost.get(clip, 0) - 1
        if lost[clip] >= 0:
            raise WorkerLostError("ended from outside")

    here.fault = fault
    options = ["--image-size", "192x128", "--focal-px", "200", "--no-overlay"]
    assert main(["batch", f"{clips}/*.csv", "-o", str(tmp_path / "out"), *options]) == 4
    printed = capsys.readouterr()
    assert "2 of 4 clips complete, 2 failed" in printed.out
    rows = {row.clip: row for row in read_rows(tmp_path / "out")}
    assert [row.state for row in rows.values()] == ["complete", "failed", "complete", "failed"]
    assert "clip1.csv" in (rows["clip1"].reason or "")
    assert rows["clip3"].reason == "ended from outside"
    assert "warning: clip clip2: ended from outside: it will be tried again" in printed.err
    assert "error: clip clip3: ended from outside" in printed.err
    assert outcomes(tmp_path / "out").count(("clip2", "failed")) == 1
    here.fault = lambda clip: None
    again = main(["batch", f"{clips}/*.csv", "-o", str(tmp_path / "out"), *options, "--json"])
    assert again == 4
    summary = json.loads(capsys.readouterr().out)
    assert (summary["n_kept"], summary["counts"]["complete"], list(summary["failed"])) == (2, 3, ["clip1"])


@pytest.mark.usefixtures("here")
def test_an_unforeseen_error_belongs_to_its_clip(
    clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, here: WorkerHere
) -> None:
    def fault(clip: str) -> None:
        if clip == "clip0":
            raise ZeroDivisionError("no reason")

    here.fault = fault
    result = analyzed(clips, tmp_path / "out")
    assert [row.clip for row in result.failed] == ["clip0"]
    assert "ZeroDivisionError: no reason: an error in ttcvid itself" in (result.failed[0].reason or "")


@pytest.mark.usefixtures("here")
def test_clips_of_a_former_batch_keep_their_rows(clips: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    ttcvid.batch([clips / "clip0.csv", clips / "clip2.csv"], out, **TRACKS)
    result = ttcvid.batch(clips / "clip1.csv", out, **TRACKS)
    assert [row.clip for row in result.rows] == ["clip1"]
    assert [row.clip for row in read_rows(out)] == ["clip0", "clip1", "clip2"]


@pytest.mark.usefixtures("here")
def test_a_folder_that_holds_something_else_is_kept(clips: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "batch.parquet").write_text("somebody's")
    with pytest.raises(OutputError, match=r"batch.parquet: cannot be read as a table"):
        analyzed(clips, out)
    (out / "batch.parquet").unlink()
    (out / "clip2").mkdir()
    (out / "clip2/letter.txt").write_text("dear")
    result = analyzed(clips, out)
    assert [row.clip for row in result.failed] == ["clip2"]
    assert (out / "clip2/letter.txt").read_text() == "dear"


@pytest.mark.usefixtures("here")
def test_two_batches_in_one_folder_are_refused(clips: Path, tmp_path: Path, here: WorkerHere) -> None:
    reasons = []

    def fault(clip: str) -> None:
        if not reasons:
            with pytest.raises(OutputError) as caught:
                analyzed(clips, tmp_path / "out")
            reasons.append(str(caught.value))

    here.fault = fault
    assert analyzed(clips, tmp_path / "out").exit_code == 0
    assert "another batch is writing there" in reasons[0]


def test_what_cannot_be_used_is_an_error_before_anything_is_written(clips: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(UsageError, match="jobs = 0"):
        analyzed(clips, out, jobs=0)
    with pytest.raises(UsageError, match="did you mean 'platform'"):
        analyzed(clips, out, platfrom="vehicle")
    with pytest.raises(InputError, match="no file fits"):
        ttcvid.batch(str(clips / "*.mp4"), out)
    (clips / "index.html.csv").write_text((clips / "clip0.csv").read_text())
    with pytest.raises(UsageError, match=r"no clip can be called 'index.html'"):
        analyzed(clips, out)
    assert not out.exists()


def begun(inputs: Path, out: Path, *options: str) -> subprocess.Popen[str]:
    command = Path(sys.executable).with_name("ttcvid")
    return subprocess.Popen(
        [command, "batch", str(inputs), "-o", str(out), "--focal-px", "200", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def outcomes_so_far(out: Path) -> set[str]:
    return {outcome for _, outcome in outcomes(out)} if (out / JOURNAL_NAME).exists() else set()


def is_over(process: subprocess.Popen[str]) -> bool:
    return process.poll() is not None


def wait_for(is_so: Callable[[], bool]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not is_so():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.fixture
def children_gone() -> Iterator[Callable[[subprocess.Popen[str]], list[psutil.Process]]]:
    """What a command began, and at the end: whether all of it is gone within 5 s."""
    found: list[psutil.Process] = []

    def children(process: subprocess.Popen[str]) -> list[psutil.Process]:
        found.extend(psutil.Process(process.pid).children(recursive=True))
        return found

    yield children
    assert psutil.wait_procs(found, timeout=5.0)[1] == []


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("videos")
    content = write_clip(folder / "clip0.mp4", approach(30) * 3).read_bytes()
    for number in range(1, 4):
        (folder / f"clip{number}.mp4").write_bytes(content)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_stopped_and_started_again_it_ends_as_in_one_go(
    number: signal.Signals, videos: Path, tmp_path: Path, children_gone: Callable[..., list[psutil.Process]]
) -> None:
    out = tmp_path / "out"
    process = begun(videos, out, "--jobs", "2", "--no-overlay")
    wait_for(lambda: ("complete" in outcomes_so_far(out) and any(out.glob("*/.ttcvid-partial"))) or is_over(process))
    assert len(children_gone(process)) >= 2
    os.kill(process.pid, number)
    started_s = time.monotonic()
    stdout, stderr = process.communicate(timeout=DEADLINE_S)
    if number != signal.SIGKILL:
        assert time.monotonic() - started_s < 4.0  # two seconds, on a machine that has other things to do
        assert process.returncode == 130, stderr
        assert "pending" in stdout
        assert not list(out.glob("*/.ttcvid-partial"))
        assert {row.state for row in read_rows(out)} == {"complete", "pending"}
    n_done = len(list(out.glob("*/manifest.json")))
    again = begun(videos, out, "--jobs", "2", "--no-overlay")
    stdout, stderr = again.communicate(timeout=DEADLINE_S)
    assert again.returncode == 0, stderr
    assert f"{n_done} from before" in stdout
    assert {row.state for row in read_rows(out)} == {"complete"}
    contents = {Path(path).name: content for path, content in tables(out).items() if "/" in path}
    for path, content in tables(out).items():
        if "/" in path:  # all clips have one content, so all results are one
            assert content == contents[Path(path).name], path
    assert pq.read_table(out / "batch.parquet").num_rows == 4
