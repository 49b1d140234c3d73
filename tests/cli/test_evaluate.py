"""``ttcvid evaluate`` on folders: perfect runs of simulated scenes, what it prints, and what it refuses."""

import hashlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from perfect_runs import manifest_of_run, perfect_run, write_run

import ttcvid
from ttcvid.cli.main import main
from ttcvid.jobs.evaluate import read_truth
from ttcvid.jobs.simulate import simulate
from ttcvid.simulate.tracks import TrackOptions
from ttcvid.sinks.manifest import write_manifest
from ttcvid.studies.evaluation.metrics import METRICS
from ttcvid.studies.evaluation.truth import RunTables

SCENE = Path(__file__).parents[2] / "sample_configs/scenes/demo.yaml"
N_FRAMES = 12


def no_tables(tracks: pd.DataFrame, frames: pd.DataFrame) -> RunTables:
    """Just enough of a run to read the truth with."""
    return RunTables(frames, pd.DataFrame(), pd.DataFrame(), tracks, pd.DataFrame())


@pytest.fixture(scope="module")
def of_tracks(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A simulation of tracks, and the run that says what is true of each track and object."""
    folder = tmp_path_factory.mktemp("tracks")
    options = TrackOptions(n_tracks=200, sigma_px=0.0)
    truth_folder = simulate(SCENE, folder / "truth", tracks=options, n_frames=N_FRAMES).folder
    true_tracks = pq.read_table(truth_folder / "truth_tracks.parquet").to_pandas()
    frames = pq.read_table(truth_folder / "truth_frames.parquet").to_pandas()
    truth = read_truth(truth_folder, no_tables(true_tracks, frames))
    ends, names = ("", "_lo", "_hi"), ("ttc_z", "tcpa", "miss")
    true_times = {f"{name}{end}_s": true_tracks[f"{name}_s"] for name in names for end in ends}
    tracks = true_tracks[["frame", "track_id"]].assign(**true_times)
    return write_run(folder / "run", perfect_run(truth, tracks)), truth_folder


@pytest.fixture(scope="module")
def of_pictures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A simulation of pictures, and a perfect run with a track on every sixth pixel."""
    folder = tmp_path_factory.mktemp("pictures")
    content = yaml.safe_load(SCENE.read_text())
    content["bodies"] = [body for body in content["bodies"] if body["kind"] == "car"]
    (folder / "cars.yaml").write_text(yaml.safe_dump(content))
    truth_folder = simulate(folder / "cars.yaml", folder / "truth", png=True, n_frames=2).folder
    frames = pq.read_table(truth_folder / "truth_frames.parquet").to_pandas()
    x, y = np.meshgrid(np.arange(3, 640, 6.0), np.arange(3, 360, 6.0))
    of_frame = pd.DataFrame({"x_px": x.ravel(), "y_px": y.ravel(), "track_id": np.arange(x.size)})
    tracks = pd.concat([of_frame.assign(frame=frame) for frame in range(2)], ignore_index=True)
    truth = read_truth(truth_folder, no_tables(tracks, frames))
    return write_run(folder / "run", perfect_run(truth, tracks)), truth_folder


def metrics_printed(capsys: pytest.CaptureFixture[str], run: Path, truth: Path) -> dict[str, float | None]:
    assert main(["evaluate", str(run), str(truth), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert set(content) == {"run", "truth", "metrics", "objects"}
    assert list(content["metrics"]) == list(METRICS)
    return content["metrics"]


@pytest.mark.parametrize("kind", ["of_tracks", "of_pictures"])
def test_a_run_that_says_the_truth_has_no_errors(
    kind: str, request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]
) -> None:
    run, truth = request.getfixturevalue(kind)
    metrics = metrics_printed(capsys, run, truth)
    for name in ("ttc_z", "tcpa", "miss", *(["track_ttc_z", "track_tcpa"] if kind == "of_tracks" else [])):
        for key in ("median", "p90", "bias"):
            assert metrics[f"{name}.{key}"] in (0, None), (name, key)
        assert metrics[f"{name}.coverage"] in (1, None)
    assert metrics["ttc_z.n"] > 0
    assert metrics["ttc_z.share"] == 1
    assert metrics["epipole_scene.p90"] == pytest.approx(0, abs=1e-9)
    assert metrics["rotation.p90"] == pytest.approx(0, abs=1e-9)
    assert metrics["objects.missed"] == metrics["objects.false"] == metrics["events.false"] == 0
    assert metrics["objects.found"] == 2
    assert metrics["tracks.right"] == metrics["tracks.objects_right"] == 1
    assert metrics["tracks.n"] > 300


def test_the_table_names_groups_and_objects(of_tracks: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", *map(str, of_tracks)]) == 0
    text = capsys.readouterr().out
    assert "ttc_z" in text
    assert "median 0.0 %" in text
    assert "object 1 (oncoming car): found in 100 % of 12 frames, ttc_z off by 0.0 % (median), does not collide" in text


def test_fail_on_exits_1_and_says_which(of_tracks: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["evaluate", *map(str, of_tracks), "-q", "--fail-on", "ttc_z.median>0.05"]
    assert main(words) == 0
    assert main([*words, "--fail-on", "objects.found<3", "--fail-on", "events.lead_s<1"]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "check failed: objects.found = 2 (fails on < 3)" in captured.err
    assert "check failed: events.lead_s has no value" in captured.err
    assert "ttc_z.median" not in captured.err


def test_the_page_holds_all_metrics_and_a_curve_of_each_object(of_tracks: tuple[Path, Path], tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert main(["evaluate", *map(str, of_tracks), "-q", "--html", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert "ttc_z.median" in text
    assert text.count("data-curve=") == 2
    (content,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text)
    first, _ = json.loads(content)["curves"]
    assert len(first["t_s"]) == len(first["true_hz"]) == len(first["found_hz"]) == len(first["low_hz"])
    found = [(true, value) for true, value in zip(first["true_hz"], first["found_hz"], strict=True) if value]
    assert len(found) > 5
    assert all(value == pytest.approx(true, rel=0.1) for true, value in found)
    assert all(
        low <= value <= high
        for low, value, high in zip(first["low_hz"], first["found_hz"], first["high_hz"], strict=True)
        if None not in (low, value, high)
    )
    assert not re.search(r"""(src|href)=["']?http""", text)


def test_the_page_goes_where_it_can_be_written(
    of_tracks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", *map(str, of_tracks), "--html", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_python_takes_the_same_folders(of_tracks: tuple[Path, Path]) -> None:
    run, truth = of_tracks
    assert ttcvid.evaluate(run, truth).evaluation.metrics["ttc_z.median"] == 0


def copied(truth: Path, tmp_path: Path) -> Path:
    return shutil.copytree(truth, tmp_path / "truth")


def refused(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, str]:
    code = main(["evaluate", *map(str, words)])
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return code, captured.err


def test_folders_that_are_not_there_or_hold_nothing_are_refused(
    of_tracks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, truth = of_tracks
    (tmp_path / "empty").mkdir()
    for words, says in (
        ((tmp_path / "none", truth), "no such folder"),
        ((tmp_path / "empty", truth), "manifest.json: not found"),
        ((run, tmp_path / "none"), "no such folder"),
        ((run, tmp_path / "empty"), "holds no truth"),
    ):
        code, message = refused(capsys, *words)
        assert code == 3
        assert says in message


def test_a_bad_condition_is_a_usage_error(of_tracks: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    code, message = refused(capsys, *of_tracks, "--fail-on", "ttc_z.medain>0.05")
    assert code == 2
    assert "did you mean 'ttc_z.median'?" in message


def test_a_damaged_table_is_refused(
    of_tracks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, truth = of_tracks[0], copied(of_tracks[1], tmp_path)
    path = truth / "truth_tracks.parquet"
    path.write_bytes(path.read_bytes()[:-100])
    code, message = refused(capsys, run, truth)
    assert code == 3
    assert "truth_tracks.parquet: cannot be read as a table" in message


def test_a_table_without_a_column_is_refused(
    of_tracks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, truth = of_tracks[0], copied(of_tracks[1], tmp_path)
    path = truth / "truth_frames.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["dir_x"]), path)
    code, message = refused(capsys, run, truth)
    assert code == 3
    assert "truth_frames.parquet: column 'dir_x' is missing" in message


def test_the_truth_of_another_clip_is_refused(
    of_tracks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, truth = of_tracks[0], copied(of_tracks[1], tmp_path)
    path = truth / "truth_frames.parquet"
    table = pq.read_table(path)
    for name, shift, says in (("t_s", 0.5, "is at t_s = 0.500 s, but at 0.000 s"), ("frame", 90, "no frame in common")):
        place = table.schema.get_field_index(name)
        moved = pa.array(table.column(name).to_numpy() + shift).cast(table.schema.field(name).type)
        pq.write_table(table.set_column(place, table.schema.field(name), moved), path)
        code, message = refused(capsys, run, truth)
        assert code == 3
        assert says in message


def rewritten(run: Path, folder: Path, **changes: object) -> Path:
    """A copy of a run whose manifest says something else."""
    shutil.copytree(run, folder)
    write_manifest(folder / "manifest.json", manifest_of_run(**changes))
    return folder


def test_the_truth_of_another_picture_size_is_refused(
    of_tracks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = rewritten(of_tracks[0], tmp_path / "run", image_size=(1242, 375))
    code, message = refused(capsys, run, of_tracks[1])
    assert code == 3
    assert "camera.yaml: is of pictures of 640x360" in message
    assert "of 1242x375: give the truth of the clip that was analysed" in message


def test_the_truth_of_another_clip_of_the_same_size_is_said(
    of_tracks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, truth = of_tracks
    sha256 = hashlib.sha256((truth / "tracks.parquet").read_bytes()).hexdigest()
    made_of = {"nominal_dt_s": 0.1, "n_files": 1, "kind": "tracks"}
    for digest, n_lines in ((sha256, 0), ("0" * 64, 1)):
        other = rewritten(run, tmp_path / digest, input={**made_of, "sha256": digest})
        assert main(["evaluate", str(other), str(truth)]) == 0
        said = capsys.readouterr().err
        assert said.count("\n") == n_lines
        assert not said or "tracks.parquet is not the file that the run" in said


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"camera": {}}, "field 'camera.fx_px' is missing"),
        ({"camera": 3}, "field 'camera' = 3: expected fields below it"),
        ({"state": "done"}, "field 'state' = 'done': expected one of complete, truncated, interrupted"),
        ({"counts": {"frames": "many"}}, "field 'counts.frames' = 'many': expected a whole number"),
        ({"horizon": {"y_left_px": 1e999}}, "field 'horizon.y_left_px'"),
    ],
)
def test_a_manifest_that_was_cut_down_is_refused_by_every_command(
    changes: dict[str, object],
    says: str,
    of_tracks: tuple[Path, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = Path(shutil.copytree(of_tracks[0], tmp_path / "run"))
    (run / "manifest.json").write_text(json.dumps(manifest_of_run(**changes) | {"format": "ttcvid-run"}))
    commands = {
        "evaluate": (3, run, of_tracks[1]),
        "collision-map": (3, run, "--ego-speed", "10", "-o", tmp_path / "map"),
        "compare": (2, run, of_tracks[0]),
    }
    for name, (expected, *words) in commands.items():
        assert main([name, *map(str, words)]) == expected
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert f"manifest.json: {says}" in said


def test_a_missing_picture_of_labels_is_refused(
    of_pictures: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, truth = of_pictures[0], copied(of_pictures[1], tmp_path)
    (truth / "truth_labels/000001.png").unlink()
    code, message = refused(capsys, run, truth)
    assert code == 3
    assert "000001.png: is missing: give the truth of the clip that was analysed" in message


def test_objects_alone_are_truth_enough(of_pictures: tuple[Path, Path], tmp_path: Path) -> None:
    run, truth = of_pictures[0], tmp_path / "objects"
    truth.mkdir()
    shutil.copy(of_pictures[1] / "truth_objects.parquet", truth)
    metrics = ttcvid.evaluate(run, truth).evaluation.metrics
    assert metrics["ttc_z.median"] == 0
    assert metrics["tracks.right"] is metrics["rotation.median"] is metrics["events.true"] is None
