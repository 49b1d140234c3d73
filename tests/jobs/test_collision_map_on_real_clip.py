"""A collision map of a real drive: a car that rolls behind others towards a red light, at 9 km/h."""

import numpy as np
import pandas as pd
import pytest

import ttcvid

N_FRAMES = 34
"""Until then the driver only rolls; afterwards he brakes to a stop."""


@pytest.fixture(scope="module")
def evasion(data_dir, tmp_path_factory):
    folder, clip = tmp_path_factory.mktemp("creeping"), data_dir / "kitti_sfnd_ttc"
    options = {"camera": clip / "calib.txt", "fps": 9.6525, "end": f"{N_FRAMES}", "platform": "vehicle"}
    run = ttcvid.analyze(clip / "image_02", folder / "run", overlay=False, report=False, **options)
    ttcvid.collision_map(run.folder, folder / "map", camera_height_m=1.65)
    return pd.read_parquet(folder / "map" / "evasion.parquet")


@pytest.mark.slow
def test_who_rolls_behind_others_gets_no_advice(evasion):
    assert not set(evasion.status) & {"advice", "no_escape"}
    assert (evasion.status == "no_danger").sum() > 0.6 * N_FRAMES


@pytest.mark.slow
def test_metres_of_a_real_drive_are_those_of_a_car(evasion):
    """The camera is 1.65 m over the road; the car rolls at 2.4 m/s and slows down to about 1 m/s."""
    speed_m_s = evasion.own_speed_m_s.dropna()
    assert 0.8 < speed_m_s.min() <= speed_m_s.max() < 3.5
    assert np.median(np.abs(np.diff(speed_m_s))) < 0.2
