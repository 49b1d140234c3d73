"""`ttcvid simulate`: what it writes, what it refuses."""

import json

import av
import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from click.testing import CliRunner

from ttcvid.cli.simulate import simulate
from ttcvid.errors import OutputError
from ttcvid.simulate import SKY_LABEL

SCENE = {
    "name": "small",
    "camera": {"image_size": [160, 90], "hfov_deg": 60, "pitch_deg": 3, "times_s": [0, 0.04, 0.1, 0.15]},
    "own_motion": {"speed_m_s": 8, "yaw_rate_deg_s": 5},
    "ground": {"kind": "none"},
    "bodies": [
        {"name": "wall", "kind": "wall", "at_m": [25, 0, 0], "size_m": [0.3, 12, 2.5]},
        {"name": "car", "kind": "car", "at_m": [14, 1, 0], "heading_deg": 180, "speed_m_s": 6},
    ],
}


@pytest.fixture
def scene_file(tmp_path):
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump(SCENE))
    return path


def run(*arguments):
    return CliRunner().invoke(simulate, [str(argument) for argument in arguments], catch_exceptions=False)


def test_folder_holds_clip_calibration_and_truth(scene_file, tmp_path):
    out = tmp_path / "out"
    summary = json.loads(run(scene_file, "-o", out, "--json").output)
    assert (summary["n_frames"], summary["n_objects"], summary["input"]) == (4, 1, str(out / "clip.mp4"))
    names = {path.name for path in out.iterdir()}
    tables = {f"truth_{name}.parquet" for name in ("objects", "frames", "encounters")}
    assert names == {"clip.mp4", "camera.yaml", "horizon.yaml", "scene.yaml", "truth_labels", *tables}
    with av.open(str(out / "clip.mp4")) as clip:
        times = [float(frame.pts * frame.time_base) for frame in clip.decode(video=0)]
    truth = pq.read_table(out / "truth_frames.parquet")
    np.testing.assert_allclose(truth["t_s"].to_numpy(), times, rtol=0, atol=1e-12)
    assert truth["rot_y_rad"].to_pylist()[0] is None
    turned = np.linalg.norm([truth[f"rot_{axis}_rad"].to_pylist()[2] for axis in "xyz"])
    assert turned == pytest.approx(np.radians(5) * 0.06, rel=1e-9)
    assert truth.schema.field("vz_m_s").metadata[b"unit"] == b"m/s"
    objects = pq.read_table(out / "truth_objects.parquet").to_pylist()
    assert [row["frame"] for row in objects] == [0, 1, 2, 3]
    assert objects[0]["name"] == "car"
    assert objects[0]["ttc_z_s"] == pytest.approx(objects[0]["z_m"] / -objects[0]["vz_m_s"], rel=1e-12)
    labels = cv2.imread(str(out / "truth_labels" / "000003.png"), cv2.IMREAD_UNCHANGED)
    assert (labels.dtype, labels.shape) == (np.uint16, (90, 160))
    assert set(np.unique(labels)) == {0, 1, SKY_LABEL}


def test_calibration_files_describe_the_camera(scene_file, tmp_path):
    run(scene_file, "-o", tmp_path / "out", "--frames", 1)
    camera = yaml.safe_load((tmp_path / "out" / "camera.yaml").read_text())
    focal = 80 / np.tan(np.radians(30))
    assert camera["image_size"] == [160, 90]
    assert camera["fx_px"] == camera["fy_px"] == pytest.approx(focal)
    assert (camera["cx_px"], camera["cy_px"]) == (79.5, 44.5)
    assert (camera["distortion_model"], camera["distortion"]) == ("none", [])
    horizon = yaml.safe_load((tmp_path / "out" / "horizon.yaml").read_text())
    assert horizon["horizon"]["y_left_px"] == pytest.approx(44.5 - focal * np.tan(np.radians(3)))


def test_png_pictures_are_free_of_loss_and_have_their_times(scene_file, tmp_path):
    out = tmp_path / "out"
    run(scene_file, "-o", out, "--png")
    assert sorted(path.name for path in (out / "frames").iterdir()) == [f"{k:06d}.png" for k in range(4)]
    times = [float(line) for line in (out / "timestamps.txt").read_text().split()]
    np.testing.assert_allclose(times, [0, 0.04, 0.1, 0.15], atol=1e-8)
    run(scene_file, "-o", tmp_path / "again", "--png")
    assert (out / "frames" / "000002.png").read_bytes() == (tmp_path / "again" / "frames" / "000002.png").read_bytes()


def test_clip_is_the_pictures_but_for_a_little_loss(scene_file, tmp_path):
    run(scene_file, "-o", tmp_path / "clip")
    run(scene_file, "-o", tmp_path / "png", "--png")
    with av.open(str(tmp_path / "clip" / "clip.mp4")) as clip:
        decoded = [frame.to_ndarray(format="gray").astype(float) for frame in clip.decode(video=0)]
    exact = cv2.cvtColor(cv2.imread(str(tmp_path / "png" / "frames" / "000003.png")), cv2.COLOR_BGR2GRAY).astype(float)
    assert np.abs(decoded[3] - exact).mean() < 2.5


def test_tracks_come_with_their_truth(scene_file, tmp_path):
    out = tmp_path / "out"
    output = run(scene_file, "-o", out, "--tracks", "--n-tracks", 50, "--sigma-px", 0).output
    assert "observations of tracks" in output
    tracks, truth = (pq.read_table(out / f"{name}.parquet") for name in ("tracks", "truth_tracks"))
    assert tracks.column_names == ["frame", "t_s", "track_id", "x_px", "y_px"]
    np.testing.assert_array_equal(tracks["x_px"].to_numpy(), truth["x_true_px"].to_numpy())
    assert set(truth["object_id"].to_pylist()) == {0, 1}
    assert not (out / "clip.mp4").exists()


def test_existing_folder_is_kept_unless_overwrite_is_given(scene_file, tmp_path):
    out = tmp_path / "out"
    run(scene_file, "-o", out, "--tracks")
    with pytest.raises(OutputError, match="--overwrite"):
        run(scene_file, "-o", out, "--tracks")
    run(scene_file, "-o", out, "--frames", 1, "--overwrite")
    assert (out / "clip.mp4").exists()
    assert not (out / "tracks.parquet").exists()
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_folder_of_other_things_is_never_overwritten(scene_file, tmp_path):
    precious = tmp_path / "photos"
    precious.mkdir()
    (precious / "a.jpg").write_text("x")
    with pytest.raises(OutputError, match="no folder of a simulation"):
        run(scene_file, "-o", precious, "--overwrite")
    assert (precious / "a.jpg").exists()


def test_failure_leaves_nothing_behind(scene_file, tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("ttcvid.jobs.simulate._write_pictures", fail)
    with pytest.raises(OutputError, match="disk is full"):
        run(scene_file, "-o", tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.yaml"]
