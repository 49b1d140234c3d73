"""Own speed as a user gives it: a number with its unit, or a column of a table."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ttcvid.errors import InputError, UsageError
from ttcvid.model import Floats, Ints
from ttcvid.plain_files import open_plain

_NUMBER = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(m/s|km/h)?")
_KM_H = 3.6
_EXPECTED = "expected 13.9 or 13.9m/s, 50km/h, or FILE:COLUMN of a table"


def ego_speed_m_s(text: str, frame: Ints, t_s: Floats) -> Floats:
    """Own speed in m/s ``(N,)`` at the frames ``frame, t_s (N,)`` of a run.

    Raises
    ------
    UsageError
        The text is none of what is expected, or the column's name does not end in a unit.
    InputError
        The table cannot be read, lacks a column, or does not reach over the run.
    """
    match = _NUMBER.fullmatch(text.strip())
    if match is not None:
        return np.full(len(frame), float(match[1]) / (_KM_H if match[2] == "km/h" else 1.0))
    file, colon, column = text.rpartition(":")
    if not (colon and file and column):
        raise UsageError(f"--ego-speed = {text!r}: {_EXPECTED}")
    factor = 1.0 if column.endswith("_m_s") else 1.0 / _KM_H if column.endswith("_km_h") else None
    if factor is None:
        raise UsageError(f"--ego-speed = {text!r}: column {column!r} tells no unit: expected ..._m_s or ..._km_h")
    table = _read(Path(file), column)
    return np.asarray(factor * _at_frames(Path(file), table, column, frame, t_s))


def _read(path: Path, column: str) -> pd.DataFrame:
    try:
        with open_plain(path) as file:
            table = pd.read_csv(file) if path.suffix == ".csv" else pq.read_table(file).to_pandas()
    except (OSError, ValueError, pa.ArrowInvalid) as error:
        raise InputError(
            f"{path}: cannot be read as a table ({' '.join(str(error).split())}): give CSV or Parquet"
        ) from None
    if column not in table:
        raise InputError(f"{path}: has no column {column!r}: it has {', '.join(map(str, table.columns))}")
    if "frame" not in table and "t_s" not in table:
        raise InputError(f"{path}: has neither 'frame' nor 't_s': expected one, to know where a speed belongs")
    values = pd.to_numeric(table[column], errors="coerce")
    if values.isna().any() or (values < 0).any():
        row = int((values.isna() | (values < 0)).to_numpy().argmax())
        raise InputError(f"{path}: {column} = {table[column].iloc[row]} in row {row}: expected numbers >= 0")
    return table.assign(**{column: values.astype(float)})


def _at_frames(path: Path, table: pd.DataFrame, column: str, frame: Ints, t_s: Floats) -> Floats:
    """The column at the frames: by number where there is one, else between the nearest times."""
    if "frame" in table:
        by_frame = table.drop_duplicates("frame").set_index("frame")[column]
        missing = sorted(set(frame.tolist()) - set(by_frame.index.tolist()))
        if missing:
            raise InputError(f"{path}: has no row of frame {missing[0]}: expected one for each frame of the run")
        return np.asarray(by_frame.loc[frame.tolist()], dtype=float)
    ordered = table.sort_values("t_s")
    times = ordered["t_s"].to_numpy(float)
    step_s = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    if len(times) == 0 or t_s[0] < times[0] - step_s or t_s[-1] > times[-1] + step_s:
        raise InputError(f"{path}: does not reach from {t_s[0]:.2f} to {t_s[-1]:.2f} s: expected the whole run")
    return np.asarray(np.interp(t_s, times, ordered[column].to_numpy(float)))
