"""Frame times that the user gives: a frame rate, or a file with one time a frame."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from ttcvid.errors import InputError, UsageError
from ttcvid.model import Floats
from ttcvid.plain_files import read_plain
from ttcvid.sources.base import median_dt_s, require_file, require_plausible_step

FPS_BOUNDS = (1e-3, 1e5)
"""The same as the bounds of steps between times in a file, in frames/s."""

LONGEST_LINE_BYTES = 1000
"""A time needs 30; a file with more than this for each frame holds no times, and is not read."""
NANOSECONDS = 10**9
_KITTI = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)(?:\.(\d{1,9}))?")
_EPOCH = datetime(1970, 1, 1)


@dataclass(frozen=True)
class Clock:
    """What ``--fps`` or ``--timestamps`` say of the times of frames; at most one of them is given."""

    fps: float | None = None
    timestamps: Path | None = None

    def __post_init__(self) -> None:
        if self.fps is not None and self.timestamps is not None:
            raise UsageError(
                f"--fps {self.fps} and --timestamps {self.timestamps}: both say when frames were taken; give only one"
            )
        least, most = FPS_BOUNDS
        if self.fps is not None and not least <= self.fps <= most:
            raise UsageError(f"--fps: {self.fps:g} is no frame rate: expected {least:g} to {most:g} frames/s")

    @property
    def origin(self) -> str | None:
        """``fps``, ``timestamps``, or None where nothing is given."""
        if self.fps is not None:
            return "fps"
        return None if self.timestamps is None else "timestamps"

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that the times come from."""
        return () if self.timestamps is None else (self.timestamps,)

    def times_s(self, n_frames: int, counted: str) -> Floats | None:
        """Times ``(n_frames,)`` in s; None where nothing is given. ``counted`` names the frames in errors."""
        if self.timestamps is not None:
            return read_timestamps(self.timestamps, n_frames, counted)
        return None if self.fps is None else np.arange(n_frames) / self.fps

    def nominal_dt_s(self, times_s: Floats) -> float:
        """Nominal frame spacing in s of frames at these times: 1/fps, or else their median difference."""
        return median_dt_s(times_s) if self.fps is None else 1.0 / self.fps


def read_timestamps(path: Path, n_frames: int, counted: str) -> Floats:
    """Times ``(n_frames,)`` in s from a file with one line a frame.

    A line is a float in seconds, taken as it is, or KITTI's ``2011-09-26 13:02:25.964389445``, counted from the
    file's first line. Raises InputError, with the line number, for anything else, for NaN and for infinity, and
    where the number of lines is not that of the frames (``counted`` says what those are). Order is not checked:
    times that stand still or run backward get their status in the analysis.
    """
    require_file(path)
    try:
        content = read_plain(path, LONGEST_LINE_BYTES * (n_frames + 1))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read as times of {n_frames} {counted} ({error.strerror}): expected one line for each"
        ) from None
    try:
        lines = content.decode("utf-8-sig").rstrip().splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{path}: is no text: expected one time a line, seconds or KITTI's format") from None
    if lines and _KITTI.fullmatch(lines[0].strip()):
        times_ns = [_kitti_ns(path, number, line) for number, line in enumerate(lines, 1)]
        times_s = [(time_ns - times_ns[0]) / NANOSECONDS for time_ns in times_ns]
    else:
        times_s = [_seconds(path, number, line) for number, line in enumerate(lines, 1)]
    if len(times_s) != n_frames:
        raise InputError(
            f"{path}: has {len(times_s)} times for {n_frames} {counted}: expected one line for each, mend the file"
        )
    require_plausible_step(f"{path}: the time", np.array(times_s))
    return np.array(times_s, dtype=np.float64)


def _seconds(path: Path, number: int, line: str) -> float:
    try:
        time_s = float(line)
    except ValueError:
        time_s = math.nan
    if not math.isfinite(time_s):
        raise InputError(
            f"{path}: line {number}: {line.strip()!r} is no time: expected seconds such as 12.345, "
            f"or KITTI's 2011-09-26 13:02:25.964389445 on every line"
        )
    return time_s


def _kitti_ns(path: Path, number: int, line: str) -> int:
    match = _KITTI.fullmatch(line.strip())
    try:
        if match is None:
            raise ValueError
        seconds = int((datetime.fromisoformat(match[1]) - _EPOCH).total_seconds())
    except ValueError:
        raise InputError(
            f"{path}: line {number}: {line.strip()!r} is no time: expected 2011-09-26 13:02:25.964389445 as on line 1"
        ) from None
    return seconds * NANOSECONDS + int((match[2] or "").ljust(9, "0"))
