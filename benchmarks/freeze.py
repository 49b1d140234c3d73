"""Whether a change that should change no result changes none: tables now against tables frozen before.

python benchmarks/freeze.py --write DIR    # tables as they are now
python benchmarks/freeze.py --check DIR [--only NAME]

The clips: the real ones and all sample scenes, the first 60 frames of each, and 200 track tables of the scenario suite
(`frozen_clips.py`). What is tracked in them is kept in DIR/tracks and not tracked again: geometry alone is compared.
DIR belongs outside the repository's history (out/freeze): it is made from the commit before the change, which
DIR/commit names. Where results change on purpose, --write makes the tables anew from the same tracks.

Numbers are equal to 1e-6 of the larger one, or of their column's median magnitude where they are near zero; all other
columns, numbers of rows and what is null exactly.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

# One thread of linear algebra in each process: set before numpy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from frozen_clips import FrozenClip, frozen_clips, tracked_of
from report import REPOSITORY

from ttcvid.jobs.clip import read_calibration
from ttcvid.jobs.settings.configuration import configure_from_arguments
from ttcvid.pipeline import analyze_tracked
from ttcvid.schema import TABLE_NAMES
from ttcvid.sinks.tables import TableSink

RELATIVE_TOLERANCE = 1e-6
_KEYS = {
    "collision_times": ["frame", "track_id"],
    "epipoles": ["frame", "cluster_id"],
    "clusters": ["frame", "cluster_id"],
    "frames": ["frame"],
    "events": ["event_id"],
}


@dataclass(frozen=True)
class Verdict:
    """What became of a clip: ``difference`` is empty where its tables are as they were."""

    clip: str
    difference: str
    n_values: int
    seconds: float


def main() -> None:
    """Write or check all clips; a line each, and exit code 1 where a table differs."""
    arguments = _arguments()
    folder = (arguments.write or arguments.check).resolve()
    names = [name for name in frozen_clips() if arguments.only is None or arguments.only in name]
    if arguments.write:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "commit").write_text(_commit() + "\n")
    else:
        missing = [name for name in names if not (folder / "tables" / name).is_dir()]
        if missing:
            sys.exit(f"--check {folder}: no tables of {missing[0]} there: make them by --write")
        print(f"frozen at {(folder / 'commit').read_text().strip()}")
    work = partial(write_clip if arguments.write else check_clip, folder=folder)
    start_s, n_different = time.perf_counter(), 0
    for verdict in _each(work, names, arguments.jobs):
        n_different += bool(verdict.difference)
        said = verdict.difference or ("written" if arguments.write else f"{verdict.n_values} values equal")
        print(f"{verdict.clip:32} {verdict.seconds:5.1f} s  {said}", flush=True)
    took_s = time.perf_counter() - start_s
    print(f"{len(names)} clips in {took_s:.0f} s" + ("" if arguments.write else f", {n_different} differ"))
    sys.exit(1 if n_different else 0)


def write_clip(name: str, folder: Path) -> Verdict:
    """Analyse a clip, its tables into ``folder``."""
    return Verdict(name, "", 0, _analyze(frozen_clips()[name], folder, folder / "tables" / name))


def check_clip(name: str, folder: Path) -> Verdict:
    """Analyse a clip and compare its tables with those in ``folder``; the tables of now stay where they differ."""
    before, now = folder / "tables" / name, folder / "now" / name
    seconds = _analyze(frozen_clips()[name], folder, now)
    n_values, differences = 0, []
    for table in TABLE_NAMES:
        rows_before, rows_now = (_read(place / f"{table}.parquet") for place in (before, now))
        n_values += rows_before.size
        differences.append(difference_of(table, rows_before, rows_now))
    difference = "; ".join(filter(None, differences))
    if not difference:
        shutil.rmtree(now)
    return Verdict(name, difference, n_values, seconds)


def difference_of(name: str, before: pd.DataFrame, after: pd.DataFrame) -> str:
    """The first frame in which two tables differ, by how much and in which columns; empty where they are equal."""
    if list(before.columns) != list(after.columns):
        return f"{name}: other columns"
    keys = _KEYS[name]
    rows_before, rows_after = (set(map(tuple, table[keys].itertuples(index=False))) for table in (before, after))
    if rows_before != rows_after:
        first = min(rows_before ^ rows_after)
        return f"{name}: {len(rows_before)} rows became {len(rows_after)}, the first other one {keys} = {first}"
    is_other = pd.DataFrame({column: _differs(before[column], after[column]) for column in before.columns})
    if not is_other.to_numpy().any():
        return ""
    columns = [column for column in is_other if is_other[column].any()]
    row = int(np.argmax(is_other.any(axis=1).to_numpy()))
    column = next(column for column in columns if is_other[column].iloc[row])
    where = ", ".join(f"{key} {before[key].iloc[row]}" for key in keys)
    return (
        f"{name}: {int(is_other.any(axis=1).sum())} of {len(before)} rows differ in {','.join(columns)}; "
        f"first {where}: {column} {before[column].iloc[row]} became {after[column].iloc[row]}"
    )


def _differs(before: pd.Series, after: pd.Series) -> np.ndarray:
    """Which values differ, (N,)."""
    is_null = before.isna().to_numpy(), after.isna().to_numpy()
    if not pd.api.types.is_float_dtype(before):
        return np.where(is_null[0] | is_null[1], is_null[0] != is_null[1], (before != after).to_numpy())
    x, y = before.to_numpy(dtype=float), after.to_numpy(dtype=float)
    size = np.maximum(abs(x), abs(y))
    usual = np.nanmedian(abs(x)) if np.isfinite(x).any() else 0.0
    return (is_null[0] != is_null[1]) | (abs(x - y) > RELATIVE_TOLERANCE * np.maximum(size, usual))


def _analyze(clip: FrozenClip, folder: Path, out: Path) -> float:
    """Analyse the tracked points of a clip, tables into ``out``; seconds of its geometry."""
    tracked = tracked_of(clip, folder / "tracks")
    configuration = configure_from_arguments({**tracked.options, **clip.options})
    calibration = read_calibration(configuration.options, tracked.image_size)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    start_s = time.perf_counter()
    with TableSink(out, {}, nominal_dt_s=tracked.nominal_dt_s) as tables:
        for result in analyze_tracked(tracked.frames, calibration.camera, configuration.pipeline, calibration.horizon):
            tables.write(result)
    return time.perf_counter() - start_s


def _read(path: Path) -> pd.DataFrame:
    table = pq.read_table(path).to_pandas()
    # Names as text: categories compare only with the same list of categories.
    return table.astype(dict.fromkeys(table.select_dtypes("category"), str))


def _each(work: Callable[[str], Verdict], names: list[str], n_jobs: int) -> Iterator[Verdict]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(n_jobs, mp_context=context) as pool:
        yield from pool.map(work, names)


def _commit() -> str:
    words = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    return subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout.strip()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--write", type=Path, metavar="DIR", help="put the tables of now there")
    which.add_argument("--check", type=Path, metavar="DIR", help="compare the tables of now with those there")
    parser.add_argument("--only", metavar="NAME", help="clips whose name contains this")
    parser.add_argument("--jobs", type=int, default=2, help="processes side by side")
    return parser.parse_args()


if __name__ == "__main__":
    main()
