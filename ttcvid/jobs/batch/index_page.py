"""Writes the index page of a batch."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ttcvid.errors import OutputError
from ttcvid.jobs.batch.table import ClipRow
from ttcvid.report.batch_index import GENERATOR, IndexRow, batch_page
from ttcvid.sinks.folder import REPORT_NAME
from ttcvid.sinks.manifest import MANIFEST_NAME
from ttcvid.sinks.whole_text import write_whole

INDEX_NAME = "index.html"
_HEAD_BYTES = 1000


def write_index(folder: Path, rows: Sequence[ClipRow]) -> Path:
    """Write the page; a clip's name leads to its report, or to its folder where it has none."""
    target = folder / INDEX_NAME
    write_whole(target, batch_page(f"Batch {folder.resolve().name}", [_index_row(folder, row) for row in rows]))
    return target


def refuse_foreign_index(folder: Path) -> None:
    """OutputError where the folder has a page of that name that no batch wrote."""
    path = folder / INDEX_NAME
    if not os.path.lexists(path):
        return
    if path.is_file() and not path.is_symlink():
        with path.open("rb") as file:
            if f'content="{GENERATOR}"'.encode() in file.read(_HEAD_BYTES):
                return
    raise OutputError(f"{path}: is no page of a batch, so it is kept: choose another folder with -o")


def _index_row(folder: Path, row: ClipRow) -> IndexRow:
    result = folder / row.clip
    report, manifest = result / REPORT_NAME, result / MANIFEST_NAME
    value_s, lo_s, hi_s = row.min_ttc_z_s, row.min_ttc_z_lo_s, row.min_ttc_z_hi_s
    return IndexRow(
        clip=row.clip,
        state=row.state,
        target=f"{row.clip}/{REPORT_NAME}" if report.exists() else f"{row.clip}/" if manifest.exists() else None,
        reason=row.reason or "",
        n_frames=row.n_frames,
        n_objects=row.n_objects,
        n_events=row.n_events,
        time_s=None if value_s is None or lo_s is None or hi_s is None else (value_s, lo_s, hi_s),
        warnings=row.warnings or (),
    )
