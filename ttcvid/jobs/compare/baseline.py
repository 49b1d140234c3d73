"""Baselines: thinned results as text files of some kilobytes that people can read and versions can be compared of."""

from __future__ import annotations

import io
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import yaml

from ttcvid.errors import NotComparableError, quoted
from ttcvid.jobs.compare.result_tables import in_ordinary_types
from ttcvid.plain_files import read_plain
from ttcvid.schema import SCHEMA_VERSION, TABLES
from ttcvid.sinks.failures import output_errors
from ttcvid.sinks.whole_text import write_whole
from ttcvid.strict_yaml import MAX_BYTES, StrictYamlError, load_yaml
from ttcvid.studies.compare.results import Results
from ttcvid.studies.compare.thinned import COLUMNS

FORMAT = "ttcvid-baseline"
HEAD = "# A baseline, written by 'ttcvid regress --update'. To hold a run against it: ttcvid compare THIS_FILE RUN\n"
END = "..."
"""The last line: YAML's end of a document. A file cut off anywhere, also behind a whole row, has none."""
REMEDY = "write it again with 'ttcvid regress --update'"
TICKS = 20
"""Parts of a frame interval: times of frames that are not in the tables are kept to one of them."""
STEP_FRAMES = 30
"""The frame interval is measured over this many frames: containers round single times."""
DECIMALS_S = 6
"""Times of frames, in s, are kept to this many decimals; other numbers to five digits, variances to three."""


def baseline_text(results: Results) -> str:
    """The file of a thinned result: how it was made, the times of all frames, and the rows of each table."""
    content = {
        "format": FORMAT,
        "schema_version": SCHEMA_VERSION,
        "facts": dict(results.facts),
        "clock": _clock_as_text(results.clock),
        "tables": {name: _Block(_as_csv(results.tables[name][list(COLUMNS[name])])) for name in COLUMNS},
    }
    return HEAD + yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=120, allow_unicode=True, explicit_end=True)


def write_baseline(path: Path, text: str) -> None:
    """Write the file, so that it is either whole or as before; OutputError where that cannot be done."""
    with output_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text)


def read_baseline(path: Path) -> Results:
    """The result in a baseline file; NotComparableError with the reason where it is none, or not whole."""
    if not path.exists():
        raise NotComparableError(f"{path}: there is no such baseline yet: write it with 'ttcvid regress --update'")
    try:
        text = read_plain(path, MAX_BYTES).decode()
        content = load_yaml(text)
    except (OSError, UnicodeDecodeError, StrictYamlError) as error:
        reason = " ".join(str(error).split())
        place = error.place if isinstance(error, StrictYamlError) else ""
        raise NotComparableError(f"{path}{place}: cannot be read as a baseline ({reason}): {REMEDY}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise NotComparableError(f"{path}: is no baseline (field 'format' is not {FORMAT!r}): {REMEDY}")
    if content.get("schema_version") != SCHEMA_VERSION:
        found = quoted(content.get("schema_version"))
        raise NotComparableError(f"{path}: schema version {found}, expected {SCHEMA_VERSION}: {REMEDY}")
    if not text.endswith(f"\n{END}\n"):
        raise NotComparableError(f"{path}: is not whole (its last line is not {END!r}): {REMEDY}")
    try:
        clock = _clock_from_text(content["clock"])
        tables = {name: _from_csv(content["tables"][name], name, clock) for name in TABLES}
        facts = dict(content["facts"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise NotComparableError(f"{path}: is not whole ({reason}): {REMEDY}") from None
    return Results(str(path), tables, facts, clock, is_thinned=True)


class _Block(str):
    """Text that is written as a block of lines."""


class _Dumper(yaml.SafeDumper):
    """Our YAML: tables as blocks of lines."""


_Dumper.add_representer(_Block, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style="|"))


def _as_csv(table: pd.DataFrame) -> str:
    columns = {str(name): _texts(str(name), column) for name, column in table.items()}
    lines = [",".join(columns), *(",".join(row) for row in zip(*columns.values(), strict=True))]
    return "\n".join(lines) + "\n"


def _texts(name: str, column: pd.Series) -> list[str]:
    if isinstance(column.dtype, pd.CategoricalDtype) or not pd.api.types.is_float_dtype(column.dtype):
        return [str(value) for value in column]
    if name in ("t_s", "start_s", "end_s"):
        return [f"{value:.{DECIMALS_S}f}".rstrip("0").rstrip(".") for value in column]
    digits = 3 if name.startswith("cov_") else 5
    return ["" if np.isnan(value) else f"{value:.{digits}g}" for value in column]


def _from_csv(text: str, name: str, clock: pd.DataFrame) -> pd.DataFrame:
    table = pd.read_csv(io.StringIO(text), keep_default_na=False, na_values=[""])
    missing = [column for column in COLUMNS[name] if column not in table]
    if missing:
        raise ValueError(f"table {name!r} has no column {missing[0]!r}")
    columns = {column.name: column for column in TABLES[name]}
    for column in COLUMNS[name]:
        if columns[column].type == pa.float64():
            table[column] = table[column].astype(float)
        elif columns[column].unit:
            table[column] = table[column].astype("int64")
    if "frame" in table and "t_s" not in table:
        table = table.merge(clock, on="frame", how="left", validate="many_to_one")
    return in_ordinary_types(table, name)


def _clock_as_text(clock: pd.DataFrame) -> dict[str, Any]:
    """Numbers and times of all frames in a few words; times to a twentieth of the frame interval."""
    frame, t_s = clock.frame.to_numpy(np.int64), clock.t_s.to_numpy(float)
    if len(frame) == 0:
        return {"first_frame": 0, "frames": "", "first_s": 0.0, "step_s": 0.0, "times": ""}
    span = max(1, min(len(t_s) - 1, STEP_FRAMES))
    step_s = float(np.median(t_s[span:] - t_s[:-span])) / span if len(t_s) > 1 else 1.0
    ticks = np.rint((t_s - t_s[0]) / step_s * TICKS).astype(np.int64)
    return {
        "first_frame": int(frame[0]),
        "frames": _steps(np.diff(frame)),
        "first_s": round(float(t_s[0]), DECIMALS_S),
        "step_s": step_s,
        "times": _steps(np.diff(ticks) / TICKS),
    }


def _clock_from_text(content: Any) -> pd.DataFrame:
    frame = content["first_frame"] + np.concatenate([[0.0], np.cumsum(_from_steps(content["frames"]))])
    t_s = content["first_s"] + content["step_s"] * np.concatenate([[0.0], np.cumsum(_from_steps(content["times"]))])
    if content["step_s"] == 0:
        frame, t_s = frame[:0], t_s[:0]
    return pd.DataFrame({"frame": frame.round().astype("int64"), "t_s": t_s})


def _steps(steps: np.ndarray) -> str:
    """Numbers in a row, equal ones counted.

    >>> _steps(np.array([1.0, 1.0, 1.0, 2.05, 1.0]))
    '1x3 2.05 1'
    """
    runs = [(f"{step:g}", len(list(same))) for step, same in groupby(steps.tolist())]
    return " ".join(step + (f"x{count}" if count > 1 else "") for step, count in runs)


def _from_steps(text: object) -> np.ndarray:
    """The numbers that `_steps` wrote.

    >>> _from_steps("1x3 2.05 1").tolist()
    [1.0, 1.0, 1.0, 2.05, 1.0]
    """
    words = [word.partition("x") for word in str(text).split()]
    return np.repeat([float(step) for step, _, _ in words], [int(count or 1) for _, _, count in words])
