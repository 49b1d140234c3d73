"""Equal input, configuration and version give equal bytes, however and wherever the analysis is run."""

import functools
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from moving_clips import approach, swaying, write_clip

import ttcvid
from ttcvid.jobs.processes.side_by_side import map_ahead
from ttcvid.schema import TABLE_NAMES

REPOSITORY = Path(__file__).resolve().parents[2]
N_FRAMES = 10
TRACKERS = ("klt", "akaze")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("clip") / "clip.mp4", approach(N_FRAMES))


def tables_of(folder: Path) -> dict[str, bytes]:
    return {name: (folder / f"{name}.parquet").read_bytes() for name in TABLE_NAMES}


@pytest.fixture(scope="module")
def expected(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, bytes]]:
    """Tables by tracker, made with one worker, and the geometry in a thread."""
    out = tmp_path_factory.mktemp("expected")
    options = {"focal_px": 200, "overlay": False, "report": False}
    with pytest.MonkeyPatch.context() as patch:
        set_workers(patch, 1)
        return {name: tables_of(ttcvid.analyze(clip, out / name, tracker=name, **options).folder) for name in TRACKERS}


def set_workers(patch: pytest.MonkeyPatch, workers: int) -> None:
    patch.setattr(
        "ttcvid.jobs.analyze.run_analysis.map_ahead", functools.partial(map_ahead, workers=workers, ahead=2 * workers)
    )


@pytest.mark.usefixtures("geometry_in_a_process")
@pytest.mark.parametrize("tracker", TRACKERS)
def test_tables_do_not_depend_on_the_number_of_workers(clip, tracker, expected, tmp_path, monkeypatch):
    set_workers(monkeypatch, 3)
    run = ttcvid.analyze(clip, tmp_path / "run", tracker=tracker, focal_px=200, overlay=False, report=False)
    assert run.overlay is None
    assert tables_of(run.folder) == expected[tracker]


@pytest.mark.usefixtures("geometry_in_a_process")
@pytest.mark.parametrize("tracker", TRACKERS)
def test_tables_do_not_depend_on_the_overlay_or_the_threads_of_opencv(clip, tracker, expected, tmp_path):
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        run = ttcvid.analyze(clip, tmp_path / "run", tracker=tracker, focal_px=200, overlay=True, report=False)
    finally:
        cv2.setNumThreads(before)
    assert tables_of(run.folder) == expected[tracker]


@pytest.mark.slow
def test_tables_do_not_depend_on_threads_hashes_or_place_of_the_process(clip, expected, tmp_path):
    threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    environment = {**os.environ, **dict.fromkeys(threads, "2"), "PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo"}
    environment["PYTHONPATH"] = str(REPOSITORY)
    words = ["analyze", str(clip), "--focal-px", "200", "--no-overlay", "--no-report", "-q"]
    calls = [[*words, "--tracker", tracker, "-o", tracker] for tracker in TRACKERS]
    command = f"from ttcvid.cli.main import main\nfor words in {calls!r}: assert main(words) == 0"
    subprocess.run([sys.executable, "-c", command], cwd=tmp_path, env=environment, check=True, capture_output=True)
    assert {tracker: tables_of(tmp_path / tracker) for tracker in TRACKERS} == expected


def test_a_start_in_frames_and_in_seconds_gives_the_same_tables(clip, tmp_path):
    runs = [
        ttcvid.analyze(clip, tmp_path / f"run{k}", start=start, focal_px=200, overlay=False, report=False)
        for k, start in enumerate((6, "0.6s", "00:00:00.6"))
    ]
    first = tables_of(runs[0].folder)
    assert all(tables_of(run.folder) == first for run in runs[1:])
    assert runs[0].frames.frame.tolist() == list(range(6, N_FRAMES))


def test_a_later_start_gives_the_same_rotations_within_their_sigmas(tmp_path):
    clip = write_clip(tmp_path / "clip.mp4", swaying(32))
    whole, later = (
        ttcvid.analyze(
            clip, tmp_path / f"from{start}", start=start, focal_px=200, overlay=False, report=False
        ).frames.set_index("frame")
        for start in (0, 10)
    )
    settled = whole.index[22:]
    columns = ["rot_x_rad", "rot_y_rad", "rot_z_rad"]
    difference = (later.loc[settled, columns] - whole.loc[settled, columns]).to_numpy(float)
    sigma = whole.loc[settled, "rot_sigma_rad"].to_numpy(float)
    assert np.isfinite(difference).all()
    assert np.median(np.abs(difference).max(axis=1) / sigma) < 2
