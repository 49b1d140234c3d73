"""Whole analyses of small clips: every output is there, says what it is, and is the same each time."""

import json
from itertools import count
from pathlib import Path

import av
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from moving_clips import FPS, approach, picture, swaying, write_approaching_tracks, write_clip, write_frames

import ttcvid
from ttcvid.cli.main import main
from ttcvid.jobs.processes import side_by_side
from ttcvid.schema import TABLE_NAMES, TABLES

SAMPLE_CONFIGS = Path(__file__).resolve().parents[2] / "sample_configs"


@pytest.fixture(autouse=True)
def work_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def assert_whole(run: ttcvid.Run, n_frames: int) -> None:
    """All tables with all columns, a row for every frame, and a video of as many pictures."""
    for name in TABLE_NAMES:
        assert list(getattr(run, name).columns) == [column.name for column in TABLES[name]]
    assert len(run.frames) == n_frames == run.manifest["counts"]["frames"]
    assert run.overlay is not None
    with av.open(str(run.overlay)) as container:
        assert sum(1 for _ in container.decode(video=0)) == n_frames


@pytest.mark.usefixtures("geometry_in_a_process")
def test_a_clip_gives_every_output(work_folder: Path) -> None:
    clip = write_clip(work_folder / "clip.mp4", approach(12))
    run = ttcvid.analyze(clip)
    assert run.folder == Path("clip_ttc")
    assert (run.state, run.exit_code) == ("complete", 0)
    assert_whole(run, 12)
    assert sorted(path.name for path in run.folder.iterdir()) == sorted(
        [*(f"{name}.parquet" for name in TABLE_NAMES), "overlay.mp4", "report.html", "manifest.json"]
    )
    np.testing.assert_allclose(run.frames.t_s.astype(float), np.arange(12) / FPS, atol=1e-9)
    assert run.frames.dt_s.isna().tolist() == [True] + [False] * 11
    assert len(run.collision_times) == run.manifest["counts"]["track_rows"]


@pytest.mark.usefixtures("geometry_in_a_process")
def test_the_second_analysis_of_a_process_loads_the_compiled_code_for_all_that_follow(
    work_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []
    monkeypatch.setattr("ttcvid.jobs.analyze.run_analysis._ANALYSES", count())
    monkeypatch.setattr("ttcvid.jobs.analyze.run_analysis.load_compiled", lambda: calls.append(1))
    clip = write_clip(work_folder / "clip.mp4", approach(3))
    for n_calls in (0, 1, 1):
        ttcvid.analyze(clip, overlay=False, report=False, overwrite=True)
        assert len(calls) == n_calls


def test_an_assumed_camera_is_said_everywhere(work_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip = write_clip(work_folder / "clip.mp4", approach(3))
    assert main(["analyze", str(clip)]) == 0
    printed = capsys.readouterr()
    assert "ASSUMED" in printed.out
    assert "focal length is assumed" in printed.err
    run = ttcvid.Run.open("clip_ttc")
    assert run.manifest["camera"]["is_assumed"] is True
    assert "focal length is assumed" in run.manifest["warnings"][0]
    for name in TABLE_NAMES:
        assert pq.read_schema(run.folder / f"{name}.parquet").metadata[b"camera_is_assumed"] == b"true"
    assert main(["analyze", str(clip), "--focal-px", "200", "--overwrite"]) == 0
    printed = capsys.readouterr()
    assert "ASSUMED" not in printed.out
    assert printed.err == ""
    assert ttcvid.Run.open("clip_ttc").manifest["camera"]["fx_px"] == 200.0


def test_the_manifest_tells_input_settings_and_their_origins(work_folder: Path) -> None:
    clip = write_clip(work_folder / "clip.mp4", approach(4))
    (work_folder / "run.toml").write_text("[tracking]\nmax_tracks = 300\n")
    assert main(["analyze", str(clip), "--config", "run.toml", "--platform", "vehicle", "--no-overlay"]) == 0
    manifest = json.loads(Path("clip_ttc/manifest.json").read_text())
    assert manifest["configuration"]["tracking"]["max_tracks"] == {"value": 300, "origin": "file run.toml"}
    assert manifest["configuration"]["egomotion"]["platform"] == {"value": "vehicle", "origin": "command line"}
    assert manifest["arguments"][0] == "analyze"
    assert manifest["input"]["size_bytes"] == clip.stat().st_size
    assert len(manifest["input"]["sha256"]) == 64
    assert {"ttcvid", "python", "numpy", "opencv", "av", "pyarrow"} <= set(manifest["versions"])
    assert manifest["image_size"] == {"width_px": 192, "height_px": 128}
    assert manifest["timings"]["total_s"] > 0


def test_json_prints_one_object(work_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip = write_clip(work_folder / "clip.mp4", approach(3))
    assert main(["analyze", str(clip), "--json", "-q"]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    content = json.loads(printed.out)
    assert (content["state"], content["exit_code"], content["folder"]) == ("complete", 0, "clip_ttc")
    assert content["counts"]["frames"] == 3


def test_a_truncated_clip_is_analysed_as_far_as_it_goes(work_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip = write_clip(work_folder / "clip.mkv", swaying(16))
    clip.write_bytes(clip.read_bytes()[: clip.stat().st_size // 2])
    assert main(["analyze", str(clip)]) == 4
    assert "ends early" in capsys.readouterr().err
    run = ttcvid.Run.open("clip_ttc")
    assert run.state == "truncated"
    assert 2 < run.manifest["counts"]["frames"] < 16
    assert any("ends early" in warning for warning in run.manifest["warnings"])
    assert_whole(run, run.manifest["counts"]["frames"])


@pytest.mark.parametrize(
    "pictures",
    [approach(1), [np.zeros_like(picture())] * 6, [picture()] * 6, [picture()] * 5 + [np.rot90(picture(), 2)] * 5],
    ids=["one frame", "black", "nothing moves", "cut"],
)
def test_clips_without_motion_give_valid_results_without_objects(pictures: list[np.ndarray], work_folder: Path) -> None:
    clip = write_clip(work_folder / "clip.mp4", [np.ascontiguousarray(grey) for grey in pictures])
    run = ttcvid.analyze(clip)
    assert run.state == "complete"
    assert_whole(run, len(pictures))
    assert run.events.empty
    assert run.manifest["nearest"] is None
    assert run.collision_times.ttc_z_s.isna().all()


def test_a_folder_of_pictures_gives_its_name_and_is_hashed_with_its_names(work_folder: Path) -> None:
    folder = write_frames(work_folder / "drive", approach(4))
    whole = ttcvid.analyze(folder, fps=10)
    assert whole.folder == Path("drive_ttc")
    by_pattern = ttcvid.analyze(f"{folder}/%06d.png", fps=10, overwrite=True)
    assert by_pattern.folder == Path("drive_ttc")
    assert by_pattern.manifest["input"]["sha256"] == whole.manifest["input"]["sha256"]
    (folder / "000003.png").rename(folder / "000004.png")
    renamed = ttcvid.analyze(folder, fps=10, overwrite=True)
    assert renamed.manifest["input"]["sha256"] != whole.manifest["input"]["sha256"]


def test_a_track_table_is_drawn_on_black(work_folder: Path) -> None:
    table = write_approaching_tracks(work_folder / "tracks.csv")
    run = ttcvid.analyze(table, image_size="192x128", focal_px=200)
    assert_whole(run, 12)
    assert run.overlay is not None
    with av.open(str(run.overlay)) as container:
        last = list(container.decode(video=0))[-1].to_ndarray(format="gray")
    assert np.median(last) < 40
    assert last.max() > 80
    assert set(run.collision_times.track_id) == set(range(40))


def test_start_end_and_stride_keep_the_source_frame_numbers(work_folder: Path) -> None:
    clip = write_clip(work_folder / "clip.mp4", swaying(12))
    run = ttcvid.analyze(clip, start=2, end="1.0s", stride=2, overlay=False, report=False)
    assert run.frames.frame.tolist() == [2, 4, 6, 8]


def test_nulls_of_whole_numbers_stay_na(work_folder: Path) -> None:
    run = ttcvid.analyze(write_clip(work_folder / "clip.mp4", approach(3)), overlay=False, report=False)
    assert run.collision_times.cluster_id.dtype == pd.Int32Dtype()
    scene = run.clusters[run.clusters.role == "scene"]
    assert len(scene) == 3
    assert scene.urgency_rank.dtype == pd.Int32Dtype()
    assert scene.urgency_rank.isna().all()


@pytest.mark.parametrize("name", ["car", "aircraft", "resting_camera"])
def test_the_sample_configurations_run(name: str, work_folder: Path) -> None:
    clip = write_clip(work_folder / "clip.mp4", approach(5))
    run = ttcvid.analyze(clip, config=SAMPLE_CONFIGS / f"{name}.toml")
    assert run.state == "complete"
    assert f"{name}.toml" in run.manifest["configuration"]["egomotion"]["platform"]["origin"]


def test_estimates_of_both_sides_are_said_to_be_so_everywhere(work_folder: Path) -> None:
    clip = write_clip(work_folder / "clip.mp4", approach(17))
    assert main(["analyze", str(clip), "--focal-px", "200", "--smooth", "-q"]) == 0
    smooth = ttcvid.Run.open("clip_ttc")
    causal = ttcvid.analyze(clip, "causal", focal_px=200, overlay=False, report=False)
    assert_whole(smooth, 17)
    for run, word in ((smooth, "smooth"), (causal, "causal")):
        assert run.manifest["configuration"]["collision_times"]["smooth"]["value"] is (word == "smooth")
        for name in TABLE_NAMES:
            metadata = pq.read_schema(run.folder / f"{name}.parquet").metadata
            assert (metadata[b"estimates"], metadata[b"warnings"]) == (word.encode(), b"causal")
    pd.testing.assert_frame_equal(smooth.events, causal.events)
    middle = smooth.collision_times.frame.between(7, 11)
    both = smooth.collision_times[middle].ttc_z_s, causal.collision_times[middle].ttc_z_s
    truth_s = 4.0 - smooth.collision_times[middle].t_s
    assert not both[0].equals(both[1])
    assert all((one.astype(float) / truth_s - 1.0).abs().median() < 0.08 for one in both)


@pytest.mark.parametrize("tracker", ["klt", "akaze"])
@pytest.mark.parametrize("estimator", ["multi-frame", "three-frame", "two-frame"])
def test_all_methods_of_a_clip_run(tracker: str, estimator: str, work_folder: Path) -> None:
    clip = write_clip(work_folder / "clip.mp4", approach(8))
    run = ttcvid.analyze(clip, tracker=tracker, estimator=estimator, overlay=False, report=False)
    assert run.state == "complete"
    metadata = pq.read_schema(run.folder / "frames.parquet").metadata
    assert (metadata[b"tracker"], metadata[b"estimator"]) == (tracker.encode(), estimator.encode())


@pytest.mark.usefixtures("geometry_in_a_process")
def test_very_large_pictures_wait_nowhere_and_give_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = write_clip(tmp_path / "clip.mp4", approach(8))
    usual = ttcvid.analyze(clip, tmp_path / "usual", focal_px=300.0)
    monkeypatch.setattr(side_by_side, "WAITING_BYTES", 0)
    large = ttcvid.analyze(clip, tmp_path / "large", focal_px=300.0)
    for name in ("frames", "clusters", "collision_times"):
        pd.testing.assert_frame_equal(getattr(large, name), getattr(usual, name))
