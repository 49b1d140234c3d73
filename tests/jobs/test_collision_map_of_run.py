"""Collision maps of a run: tracks of a simulated scene, analysed, and given metres."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import ttcvid
from ttcvid.cli.main import main
from ttcvid.config import CollisionMapConfig
from ttcvid.jobs.collision_map.run_collision_map import open_clip_of
from ttcvid.simulate import TrackOptions

SCENES = Path(__file__).parent.parent.parent / "sample_configs" / "scenes"
N_FRAMES, OWN_SPEED_M_S, CAMERA_HEIGHT_M = 24, 11.0, 1.4


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("street")
    tracks = TrackOptions(n_tracks=500, sigma_px=0.1)
    scene = ttcvid.simulate(SCENES / "parked_street.yaml", folder / "scene", tracks=tracks, n_frames=N_FRAMES)
    options = {
        "camera": scene.folder / "camera.yaml",
        "horizon": scene.folder / "horizon.yaml",
        "overlay": False,
        "report": False,
    }
    return ttcvid.analyze(scene.input, folder / "run", platform="vehicle", **options).folder


def test_own_speed_and_camera_height_follow_from_each_other(run: Path):
    by_speed = open_clip_of(run, CollisionMapConfig(ego_speed=f"{OWN_SPEED_M_S}"))
    (note,) = (note for note in by_speed.moment(N_FRAMES - 1).notes if note.startswith("Scale"))
    height = float(note.split("camera ")[1].split(" m")[0])
    assert height == pytest.approx(CAMERA_HEIGHT_M, rel=0.05)
    by_height = open_clip_of(run, CollisionMapConfig(camera_height_m=CAMERA_HEIGHT_M)).moment(N_FRAMES - 1).situation
    assert by_height is not None
    assert np.linalg.norm(by_height.own_velocity_m_s) == pytest.approx(OWN_SPEED_M_S, rel=0.05)


@pytest.mark.parametrize("factor", [3.6, 1.61, 1 / 3.6], ids=["m/s for km/h", "miles for km", "km/h for m/s"])
def test_a_speed_that_the_height_of_the_camera_contradicts_is_refused(
    factor: float, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    words = ["collision-map", str(run), "--ego-speed", f"{factor * OWN_SPEED_M_S}", "-o", str(tmp_path / "map")]
    assert main([*words, "--camera-height-m", f"{CAMERA_HEIGHT_M}"]) == 2
    message = capsys.readouterr().err
    assert f"--ego-speed is {3.6 * factor * OWN_SPEED_M_S:.0f} km/h" in message
    by_height_km_h = float(message.split("goes by at ")[1].split(" km/h")[0])
    assert by_height_km_h == pytest.approx(3.6 * OWN_SPEED_M_S, rel=0.05)
    assert not (tmp_path / "map").exists()


def test_a_speed_that_agrees_with_the_height_of_the_camera_is_taken(run: Path):
    config = CollisionMapConfig(ego_speed=f"{1.2 * OWN_SPEED_M_S}", camera_height_m=CAMERA_HEIGHT_M)
    situation = open_clip_of(run, config).moment(N_FRAMES - 1).situation
    assert situation is not None
    assert np.linalg.norm(situation.own_velocity_m_s) == pytest.approx(1.2 * OWN_SPEED_M_S)


def test_parked_cars_and_trees_are_in_the_way_to_either_side_and_the_road_is_free(run: Path, tmp_path: Path):
    out = tmp_path / "map"
    words = ["collision-map", str(run), "--ego-speed", "39.6km/h", "-o", str(out), "-q", "--frame", str(N_FRAMES - 1)]
    assert main(words) == 0
    table = pd.read_parquet(out / "collision_map.parquet")
    straight_on = table[(table.right_m_s.abs() < 0.01) & (table.forward_m_s < 0)]
    to_the_side = table[(table.right_m_s.abs() > 4.0) & (table.forward_m_s.abs() < 3)]
    assert (straight_on.probability < 0.5).mean() > 0.9
    assert (to_the_side.probability > 0.5).mean() > 0.9
    assert set(to_the_side["name"].dropna()) == {"static scene"}
    evasion = pd.read_parquet(out / "evasion.parquet")
    assert len(evasion) == N_FRAMES
    # What stands still has to be watched for half a second before it is known.
    assert evasion.status.tolist() == ["no_result", *["unknown"] * 10, *["no_danger"] * (N_FRAMES - 11)]
    np.testing.assert_allclose(evasion.own_speed_m_s.iloc[1:], OWN_SPEED_M_S, rtol=0.01)
    assert "notes" in json.loads((out / "manifest.json").read_text())


def test_a_map_without_any_scale_is_refused(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["collision-map", str(run), "-o", str(tmp_path / "map")]) == 2
    assert "a run has no metres: give --ego-speed or --camera-height-m" in capsys.readouterr().err


def test_the_frame_before_any_motion_has_no_map(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["collision-map", str(run), "--ego-speed", "11", "--frame", "0", "-o", str(tmp_path / "map")]) == 2
    assert "frame 0 has no map (no_result)" in capsys.readouterr().err
    assert not (tmp_path / "map").exists()


@pytest.mark.parametrize("widths", ["0", "-1", "x", "3=", "77=2.0"])
def test_widths_that_cannot_be_are_refused(widths: str, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ["collision-map", str(run), "--ego-speed", "11", "--object-width-m", widths, "-o", str(tmp_path / "map")]
    assert main(words) == 2
    assert f"--object-width-m = '{widths}'" in capsys.readouterr().err
