"""Tables of point tracks, from any other tracker."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from ttcvid.errors import InputError, UsageError, quoted
from ttcvid.model import Floats, Frame, ImageSize, Ints, PointSet, SourceInfo
from ttcvid.plain_files import open_plain
from ttcvid.sources.base import OnePassSource, Selection, median_dt_s, require_file, require_plausible_step
from ttcvid.sources.clock import Clock

TABLE_SUFFIXES = frozenset((".parquet", ".csv"))
LARGEST_FRAME = 2**31 - 1
LARGEST_TRACK_ID = 2**53
"""Frame numbers are kept in 32 bits; track numbers above 2^53 lose digits on their way through float64."""
FARTHEST_PX = 1e6
"""A point farther from the picture's corner is a mistake, not a prediction."""
LEAST_SHARE_INSIDE = 0.5
"""Where fewer of the points lie in the picture, the picture's size is a wrong one."""
FARTHEST_NORMALISED = 2.0
"""Where no coordinate of any point is larger, they are no pixels: parts of the picture, or the plane z = 1."""
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}

_LONGEST_HEADER = 10_000
"""Bytes of the first line that are looked at where a text is no table."""

COLUMNS = ("frame", "t_s", "track_id", "x_px", "y_px")


class TrackSource(OnePassSource):
    """A table with a row per observed point: ``frame, t_s, track_id, x_px, y_px``; other columns do not matter.

    The rows may stand in any order, and frame numbers may have gaps. Points outside the picture are kept:
    trackers predict there, and rays exist there. Frames carry ``points`` and no picture.

    Raises UsageError without an image size and with ``--fps`` or ``--timestamps`` (the table has its own times);
    InputError where the table cannot be read, lacks columns, is empty, or holds missing, infinite, negative, broken
    or huge numbers, one track twice in a frame, two times in one frame, normalised coordinates, or points that mostly
    lie outside the picture.
    """

    def __init__(self, path: Path, selection: Selection, clock: Clock, image_size: ImageSize | None) -> None:
        if clock.origin:
            raise UsageError(f"--{clock.origin}: {path} has its times in column t_s: leave the option out")
        if image_size is None:
            raise UsageError(f"{path}: a track table has no image size: give --image-size WxH or a --camera file")
        frame, t_s, track_id, xy_px = _read_columns(path)
        _require_pixels(path, xy_px, image_size)
        _require_in_picture(path, xy_px, image_size)
        order = np.lexsort((track_id, frame))
        self._frame, self._track_id, self._xy_px = frame[order], track_id[order], xy_px[order]
        _require_unique(path, self._frame, self._track_id)
        _require_one_time(path, self._frame, t_s[order])
        self._numbers, self._starts = np.unique(self._frame, return_index=True)
        self._times_s = t_s[order][self._starts]
        require_plausible_step(f"{path}: t_s", self._times_s)
        self._wanted = selection.require_any(str(path), self._numbers, self._times_s)
        info = SourceInfo(
            path=str(path),
            kind="tracks",
            image_size=image_size,
            nominal_dt_s=median_dt_s(self._times_s),
            n_frames=int(self._wanted.sum()),
            time_origin="table",
        )
        super().__init__(info, (path,))

    def frames(self) -> Iterator[Frame]:
        """The selected frames that have points, ascending."""
        ends = np.append(self._starts[1:], len(self._frame))
        for i in np.flatnonzero(self._wanted):
            rows = slice(self._starts[i], ends[i])
            points = PointSet(self._track_id[rows].copy(), self._xy_px[rows].copy())
            yield Frame(int(self._numbers[i]), float(self._times_s[i]), points=points)


def _read_columns(path: Path) -> tuple[Ints, Floats, Ints, Floats]:
    """The checked columns: frame (N,), t_s (N,), track_id (N,), xy_px (N, 2)."""
    table = _read_table(path)
    if table.num_rows == 0:
        raise InputError(f"{path}: has no rows: expected one per observed point")
    frame, t_s, track_id, x_px, y_px = (_numbers(path, name, table[name]) for name in COLUMNS)
    xy_px = np.column_stack([x_px, y_px])
    far = np.flatnonzero((np.abs(xy_px) > FARTHEST_PX).any(axis=1))
    if len(far):
        row = int(far[0])
        x, y = xy_px[row]
        raise InputError(
            f"{path}: row {row + 1}: the point is at ({x:g}, {y:g}): expected pixels of the picture, at most "
            f"{FARTHEST_PX:g} ({len(far)} such rows), leave such rows out"
        )
    frames = _whole(path, "frame", frame, LARGEST_FRAME, "2^31 - 1")
    return frames, t_s, _whole(path, "track_id", track_id, LARGEST_TRACK_ID, "2^53"), xy_px


def _require_columns(path: Path, found: list[str]) -> None:
    missing = [name for name in COLUMNS if name not in found]
    if missing:
        separated = [words for mark, words in SEPARATORS.items() if len(found) == 1 and mark in found[0]]
        remedy = f": its columns are separated by {separated[0]}, write it with commas" if separated else ""
        raise InputError(
            f"{path}: lacks column {', '.join(missing)}: expected {', '.join(COLUMNS)}, "
            f"found {', '.join(found) or 'none'}{remedy}"
        )
    twice = [name for name in COLUMNS if found.count(name) > 1]
    if twice:
        raise InputError(f"{path}: column {twice[0]} is there {found.count(twice[0])} times: leave all but one out")


def _require_pixels(path: Path, xy_px: Floats, size: ImageSize) -> None:
    if np.abs(xy_px).max() <= FARTHEST_NORMALISED:
        (x0, y0), (x1, y1) = xy_px.min(axis=0), xy_px.max(axis=0)
        raise InputError(
            f"{path}: x_px runs from {x0:g} to {x1:g} and y_px from {y0:g} to {y1:g}: expected pixels of pictures of "
            f"{size}, multiply normalised coordinates back, by the picture's size or by the camera matrix"
        )


def _require_in_picture(path: Path, xy_px: Floats, size: ImageSize) -> None:
    within = (xy_px >= -0.5) & (xy_px <= [size.width_px - 0.5, size.height_px - 0.5])
    inside = within[:, 0] & within[:, 1]
    if inside.mean() < LEAST_SHARE_INSIDE:
        raise InputError(
            f"{path}: only {np.count_nonzero(inside)} of {len(inside)} points lie in pictures of {size}: give the "
            "--image-size (or camera file) of the pictures that were tracked"
        )


def _read_table(path: Path) -> pa.Table:
    require_file(path)
    is_csv = path.suffix.lower() == ".csv"
    try:
        # a path that is opened here stays a file, whatever its name looks like
        with open_plain(path) as stream:
            return _read_csv(path, stream) if is_csv else _read_parquet(path, stream)
    except (pa.ArrowException, OSError) as error:
        reason = " ".join(str(error).split()).rstrip(".")
        kind = path.suffix.lower()[1:]
        remedy = _oddity_of_text(path) if kind == "csv" else ""
        raise InputError(
            f"{path}: cannot be read as {kind} ({reason}): {remedy or 'expected a table, write it again'}"
        ) from None


def _read_csv(path: Path, stream: BinaryIO) -> pa.Table:
    table = pyarrow.csv.read_csv(stream)
    _require_columns(path, table.column_names)
    return table


def _read_parquet(path: Path, stream: BinaryIO) -> pa.Table:
    """Our columns alone, each text in them once: a small file can hold gigabytes of the same."""
    schema = pyarrow.parquet.ParquetFile(stream).schema_arrow
    _require_columns(path, schema.names)
    texts = [name for name in COLUMNS if pa.types.is_string(schema.field(name).type)]
    table: pa.Table = pyarrow.parquet.ParquetFile(stream, read_dictionary=texts).read(columns=list(COLUMNS))
    return table


def _oddity_of_text(path: Path) -> str:
    """What the first line of a text that is no table with commas says of it, and what to do; empty if nothing."""
    with path.open("rb") as stream:
        head = stream.readline(_LONGEST_HEADER)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "it is UTF-16, save it as UTF-8"
    separated = [words for mark, words in SEPARATORS.items() if mark.encode() in head]
    if separated:
        return f"its columns are separated by {separated[0]}, write it with commas, and numbers with points"
    if b"frame" not in head:
        return f"its first line has to name the columns: {', '.join(COLUMNS)}"
    return ""


def _numbers(path: Path, name: str, column: pa.ChunkedArray[Any]) -> Floats:
    """A column as float64; an error names the first row (from 1) whose value is no finite number."""
    if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        values: NDArray[Any] = pc.cast(column, pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    elif pa.types.is_dictionary(column.type):
        values = np.concatenate([_numbers_of_texts(chunk) for chunk in column.chunks])
    else:
        values = np.array([_float(value) for value in column.to_pylist()])
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        row = int(bad[0])
        value = column[row].as_py()
        are_names = name == "track_id" and isinstance(value, str)
        remedy = "number the tracks" if are_names else "leave such rows out"
        raise InputError(
            f"{path}: row {row + 1}: {name} is {quoted(value)}: expected a finite number ({len(bad)} such rows), "
            f"{remedy}"
        )
    return np.asarray(values, dtype=np.float64)


def _numbers_of_texts(chunk: Any) -> Floats:
    """The numbers of a dictionary array: each text is read once, and nothing (NaN) stands behind the last of them."""
    numbers = np.array([*(_float(text) for text in chunk.dictionary.to_pylist()), np.nan])
    return np.asarray(numbers[chunk.indices.fill_null(len(numbers) - 1).to_numpy(zero_copy_only=False)])


def _float(value: object) -> float:
    try:
        return float(str(value))
    except ValueError:
        return np.nan


def _whole(path: Path, name: str, values: Floats, largest: int, largest_text: str) -> Ints:
    bad = np.flatnonzero((values != np.floor(values)) | (values < 0) | (values > largest))
    if len(bad):
        row = int(bad[0])
        raise InputError(
            f"{path}: row {row + 1}: {name} is {values[row]:g}: expected whole numbers from 0 to {largest_text}, "
            "mend the table"
        )
    return values.astype(np.int64)


def _require_unique(path: Path, frame: Ints, track_id: Ints) -> None:
    twice = np.flatnonzero((np.diff(frame) == 0) & (np.diff(track_id) == 0))
    if len(twice):
        i = twice[0]
        raise InputError(
            f"{path}: frame {frame[i]} has track_id {track_id[i]} more than once: "
            f"expected one row for each track in a frame ({len(twice)} rows too many), leave the others out"
        )


def _require_one_time(path: Path, frame: Ints, t_s: Floats) -> None:
    differing = np.flatnonzero((np.diff(frame) == 0) & (np.diff(t_s) != 0))
    if len(differing):
        i = differing[0]
        times = f"{t_s[i]} and {t_s[i + 1]}"
        raise InputError(f"{path}: frame {frame[i]} has t_s {times}: expected one time for each frame")
