"""Own speed as users give it."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ttcvid.errors import InputError, UsageError
from ttcvid.jobs.collision_map.ego_speed import ego_speed_m_s

FRAME, T_S = np.array([4, 5, 6]), np.array([0.4, 0.5, 0.6])


@pytest.mark.parametrize(("text", "speed"), [("13.9", 13.9), ("13.9m/s", 13.9), ("50 km/h", 50 / 3.6), ("0", 0.0)])
def test_a_number_with_or_without_a_unit(text: str, speed: float):
    np.testing.assert_allclose(ego_speed_m_s(text, FRAME, T_S), np.full(3, speed))


def test_a_column_by_frame(tmp_path: Path):
    path = tmp_path / "speed.csv"
    pd.DataFrame({"frame": [3, 4, 5, 6], "speed_km_h": [0.0, 36.0, 72.0, 108.0]}).to_csv(path, index=False)
    np.testing.assert_allclose(ego_speed_m_s(f"{path}:speed_km_h", FRAME, T_S), [10.0, 20.0, 30.0])


def test_a_column_by_time_is_read_between_its_times(tmp_path: Path):
    path = tmp_path / "speed.parquet"
    pd.DataFrame({"t_s": [0.2, 0.6], "v_m_s": [4.0, 8.0]}).to_parquet(path)
    np.testing.assert_allclose(ego_speed_m_s(f"{path}:v_m_s", FRAME, T_S), [6.0, 7.0, 8.0])


@pytest.mark.parametrize("text", ["fast", "-3", "50mph", "speed.csv:", ":v_m_s", "speed.csv:speed"])
def test_anything_else_is_refused(text: str):
    with pytest.raises(UsageError, match="expected"):
        ego_speed_m_s(text, FRAME, T_S)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("frame,v_m_s\n4,1\n5,2\n", "no row of frame 6"),
        ("frame,w_m_s\n4,1\n", "has no column 'v_m_s'"),
        ("v_m_s\n4\n", "neither 'frame' nor 't_s'"),
        ("frame,v_m_s\n4,1\n5,x\n6,1\n", "v_m_s = x in row 1"),
        ("frame,v_m_s\n4,1\n5,-2\n6,1\n", "v_m_s = -2 in row 1"),
        ("t_s,v_m_s\n5,1\n6,1\n", "does not reach from 0.40 to 0.60 s"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(content: str, complaint: str, tmp_path: Path):
    path = tmp_path / "speed.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=complaint):
        ego_speed_m_s(f"{path}:v_m_s", FRAME, T_S)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="cannot be read as a table"):
        ego_speed_m_s(f"{tmp_path / 'none.csv'}:v_m_s", FRAME, T_S)
