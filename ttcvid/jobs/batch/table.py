"""``batch.parquet``: a row for each clip of a batch, with nothing in it that depends on when or where it was made."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ttcvid.errors import InputError, OutputError
from ttcvid.jobs.runs.run import Run
from ttcvid.schema import Column
from ttcvid.sinks.failures import output_errors

TABLE_NAME = "batch.parquet"
FAILED, PENDING = "failed", "pending"
VERSION_KEY, VERSION = "ttcvid_batch_version", "1"

COLUMNS = (
    Column("clip", pa.string(), "", "name of the clip, and of its folder below the batch's"),
    Column("input", pa.string(), "", "path of the input"),
    Column(
        "state",
        pa.string(),
        "",
        "complete; truncated: the input ends early; failed: see reason; pending: the batch was stopped before",
        values=("complete", "truncated", FAILED, PENDING),
    ),
    Column("reason", pa.string(), "", "why a clip failed", nullable=True),
    Column("n_frames", pa.int64(), "1", "frames analysed", nullable=True),
    Column("n_objects", pa.int64(), "1", "objects found", nullable=True),
    Column("n_events", pa.int64(), "1", "warnings of a collision", nullable=True),
    Column(
        "min_ttc_z_s", pa.float64(), "s", "smallest time to collision, as the clip's manifest has it", nullable=True
    ),
    Column("min_ttc_z_lo_s", pa.float64(), "s", "lower end of its 90 % interval", nullable=True),
    Column("min_ttc_z_hi_s", pa.float64(), "s", "upper end of its 90 % interval", nullable=True),
    Column("min_tcpa_s", pa.float64(), "s", "smallest time of closest approach of all warnings", nullable=True),
    Column("min_miss_s", pa.float64(), "s", "smallest miss distance of all warnings", nullable=True),
    Column(
        "warnings",
        pa.list_(pa.string()),
        "",
        "what to know before trusting the numbers, as the clip's manifest has it",
        nullable=True,
    ),
    Column("input_sha256", pa.string(), "", "hash of the input", nullable=True),
    Column("input_size_bytes", pa.int64(), "B", "size of the input", nullable=True),
    Column("ttcvid_version", pa.string(), "", "version that made the result", nullable=True),
)


@dataclass(frozen=True)
class ClipRow:
    """What became of one clip: a row of ``batch.parquet``, in whose columns the fields are described."""

    clip: str
    input: str
    state: str
    reason: str | None = None
    n_frames: int | None = None
    n_objects: int | None = None
    n_events: int | None = None
    min_ttc_z_s: float | None = None
    min_ttc_z_lo_s: float | None = None
    min_ttc_z_hi_s: float | None = None
    min_tcpa_s: float | None = None
    min_miss_s: float | None = None
    warnings: tuple[str, ...] | None = None
    input_sha256: str | None = None
    input_size_bytes: int | None = None
    ttcvid_version: str | None = None


def row_of_run(clip: str, input_: str, run: Run) -> ClipRow:
    """The row of a clip that has a result."""
    manifest = run.manifest
    counts, nearest = manifest["counts"], manifest["nearest"] or {}
    events = pq.read_table(run.folder / "events.parquet", columns=["min_tcpa_s", "miss_s"])
    return ClipRow(
        clip=clip,
        input=printable(input_),
        state=run.state,
        n_frames=counts["frames"],
        n_objects=counts["objects"],
        n_events=counts["events"],
        min_ttc_z_s=nearest.get("ttc_z_s"),
        min_ttc_z_lo_s=nearest.get("ttc_z_lo_s"),
        min_ttc_z_hi_s=nearest.get("ttc_z_hi_s"),
        min_tcpa_s=pc.min(events["min_tcpa_s"]).as_py(),
        min_miss_s=pc.min(events["miss_s"]).as_py(),
        warnings=tuple(manifest["warnings"]),
        input_sha256=manifest["input"]["sha256"],
        input_size_bytes=manifest["input"].get("size_bytes"),
        ttcvid_version=manifest["versions"].get("ttcvid"),
    )


def printable(path: str) -> str:
    """A path as text: bytes that are no UTF-8 are spelled out."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")


def write_rows(folder: Path, rows: Iterable[ClipRow]) -> Path:
    """Write the table into the folder of a batch, whole or not at all; OutputError where that cannot be done."""
    schema = pa.schema([column.field() for column in COLUMNS], metadata={VERSION_KEY: VERSION})
    table = pa.Table.from_pylist([_as_dict(row) for row in rows], schema=schema)
    target = folder / TABLE_NAME
    partial = folder / f".{TABLE_NAME}.partial"
    with output_errors(target):
        try:
            pq.write_table(table, partial, compression="zstd")
            partial.replace(target)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
    return target


def _as_dict(row: ClipRow) -> dict[str, Any]:
    values = asdict(row)
    return values | {"warnings": None if row.warnings is None else list(row.warnings)}


def read_rows(folder: Path) -> tuple[ClipRow, ...]:
    """The rows of a batch; InputError where there is none in ``folder``, or none that can be read."""
    path = folder / TABLE_NAME
    try:
        table = pq.read_table(path)
    except FileNotFoundError:
        raise InputError(f"{path}: not found, so this is no batch: give the folder of 'ttcvid batch'") from None
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as a table ({reason}): remove it and run the batch again") from None
    found = (table.schema.metadata or {}).get(VERSION_KEY.encode(), b"none").decode()
    if found != VERSION or table.column_names != [field.name for field in fields(ClipRow)]:
        raise InputError(f"{path}: is no table of a batch of this version (found {found}, expected {VERSION})")
    return tuple(
        ClipRow(**{**row, "warnings": None if row["warnings"] is None else tuple(row["warnings"])})
        for row in table.to_pylist()
    )


def refuse_foreign_table(folder: Path) -> tuple[ClipRow, ...]:
    """The rows of a former batch in ``folder``, none if there was none; OutputError if the table is not a batch's."""
    if not os.path.lexists(folder / TABLE_NAME):
        return ()
    try:
        return read_rows(folder)
    except InputError as error:
        raise OutputError(f"{error}; or choose another folder with -o") from None
