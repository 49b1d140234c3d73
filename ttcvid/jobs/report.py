"""Reports of finished runs: their tables read, and a page written beside them or where one wants it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from ttcvid.errors import InputError, OutputError, UsageError
from ttcvid.jobs.runs.addresses import address
from ttcvid.jobs.runs.manifest import camera_of
from ttcvid.jobs.runs.run import Run
from ttcvid.plain_files import open_plain, printable
from ttcvid.report.contents import TABLE_COLUMNS, RunContents
from ttcvid.report.run_page import run_page
from ttcvid.sinks.folder import OVERLAY_NAME, REPORT_NAME
from ttcvid.sinks.manifest import MANIFEST_NAME, write_manifest
from ttcvid.sinks.whole_text import write_whole


def report(*runs: str | Path | Run, out: str | Path | None = None) -> Path:
    """Write the report of a run, or of several side by side, and return where it is.

    Parameters
    ----------
    runs : Output folders of analyses, or what ``ttcvid.analyze`` returned.
    out : The page; without it the report of a single run is ``report.html`` in its folder, and its manifest lists it.
        The page finds the videos where they are, as long as page and runs keep their places to each other.

    Returns
    -------
    Path of the page.

    Raises
    ------
    UsageError
        No run, or several without ``out``.
    InputError
        A run cannot be read.
    OutputError
        The page cannot be written, or would replace a file of another origin.
    """
    opened = [run if isinstance(run, Run) else Run.open(run) for run in runs]
    if not opened:
        raise UsageError("a report needs a run: give the output folder of 'ttcvid analyze'")
    if out is None and len(opened) > 1:
        raise UsageError("a report of several runs belongs to none of their folders: give -o FILE.html")
    page = Path(out) if out is not None else opened[0].folder / REPORT_NAME
    if page.is_dir():
        raise OutputError(f"{page}: is a folder: expected the name of a page, such as {page / REPORT_NAME}")
    if out is None:
        _refuse_foreign(opened[0], page)
    write_whole(page, run_page([_contents(run, page) for run in opened]))
    if out is None:
        _list_in_manifest(opened[0], page)
    return page


def write_report(folder: Path, name: str, manifest: Mapping[str, Any], has_video: bool) -> None:
    """Write the report of a run that is not published yet: its tables lie in ``folder``, and so will the page."""
    video = OVERLAY_NAME if has_video else None
    contents = RunContents(printable(name), manifest, camera_of(manifest["camera"]), _tables(folder), video)
    write_whole(folder / REPORT_NAME, run_page([contents]))


def _contents(run: Run, page: Path) -> RunContents:
    video = address(run.overlay, page) if run.overlay is not None else None
    tables = _tables(run.folder)
    own_page = None if run.report is None or run.report.resolve() == page.resolve() else address(run.report, page)
    camera = camera_of(run.manifest["camera"])
    return RunContents(printable(str(run.folder)), run.manifest, camera, tables, video, own_page)


def _tables(folder: Path) -> dict[str, pa.Table]:
    tables = {name: _table(folder / f"{name}.parquet", list(columns)) for name, columns in TABLE_COLUMNS.items()}
    n_clusters, n_epipoles = tables["clusters"].num_rows, tables["epipoles"].num_rows
    if n_clusters != n_epipoles:
        raise InputError(
            f"{folder / 'epipoles.parquet'}: has {n_epipoles} rows, clusters.parquet {n_clusters}: expected one a "
            "frame and cluster in both: analyse again"
        )
    if tables["frames"].num_rows == 0:
        raise InputError(f"{folder / 'frames.parquet'}: holds no frame: expected one at least: analyse again")
    return tables


def _table(path: Path, columns: list[str]) -> pa.Table:
    # Not pyarrow.parquet.read_table: it imports pandas first, which takes longer than the whole page.
    try:
        with open_plain(path) as opened, pq.ParquetFile(opened) as file:
            missing = [name for name in columns if name not in file.schema_arrow.names]
            if missing:
                raise InputError(f"{path}: column {missing[0]!r} is missing: run 'ttcvid analyze' again")
            return file.read(columns=columns)
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as a table ({reason}): run 'ttcvid analyze' again") from None


def _refuse_foreign(run: Run, page: Path) -> None:
    if os.path.lexists(page) and page.name not in run.manifest.get("files", {}):
        raise OutputError(f"{page}: not a file of this run, so it is kept: move it away, or give -o FILE.html")


def _list_in_manifest(run: Run, page: Path) -> None:
    """The manifest names every file of a run: only those are replaced by ``analyze --overwrite``."""
    files = {**run.manifest.get("files", {}), page.name: page.stat().st_size}
    write_manifest(run.folder / MANIFEST_NAME, {**run.manifest, "files": files})
