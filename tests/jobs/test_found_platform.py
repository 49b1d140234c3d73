"""``--platform auto``: the clip tells what carries the camera, and every output says so."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import ttcvid
from ttcvid.cli.main import main
from ttcvid.jobs.batch.same_run import finished_run
from ttcvid.jobs.compare.compare_runs import compare
from ttcvid.jobs.settings.configuration import configure_from_arguments

N_FRAMES = 60


@pytest.fixture(scope="module")
def tracks(tmp_path_factory) -> Callable[[float], Path]:
    """Tracks of a street that goes by at a speed in m/s, at 10 frames/s."""
    folder = tmp_path_factory.mktemp("tracks")
    return cache(lambda speed_m_s: write_tracks(folder / f"{speed_m_s}.parquet", speed_m_s))


@pytest.fixture(scope="module")
def told_run(tracks, tmp_path_factory) -> ttcvid.Run:
    """The street at 12 m/s, its beginning analysed."""
    return analyzed(tracks(12.0), tmp_path_factory.mktemp("told") / "run", end=10)


def write_tracks(path: Path, speed_m_s: float) -> Path:
    rng = np.random.default_rng(1)
    x_m, y_m = rng.uniform(-9, 9, 900), rng.choice([1.5, 1.5, -1.0, -3.0], 900)
    z_m = rng.uniform(4, 10 + 0.1 * N_FRAMES * speed_m_s + 30, 900)
    parts = []
    for frame in range(N_FRAMES):
        depth_m = z_m - 0.1 * frame * speed_m_s
        x_px, y_px = (500 * m / depth_m + c + 0.1 * rng.standard_normal(900) for m, c in ((x_m, 319.5), (y_m, 179.5)))
        rows = pd.DataFrame({"frame": frame, "t_s": 0.1 * frame, "track_id": range(900), "x_px": x_px, "y_px": y_px})
        parts.append(rows[(depth_m > 1) & rows.x_px.between(0, 639) & rows.y_px.between(0, 359)])
    pd.concat(parts).to_parquet(path)
    return path


def analyzed(table: Path, out: Path, **options: object) -> ttcvid.Run:
    return ttcvid.analyze(table, out, image_size="640x360", focal_px=500.0, overlay=False, report=False, **options)


@pytest.mark.parametrize(("speed_m_s", "platform", "status"), [(12.0, "vehicle", "ok"), (0.0, "static", "static")])
def test_every_output_says_what_the_clip_tells(speed_m_s, platform, status, tracks, told_run, tmp_path):
    run = analyzed(tracks(0.0), tmp_path / "run", end=12) if speed_m_s == 0 else told_run
    told = run.manifest["platform"]
    assert (told["value"], told["is_told_by_clip"]) == (platform, True)
    assert len(told["glances"]) >= 5
    assert run.manifest["configuration"]["egomotion"]["platform"] == {"value": platform, "origin": "told by the clip"}
    assert f"platform {platform} TOLD BY THE CLIP ({told['reason']})" in run.summary()
    assert pq.read_schema(run.folder / "frames.parquet").metadata[b"platform"] == platform.encode()
    assert run.frames.status.iloc[-1] == status


def test_the_clip_tells_the_same_whatever_part_of_it_is_analysed(tracks, told_run, tmp_path):
    later = analyzed(tracks(12.0), tmp_path / "run", start=40, end=45)
    assert later.frames.frame.tolist() == list(range(40, 45))
    assert later.manifest["platform"] == told_run.manifest["platform"]


def test_a_result_whose_platform_was_told_is_that_of_the_same_configuration(tracks, told_run):
    options = {"image_size": "640x360", "focal_px": 500.0, "overlay": False, "report": False, "end": 10}
    for platform, is_same in (("auto", True), ("vehicle", False)):
        asked = configure_from_arguments({**options, "platform": platform})
        assert (finished_run(told_run.folder, str(tracks(12.0)), asked) is not None) == is_same


def test_a_platform_that_is_given_is_not_looked_for(tracks, tmp_path, capsys):
    given = ["--platform", "free", "--image-size", "640x360", "--focal-px", "500", "--no-overlay", "--end", "4"]
    assert main(["analyze", str(tracks(12.0)), *given, "-o", str(tmp_path / "run")]) == 0
    assert "TOLD BY THE CLIP" not in capsys.readouterr().out
    run = ttcvid.Run.open(tmp_path / "run")
    assert run.manifest["platform"] == {"value": "free", "is_told_by_clip": False, "reason": "given", "glances": []}


def test_what_is_told_gives_the_results_of_the_platform_given(tracks, told_run, tmp_path):
    given = analyzed(tracks(12.0), tmp_path / "run", end=10, platform="vehicle")
    for name in ("frames", "clusters", "collision_times"):
        pd.testing.assert_frame_equal(getattr(told_run, name), getattr(given, name))
    assert compare(told_run, given).is_same
