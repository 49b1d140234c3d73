"""Finished runs as files of other tools."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from ttcvid.errors import InputError, OutputError, UsageError, quoted
from ttcvid.export.coco import write_coco
from ttcvid.export.exported import ExportedRun
from ttcvid.export.mcap_recording import write_mcap
from ttcvid.export.mot import write_mot
from ttcvid.export.rerun_recording import write_rerun
from ttcvid.jobs.runs.manifest import camera_of
from ttcvid.jobs.runs.run import Run
from ttcvid.plain_files import open_plain
from ttcvid.schema import TABLE_NAMES
from ttcvid.sinks.failures import output_errors
from ttcvid.studies.evaluation.truth import plain

WRITERS: dict[str, tuple[str, Callable[[Path, ExportedRun], None]]] = {
    "mot": ("_mot.txt", write_mot),
    "coco": ("_coco.json", write_coco),
    "rrd": (".rrd", write_rerun),
    "mcap": (".mcap", write_mcap),
}
"""What a file is called after its run, and who writes it."""
CSV = "csv"
FORMATS = (CSV, *WRITERS)


def export(
    run: str | Path | Run, to: str, out: str | Path | None = None, *, table: str | None = None, overwrite: bool = False
) -> Path:
    """Write a run in another format and return where it is.

    Parameters
    ----------
    run : The output folder of an analysis, or what ``ttcvid.analyze`` returned.
    to : One of `FORMATS`.
    out : A file, or for all tables as ``csv`` a folder; default in the working folder, named after the run.
    table : Of ``csv``: this table alone.
    overwrite : Replace what exists; of a folder, the files that have the names of tables.

    Returns
    -------
    Path of the file, or of the folder of all tables.

    Raises
    ------
    UsageError
        An unknown format or table, or a library is missing.
    InputError
        The run cannot be read.
    OutputError
        ``out`` exists, or cannot be written.
    """
    if to not in FORMATS:
        raise UsageError(f"--to = {quoted(to)}: expected one of {', '.join(FORMATS)}")
    if table is not None and to != CSV:
        raise UsageError(f"--table is for --to csv, not {to}: leave it out")
    if table is not None and table not in TABLE_NAMES:
        raise UsageError(f"--table = {quoted(table)}: expected one of {', '.join(TABLE_NAMES)}")
    opened = run if isinstance(run, Run) else Run.open(run)
    name = opened.folder.resolve().name
    if to == CSV:
        ending = "_csv" if table is None else f"_{table}.csv"
        return _export_csv(opened, Path(out) if out is not None else Path(name + ending), table, overwrite)
    ending, write = WRITERS[to]
    path = Path(out) if out is not None else Path(name + ending)
    content = _read(opened, name)
    with _made_whole(path, overwrite) as partial:
        write(partial, content)
    return path


def _export_csv(run: Run, path: Path, table: str | None, overwrite: bool) -> Path:
    if table is not None:
        content = _arrow_table(run, table)
        with _made_whole(path, overwrite) as partial:
            pa.csv.write_csv(content, partial)
        return path
    if os.path.lexists(path) and not (overwrite and path.is_dir()):
        raise OutputError(f"{path}: exists already: give --overwrite to replace what is in that folder, or use -o")
    tables = {name: _arrow_table(run, name) for name in TABLE_NAMES}
    with output_errors(path):
        path.mkdir(parents=True, exist_ok=True)
    for name, content in tables.items():
        with _made_whole(path / f"{name}.csv", overwrite=True) as partial:
            pa.csv.write_csv(content, partial)
    return path


@contextmanager
def _made_whole(path: Path, overwrite: bool) -> Iterator[Path]:
    """A name to write to, that becomes ``path`` when all is written; OutputError where that cannot be."""
    if path.is_dir():
        raise OutputError(f"{path}: is a folder: expected the name of a file")
    if os.path.lexists(path) and not overwrite:
        raise OutputError(f"{path}: exists already: give --overwrite to replace it, or use -o")
    partial = path.with_name(f".partial-{path.name}")
    try:
        with output_errors(path):
            if not path.parent.is_dir():
                raise FileNotFoundError(2, "no such folder", str(path.parent))
            yield partial
            shutil.move(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _arrow_table(run: Run, name: str) -> pa.Table:
    path = run.folder / f"{name}.parquet"
    try:
        with open_plain(path) as file:
            return pq.read_table(file)
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as a table ({reason}): run 'ttcvid analyze' again") from None


def _read(run: Run, name: str) -> ExportedRun:
    return ExportedRun(
        name=name,
        tables={table: _ordinary(_arrow_table(run, table)) for table in TABLE_NAMES},
        camera=camera_of(run.manifest["camera"]),
        nominal_dt_s=float(run.manifest["input"]["nominal_dt_s"]),
        video=run.overlay,
    )


def _ordinary(columns: pa.Table) -> pd.DataFrame:
    """Ordinary numbers, and whole ones where a number names something."""
    table = plain(columns)
    numbers = [column for column in ("frame", "start_frame", "end_frame") if column in table]
    return table.astype(dict.fromkeys(numbers, "int64"))
