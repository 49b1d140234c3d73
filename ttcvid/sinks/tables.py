"""Frame results as Parquet tables, written while the analysis runs.

Rows are gathered in memory and written as row groups of a bounded number of rows, so that memory stays flat in the
length of the clip. Nothing in the files depends on when or where they are written: equal results, equal bytes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ttcvid.errors import OutputError
from ttcvid.model import Event, FrameResult
from ttcvid.plain_files import printable
from ttcvid.schema import TABLE_NAMES, Column, columns_of, table_schema
from ttcvid.sinks.failures import output_errors
from ttcvid.sinks.rows import cluster_row, epipole_row, event_row, frame_row, track_columns

# Rows of one row group: some 5 MB of tracks, and well under 1 MB of Python numbers for the small tables.
TRACK_GROUP_ROWS = 32768
SMALL_GROUP_ROWS = 1024


class TableSink:
    """Writes ``NAME.parquet`` for each table of the schema into ``folder``.

    Parameters
    ----------
    folder : An existing folder, usually the temporary one of `ttcvid.sinks.folder.OutputFolder`.
    metadata : File metadata of every table, beside the schema's version (how the run was made; nothing time-dependent).
    nominal_dt_s : Median frame interval of the source in s: the unit of ``k_frames``.

    Raises
    ------
    OutputError : Where a table cannot be written, from any method.
    """

    def __init__(self, folder: Path, metadata: dict[str, str], *, nominal_dt_s: float) -> None:
        if not (np.isfinite(nominal_dt_s) and nominal_dt_s > 0):
            raise ValueError(f"nominal_dt_s: expected a positive number of seconds, got {nominal_dt_s}")
        self._nominal_dt_s = nominal_dt_s
        self._last_frame = -1
        self._events: dict[int, Event] = {}
        self._files = ExitStack()
        self._tables: dict[str, _Table] = {}
        try:
            for name in TABLE_NAMES:
                table = self._tables[name] = _Table(folder / f"{name}.parquet", name, metadata)
                self._files.callback(table.close)
        except OutputError:
            self._discard()
            raise

    def write(self, result: FrameResult) -> None:
        """Add the rows of one frame: one in ``frames``, one a track, one a cluster.

        Raises
        ------
        ValueError
            Where frames do not come in ascending order, or tracks are not ascending and unique.
        """
        if result.frame <= self._last_frame:
            raise ValueError(f"frames must ascend: frame {result.frame} came after frame {self._last_frame}")
        if np.any(np.diff(result.tracks.track_id) <= 0):
            raise ValueError(f"frame {result.frame}: track_id must be ascending and unique")
        self._last_frame = result.frame
        self._tables["collision_times"].add_columns(track_columns(result, self._nominal_dt_s))
        for cluster in sorted(result.clusters, key=lambda row: row.cluster_id):
            self._tables["epipoles"].add_row(epipole_row(result, cluster))
            self._tables["clusters"].add_row(cluster_row(result, cluster))
        self._tables["frames"].add_row(frame_row(result))
        self._events.update((event.event_id, event) for event in result.events)

    def close(self) -> None:
        """Write what is still in memory, the events among it, and close the files. Further calls do nothing."""
        for event_id in sorted(self._events):
            self._tables["events"].add_row(event_row(self._events[event_id]))
        self._events.clear()
        self._files.close()

    def _discard(self) -> None:
        # What failed first is the error to report, not that the other tables cannot be finished either.
        with suppress(OutputError):
            self._files.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if error is None:
            self.close()
        else:
            self._discard()


def write_table(path: Path, name: str, rows: list[tuple[Any, ...]], metadata: dict[str, str]) -> None:
    """Write a whole table, its rows in the order of the schema's columns; OutputError where that cannot be done."""
    table = _Table(path, name, metadata)
    try:
        for row in rows:
            table.add_row(row)
    finally:
        table.close()


class _Table:
    """One Parquet file and the rows that wait for their row group."""

    def __init__(self, path: Path, name: str, metadata: dict[str, str]) -> None:
        self._path = path
        self._columns = columns_of(name)
        # names of files among it need not be UTF-8
        self._schema = table_schema(name, {key: printable(text) for key, text in metadata.items()})
        self._rows: list[tuple[Any, ...]] = []
        self._blocks: list[tuple[np.ndarray, ...]] = []
        self._n_block_rows = 0
        # Floats hardly ever repeat: splitting their bytes compresses better and faster than a dictionary of them.
        floats = [column.name for column in self._columns if column.type == pa.float64()]
        others = [column.name for column in self._columns if column.type != pa.float64()]
        with output_errors(path):
            # bytes, because a name need not be UTF-8
            self._file = pa.OSFile(os.fsencode(path), "wb")  # type: ignore[arg-type]  # the stubs know only str
            self._writer = pq.ParquetWriter(
                self._file,
                self._schema,
                compression="zstd",
                compression_level=1,
                use_dictionary=others,  # type: ignore[arg-type]  # the stubs know only bool
                use_byte_stream_split=floats,
                write_statistics=True,
            )

    def add_row(self, row: tuple[Any, ...]) -> None:
        """Add one row, its values in the order of the columns."""
        self._rows.append(row)
        if len(self._rows) >= SMALL_GROUP_ROWS:
            self._flush()

    def add_columns(self, block: tuple[np.ndarray, ...]) -> None:
        """Add many rows, one array a column."""
        self._blocks.append(block)
        self._n_block_rows += len(block[0])
        if self._n_block_rows >= TRACK_GROUP_ROWS:
            self._flush()

    def close(self) -> None:
        """Write the last row group and the footer."""
        try:
            self._flush()
        finally:
            with output_errors(self._path):
                try:
                    self._writer.close()
                finally:
                    self._file.close()

    def _flush(self) -> None:
        if self._rows:
            columns: list[Any] = list(zip(*self._rows, strict=True))
        elif self._n_block_rows:
            columns = [np.concatenate(parts) for parts in zip(*self._blocks, strict=True)]
        else:
            return
        self._rows, self._blocks, self._n_block_rows = [], [], 0
        arrays = [_arrow_array(column, values) for column, values in zip(self._columns, columns, strict=True)]
        with output_errors(self._path):
            self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))


def _arrow_array(column: Column, values: Any) -> pa.Array[Any]:
    """Values of one column; null for NaN, infinity and, in whole numbers that can be missing, for negative ones.

    Names come as codes where ``values`` is an array and as themselves where it is a tuple. Arrays are made of their
    buffers: ``pyarrow.array`` would import pandas first, for as much processor time as ten frames take.
    """
    if column.values:
        codes = values if isinstance(values, np.ndarray) else [column.values.index(value) for value in values]
        indices = _numbers(pa.int8(), np.asarray(codes, dtype=np.int8))
        return pa.DictionaryArray.from_arrays(indices, _strings(column.values))
    if column.type == pa.string():
        return _strings(values)
    numbers = np.asarray(values, dtype=column.type.to_pandas_dtype())
    if not column.nullable:
        return _numbers(column.type, numbers)
    return _numbers(column.type, numbers, np.isfinite(numbers) if numbers.dtype.kind == "f" else numbers >= 0)


def _numbers(type_: pa.DataType, numbers: np.ndarray, is_there: np.ndarray | None = None) -> pa.Array[Any]:
    """Numbers or truth values ``(N,)`` of a type, null where they are not there."""
    validity = None if is_there is None else _validity(is_there)
    content = _bits(numbers) if numbers.dtype == bool else pa.py_buffer(np.ascontiguousarray(numbers).data)
    return pa.Array.from_buffers(type_, len(numbers), [validity, content])


def _strings(values: Sequence[str | None]) -> pa.Array[Any]:
    """Texts, None for null."""
    texts = [(value or "").encode() for value in values]
    ends = np.cumsum([0, *map(len, texts)], dtype=np.int32)
    is_there = np.array([value is not None for value in values], dtype=bool)
    buffers = [_validity(is_there), pa.py_buffer(ends.data), pa.py_buffer(b"".join(texts))]
    return pa.Array.from_buffers(pa.string(), len(texts), buffers)


def _validity(is_there: np.ndarray) -> pa.Buffer | None:
    """The bits that tell which values ``(N,)`` are there; None where all are."""
    return None if is_there.all() else _bits(is_there)


def _bits(are_true: np.ndarray) -> pa.Buffer:
    return pa.py_buffer(np.packbits(are_true, bitorder="little").data)
