"""A clip without a camera: the focal length that it tells is used, and every output says so."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from turning_camera import PAN_AND_STEP, SIZE, STRAIGHT, Drive, seen_points

import ttcvid
from ttcvid.cli.main import main
from ttcvid.schema import TABLE_NAMES

FOCAL_PX = 450.0


@pytest.fixture(autouse=True)
def work_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_tracks(path: Path, drive: Drive) -> Path:
    seen = seen_points(drive, FOCAL_PX, sigma_px=0.1)
    tables = [pd.DataFrame(one.points.xy_px, columns=["x_px", "y_px"]) for one in seen]
    rows = [
        table.assign(frame=frame, t_s=one.t_s, track_id=one.points.track_id)
        for frame, (table, one) in enumerate(zip(tables, seen, strict=True))
    ]
    pd.concat(rows).to_parquet(path)
    return path


@pytest.fixture(scope="module")
def turning(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_tracks(tmp_path_factory.mktemp("tracks") / "turning.parquet", PAN_AND_STEP))


def test_a_found_focal_length_is_said_everywhere_and_found_again(
    turning: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["analyze", turning, "--image-size", str(SIZE)]) == 0
    printed = capsys.readouterr()
    assert "focal length FOUND in the clip" in printed.out
    assert "ASSUMED" not in printed.out
    assert "focal length was found in the clip" in printed.err
    run = ttcvid.Run.open("turning_ttc")
    camera = run.manifest["camera"]
    assert camera["origin"] == "found"
    assert camera["is_assumed"] is False
    assert abs(np.log(camera["fx_px"] / FOCAL_PX)) < 3.0 * camera["focal_sigma_px"] / camera["fx_px"] < 0.2
    assert camera["fx_px"] == camera["fy_px"]
    assert "found in the clip" in run.manifest["warnings"][0]
    assert json.loads(run.summary_json())["camera"]["focal_sigma_px"] == camera["focal_sigma_px"]
    for name in TABLE_NAMES:
        metadata = pq.read_schema(run.folder / f"{name}.parquet").metadata
        assert metadata[b"camera_origin"] == b"found"
        assert metadata[b"camera_is_assumed"] == b"false"
        assert float(metadata[b"camera_fx_px"]) == camera["fx_px"]
        assert float(metadata[b"camera_fx_sigma_px"]) == camera["focal_sigma_px"]
    again = ttcvid.analyze(turning, "again", image_size=str(SIZE), overlay=False, report=False)
    assert again.manifest["camera"] == camera


@pytest.mark.parametrize(
    ("options", "origin"),
    [({"focal_px": 600.0}, "focal_px"), ({"hfov": 55.0}, "hfov_deg"), ({"platform": "static"}, "assumed")],
)
def test_nothing_is_looked_for_where_the_camera_is_given_or_rests(turning: str, options: dict, origin: str) -> None:
    run = ttcvid.analyze(turning, "run", image_size=str(SIZE), overlay=False, report=False, **options)
    assert run.manifest["camera"]["origin"] == origin
    assert run.manifest["camera"]["focal_sigma_px"] is None


def test_a_straight_drive_keeps_the_assumed_focal_length(work_folder: Path) -> None:
    tracks = write_tracks(work_folder / "straight.parquet", STRAIGHT)
    run = ttcvid.analyze(tracks, "run", image_size=str(SIZE), overlay=False, report=False)
    assert run.manifest["camera"]["is_assumed"] is True


def test_only_the_selected_frames_are_looked_at(turning: str) -> None:
    """Of three pictures nothing can be told."""
    run = ttcvid.analyze(turning, "run", image_size=str(SIZE), overlay=False, report=False, end="3")
    assert run.manifest["camera"]["is_assumed"] is True
