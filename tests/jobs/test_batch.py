"""Many clips from inputs to tables: what is kept, what is done again, and what is said of clips that fail.

Clips are analysed in this process; processes, signals and full disks: tests/benchmarks/test_batch_stress.py.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.compute as pc
import pytest
from moving_clips import write_approaching_tracks
from workers_here import WorkerHere

import ttcvid
from ttcvid.cli.main import main
from ttcvid.errors import InputError, OutputError, UsageError
from ttcvid.jobs.batch.run_batch import JOURNAL_NAME, Batch
from ttcvid.jobs.batch.table import ClipRow, read_rows
from ttcvid.jobs.processes.workers import WorkerLostError
from ttcvid.schema import TABLE_NAMES

TRACKS = {"image_size": "192x128", "focal_px": 200, "overlay": False, "report": False}


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> WorkerHere:
    worker = WorkerHere()
    monkeypatch.setattr("ttcvid.jobs.batch.run_batch.LocalWorker", lambda **_: worker)
    return worker


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """Tables of tracks: the clips that are analysed fastest."""
    folder = tmp_path / "clips"
    folder.mkdir()
    for number in range(4):
        write_approaching_tracks(folder / f"clip{number}.csv", n=3 + number, n_tracks=20)
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
        (f"clip{number}", "complete", 3 + number) for number in range(4)
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
    write_approaching_tracks(clips / "clip1.csv", n=4, n_tracks=21)
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
def test_what_is_no_longer_the_same_is_done_again(clips: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    analyzed(clips, out)
    changes: dict[Callable[[Path, Path], dict[str, Any]], int] = {change_input: 3, change_version: 3, lose_a_table: 3}
    for change, n_kept in (changes | {lose_the_manifest: 3, change_setting: 0}).items():
        options = change(clips, out)
        again = analyzed(clips, out, **options)
        assert again.n_kept == n_kept, change.__name__
        assert all((out / row.clip / "events.parquet").exists() for row in again.rows)
        assert analyzed(clips, out, **options).n_kept == 4, change.__name__


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

    here.before = lambda function, task: fault(task.clip)
    options = ["--image-size", "192x128", "--focal-px", "200", "--no-overlay", "--no-report"]
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
    here.before = lambda function, task: None
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

    here.before = lambda function, task: fault(task.clip)
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

    here.before = lambda function, task: fault(task.clip)
    assert analyzed(clips, tmp_path / "out").exit_code == 0
    assert "another batch is writing there" in reasons[0]


@pytest.mark.parametrize(
    ("states", "is_interrupted", "exit_code"),
    [
        (["complete", "complete"], False, 0),
        (["complete", "truncated"], False, 4),
        (["failed", "complete"], False, 4),
        (["complete", "pending"], True, 130),
    ],
)
def test_the_exit_code_says_how_it_ended(states: list[str], is_interrupted: bool, exit_code: int) -> None:
    rows = tuple(ClipRow(str(number), "clip.mp4", state) for number, state in enumerate(states))
    assert Batch(Path("out"), rows, 0, 10, 1.0, is_interrupted).exit_code == exit_code


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


@pytest.mark.usefixtures("here")
def test_the_tables_of_all_clips_are_one_with_a_column_that_names_the_clip(clips: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (clips / "clip2.csv").write_text("no table")
    analyzed(clips, out)
    found = ttcvid.open_batch(out)
    assert list(found.clips["clip"]) == ["clip0", "clip1", "clip2", "clip3"]
    for name in TABLE_NAMES:
        table = getattr(found, name).to_table()
        assert table.column_names[0] == "clip"
        assert table.num_rows == sum(len(getattr(found.run(clip), name)) for clip in ("clip0", "clip1", "clip3"))
    one = found.frames.to_table(filter=pc.field("clip") == "clip3").to_pandas()
    assert set(one.pop("clip")) == {"clip3"}
    pd.testing.assert_frame_equal(one, found.run("clip3").frames)
    fragments = list(found.frames.get_fragments(filter=pc.field("clip") == "clip3"))
    assert [Path(fragment.path).parent.name for fragment in fragments] == ["clip3"]


def test_a_folder_without_batch_is_no_batch(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="this is no batch"):
        ttcvid.open_batch(tmp_path)


def test_without_a_scheduler_at_the_address_nothing_begins(
    clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ttcvid.jobs.processes.cluster.CONNECT_WAIT_S", 0.2)
    for address in ("tcp://127.0.0.1:1", "nonsense"):
        with pytest.raises(UsageError, match=f"--scheduler {address}: no Dask scheduler answers there"):
            analyzed(clips, tmp_path / "out", scheduler=address)
    assert not list(tmp_path.glob("out/*/*"))


@pytest.mark.slow
@pytest.mark.usefixtures("here")
def test_a_cluster_of_two_workers_makes_the_same_tables_byte_for_byte(clips: Path, tmp_path: Path) -> None:
    from distributed import LocalCluster

    for name in ("clip0", "clip3"):
        (clips / f"{name}.csv").unlink()
    (clips / "clip2.csv").write_text("no table")
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster:
        there = analyzed(clips, tmp_path / "there", scheduler=cluster.scheduler_address)
        again = analyzed(clips, tmp_path / "there", scheduler=cluster.scheduler_address)
    here = analyzed(clips, tmp_path / "here")
    assert [row.state for row in there.rows] == ["complete", "failed"]
    assert there.rows == here.rows
    assert tables(tmp_path / "there") == tables(tmp_path / "here")
    assert again.n_kept == 1
    tries = [json.loads(line) for line in (tmp_path / "there" / JOURNAL_NAME).read_text().splitlines()]
    assert len({line["worker"] for line in tries if line["clip"] == "clip2"}) == 2, "failed, and again elsewhere"


@pytest.mark.usefixtures("here")
def test_the_index_links_every_result_and_shows_hostile_names_as_they_are(clips: Path, tmp_path: Path) -> None:
    (clips / "clip0.csv").rename(clips / "<b>#1%2F.csv")
    (clips / "clip1.csv").write_text("<script>alert(1)</script>")
    analyzed(clips, tmp_path / "out")
    page = (tmp_path / "out/index.html").read_text(encoding="utf-8")
    assert '<a href="clip2/">clip2</a>' in page
    assert '<a href="%3Cb%3E%231%252F/">&lt;b&gt;#1%2F</a>' in page
    assert "<script" not in page
    assert "1 failed" in page
    assert page.count("<tr>") == 5
    ttcvid.batch(clips / "clip2.csv", tmp_path / "out", **{**TRACKS, "report": True})
    assert '<a href="clip2/report.html">clip2</a>' in (tmp_path / "out/index.html").read_text(encoding="utf-8")
    (tmp_path / "out/index.html").write_text("my page")
    with pytest.raises(OutputError, match=r"index.html: is no page of a batch, so it is kept"):
        analyzed(clips, tmp_path / "out")
