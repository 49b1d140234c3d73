"""calibrate-horizon from input to files: the truth is in the band, what is not known is not invented."""

import json

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml
from matplotlib.figure import Figure

import ttcvid
from ttcvid.calibration import read_horizon
from ttcvid.cli.main import main
from ttcvid.draw.horizon_picture import write_horizon_picture
from ttcvid.errors import OutputError, UndeterminedError, UsageError
from ttcvid.model import ImageSize
from ttcvid.simulate.tracks import TrackOptions
from ttcvid.stages.horizon.whole_tracks import joined

SCENES = "sample_configs/scenes"
SIZE = ImageSize(640, 360)
N_DRIVEN = 22


@pytest.fixture(scope="module")
def resting(tmp_path_factory, request):
    """Tracks of the six movers before a resting camera, and its camera file."""
    folder = tmp_path_factory.mktemp("resting") / "scene"
    ttcvid.simulate(request.config.rootpath / SCENES / "resting_six_movers.yaml", folder, tracks=TrackOptions())
    return folder


@pytest.fixture(scope="module")
def driving(tmp_path_factory, request):
    """Tracks of a drive along a street."""
    folder = tmp_path_factory.mktemp("driving") / "scene"
    scene = request.config.rootpath / SCENES / "swinging_drive.yaml"
    ttcvid.simulate(scene, folder, tracks=TrackOptions(n_tracks=250), n_frames=70)
    return folder


@pytest.fixture(scope="module")
def one_way(tmp_path_factory):
    """Tracks of a street on which all drive one way."""
    bodies = [
        {"name": f"car {k}", "kind": "car", "at_m": [14 + 8 * k, 9, 0], "heading_deg": -30, "speed_m_s": 5 + k}
        for k in range(4)
    ]
    camera = {"image_size": [640, 360], "hfov_deg": 70, "height_m": 3.5, "pitch_deg": 6, "fps": 25, "n_frames": 80}
    scene = {"name": "one way", "camera": camera, "ground": {"kind": "square"}, "bodies": bodies}
    path = tmp_path_factory.mktemp("one_way") / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    ttcvid.simulate(path, path.parent / "scene", tracks=TrackOptions())
    return path.parent / "scene"


@pytest.fixture(scope="module")
def found(resting, tmp_path_factory):
    """What the tracks before the resting camera tell, and a folder with the file and its evidence."""
    folder = tmp_path_factory.mktemp("found") / "new"
    return calibrated(resting, folder / "horizon.yaml", evidence=folder / "look"), folder


def calibrated(folder, out, clip="tracks.parquet", **options):
    return ttcvid.calibrate_horizon(folder / clip, out, camera=folder / "camera.yaml", **options)


def true_line(folder):
    line = yaml.safe_load((folder / "horizon.yaml").read_text())["horizon"]
    return np.array([line["y_left_px"], line["y_right_px"]])


def test_the_truth_is_in_the_band_and_the_files_say_what_they_are_made_of(resting, found):
    done, folder = found
    out, look = folder / "horizon.yaml", folder / "look"
    assert done.exit_code == 0
    content = yaml.safe_load(out.read_text())
    band_px = [content["band_95_px"][side] for side in ("left", "right")]
    line = np.array([content["horizon"]["y_left_px"], content["horizon"]["y_right_px"]])
    assert (np.abs(line - true_line(resting)) < np.maximum(2.0 * np.array(band_px), 1.0)).all()
    assert content["image_size"] == [640, 360]
    assert content["pitch_deg"] == pytest.approx(6.0, abs=0.2)
    assert content["roll_deg"] == pytest.approx(0.0, abs=0.3)
    assert content["n_motions"] >= 4
    assert content["roll_zero"] is False
    assert content["source"].endswith("tracks.parquet")
    assert len(content["source_sha256"]) == 64
    assert content["ttcvid_version"] == ttcvid.__version__
    assert np.shape(content["horizon"]["covariance_rad2"]) == (2, 2)
    assert read_horizon(out, SIZE).covariance_rad2 == done.horizon.covariance_rad2

    motions = pd.read_parquet(look / "motions.parquet")
    assert (motions.status == "used").sum() == content["n_motions"]
    assert (motions.residual_deg.abs() < 4 * motions.sigma_deg)[motions.status == "used"].all()
    assert (look / "horizon.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in look.iterdir()) == ["horizon.png", "motions.parquet"]


def test_the_file_is_written_alone_so_that_several_stand_in_one_folder(one_way, tmp_path):
    for name in ("one.yaml", "other.yaml"):
        done = calibrated(one_way, tmp_path / name, roll_zero=True)
        assert done.files == (tmp_path / name,)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.yaml", "other.yaml"]


def test_title_and_labels_of_the_picture_are_whole(found, tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    done, _ = found
    title = f"{done.summary()}; {'a note that is told beside it; ' * 5}"
    write_horizon_picture(tmp_path / "horizon.png", done.camera, done.result.fit, (), joined([]), None, title)
    (figure,) = figures
    figure.draw_without_rendering()
    drawn, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert min(drawn.x0, drawn.y0) >= 0
    assert drawn.x1 <= width
    assert drawn.y1 <= height
    assert figure.axes[0].get_title().split() == title.split()


@pytest.mark.slow
def test_rendered_pictures_give_the_line_within_its_band(request, tmp_path):
    scene = yaml.safe_load((request.config.rootpath / SCENES / "resting_six_movers.yaml").read_text())
    scene["camera"] |= {"fps": 10, "image_size": [480, 270]}
    scene["bodies"] = [body for body in scene["bodies"] if body["kind"] not in ("tree", "post", "house")]
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    ttcvid.simulate(tmp_path / "scene.yaml", tmp_path / "scene", n_frames=18)
    done = calibrated(tmp_path / "scene", tmp_path / "horizon.yaml", clip="clip.mp4")
    content = yaml.safe_load((tmp_path / "horizon.yaml").read_text())
    error_px = np.array([done.horizon.y_left_px, done.horizon.y_right_px]) - true_line(tmp_path / "scene")
    assert abs(error_px.mean()) < 2.25
    assert abs(error_px.mean()) < content["band_95_px"]["centre"] < 7.5


def test_two_runs_write_the_same_bytes(resting, found, tmp_path):
    calibrated(resting, tmp_path / "horizon.yaml", evidence=tmp_path / "look")
    for name in ("horizon.yaml", "look/motions.parquet"):
        assert (tmp_path / name).read_bytes() == (found[1] / name).read_bytes()


def test_motions_in_one_direction_are_undetermined_and_leave_no_file(one_way, tmp_path, capsys):
    out = tmp_path / "horizon.yaml"
    arguments = [str(one_way / "tracks.parquet"), "--camera", str(one_way / "camera.yaml"), "-o", str(out)]
    assert main(["calibrate-horizon", *arguments]) == 5
    assert capsys.readouterr().out.startswith("undetermined: ")
    assert not any(tmp_path.iterdir())
    assert main(["calibrate-horizon", *arguments, "--json"]) == 5
    said = json.loads(capsys.readouterr().out)
    assert (said["state"], said["exit_code"], said["files"]) == ("undetermined", 5, [])


def test_with_roll_zero_one_direction_is_enough_and_the_file_says_so(one_way, tmp_path):
    done = calibrated(one_way, tmp_path / "horizon.yaml", roll_zero=True)
    assert yaml.safe_load((tmp_path / "horizon.yaml").read_text())["roll_zero"] is True
    line = np.array([done.horizon.y_left_px, done.horizon.y_right_px])
    np.testing.assert_allclose(line, true_line(one_way), atol=6.0)


def test_several_clips_of_one_camera_count_together(resting, one_way, tmp_path):
    clips = [folder / "tracks.parquet" for folder in (one_way, resting)]
    ttcvid.calibrate_horizon(clips, tmp_path / "horizon.yaml", camera=resting / "camera.yaml", evidence=tmp_path)
    content = yaml.safe_load((tmp_path / "horizon.yaml").read_text())
    assert len(content["source"]) == len(content["source_sha256"]) == 2
    assert set(pd.read_parquet(tmp_path / "motions.parquet")["clip"]) == {0, 1}


def test_a_driving_camera_does_not_rest_and_moving_tells_its_horizon(driving, tmp_path):
    out = tmp_path / "horizon.yaml"
    done = calibrated(driving, out)
    assert done.horizon is None
    assert "does not rest" in done.reason
    assert "--moving" in done.reason
    assert not out.exists()
    done = calibrated(driving, out, moving=True)
    middle_px = 0.5 * (done.horizon.y_left_px + done.horizon.y_right_px)
    assert middle_px == pytest.approx(true_line(driving).mean(), abs=6.0)


def test_analyze_finds_the_horizon_by_itself(resting, one_way, tmp_path):
    options = {"platform": "static", "overlay": False, "report": False, "horizon": "auto", "end": 40}
    run = ttcvid.analyze(resting / "tracks.parquet", tmp_path / "run", camera=resting / "camera.yaml", **options)
    horizon = run.manifest["horizon"]
    assert horizon["origin"].startswith("auto: ")
    np.testing.assert_allclose([horizon["y_left_px"], horizon["y_right_px"]], true_line(resting), atol=3.0)
    assert run.epipoles.horizon_offset_px.notna().any()
    assert not [warning for warning in run.manifest["warnings"] if "horizon" in warning]
    with pytest.raises(UndeterminedError, match="--horizon auto"):
        ttcvid.analyze(one_way / "tracks.parquet", tmp_path / "none", camera=one_way / "camera.yaml", **options)
    assert not (tmp_path / "none").exists()


def test_a_horizon_of_the_clip_itself_fits_it_and_one_that_is_off_is_told(resting, found, tmp_path):
    content = yaml.safe_load((found[1] / "horizon.yaml").read_text())
    content["horizon"] |= {side: content["horizon"][side] - 60 for side in ("y_left_px", "y_right_px")}
    (tmp_path / "off.yaml").write_text(yaml.safe_dump(content))
    complaints = []
    for horizon in (found[1] / "horizon.yaml", tmp_path / "off.yaml"):
        options = {"platform": "static", "overlay": False, "report": False, "horizon": horizon, "end": 20}
        out, camera = tmp_path / horizon.stem, resting / "camera.yaml"
        run = ttcvid.analyze(resting / "tracks.parquet", out, camera=camera, **options)
        complaints.append([warning for warning in run.manifest["warnings"] if "the horizon" in warning])
    assert complaints[0] == []
    (complaint,) = complaints[1]
    assert "movers lie" in complaint
    assert "below the horizon: the calibration no longer fits" in complaint


def test_what_exists_is_kept(resting, tmp_path):
    (tmp_path / "motions.parquet").write_text("mine")
    with pytest.raises(OutputError, match=r"motions\.parquet: exists already"):
        calibrated(resting, tmp_path / "horizon.yaml", evidence=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["motions.parquet"]


def test_clips_of_different_sizes_are_refused(tmp_path):
    for name, side in (("small", 32), ("large", 64)):
        (tmp_path / name).mkdir()
        for k in range(3):
            picture = np.random.default_rng(k).integers(0, 255, (side, side), dtype=np.uint8)
            cv2.imwrite(str(tmp_path / name / f"{k}.png"), picture)
    with pytest.raises(UsageError, match=r"pictures of 64x64, but 32x32 in .*small"):
        ttcvid.calibrate_horizon([tmp_path / "small", tmp_path / "large"], tmp_path / "horizon.yaml", fps=10.0)
    with pytest.raises(UsageError, match="at least one"):
        ttcvid.calibrate_horizon([], tmp_path / "horizon.yaml")


def test_a_clip_in_which_nothing_moves_is_undetermined(tmp_path):
    grid = np.stack(np.meshgrid(np.arange(20, 620, 40), np.arange(20, 340, 40)), axis=-1).reshape(-1, 2)
    rng, frames = np.random.default_rng(1), []
    for k in range(30):
        x_px, y_px = (grid + 0.1 * rng.standard_normal(grid.shape)).T
        columns = {"frame": k, "t_s": 0.04 * k, "track_id": range(len(grid)), "x_px": x_px, "y_px": y_px}
        frames.append(pd.DataFrame(columns))
    pd.concat(frames).to_csv(tmp_path / "tracks.csv", index=False)
    done = ttcvid.calibrate_horizon(tmp_path / "tracks.csv", tmp_path / "horizon.yaml", image_size="640x360")
    assert done.reason.startswith("0 straight motions found of 0")


@pytest.mark.data
@pytest.mark.slow
def test_the_row_of_the_epipole_of_a_real_drive(data_dir, tmp_path):
    clip = data_dir / "kitti_odom_straight50"
    done = ttcvid.calibrate_horizon(
        clip / "image_0", tmp_path / "horizon.yaml", camera=clip / "calib.txt", fps=10.0, moving=True, end=N_DRIVEN
    )
    truth = pd.read_csv(clip / "foe_truth.csv", comment="#")[:N_DRIVEN]
    assert 0.5 * (done.horizon.y_left_px + done.horizon.y_right_px) == pytest.approx(truth.foe_v.median(), abs=8.0)
