"""What all sources share: the protocol, the selection of frames, and the median frame spacing."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Literal, Protocol, Self

import numpy as np

from ttcvid.errors import InputError, UsageError
from ttcvid.model import Bools, Floats, Frame, Ints, SourceInfo, SourceReport

STEP_BOUNDS_S = (1e-5, 1e3)
"""Time from frame to frame: from 100 000 frames a second to one in a quarter of an hour."""

LARGEST_TIME_S = 1e11
"""Three thousand years: seconds since 1970 lie far below, milliseconds and what is no time at all above."""

LONE_FRAME_DT_S = 1.0
"""Stands for the frame spacing of a source that has none (one frame): nothing is computed from it."""

_CLOCK = re.compile(r"(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:\.\d+)?)")
_SECONDS = re.compile(r"(\d+(?:\.\d*)?|\.\d+)s")
_FRAMES = re.compile(r"\d+")


class Source(Protocol):
    """Frames with their times, in one pass.

    ``files`` are the files that the pictures or points and their times come from. ``report`` is final once the
    iteration has ended; read earlier it tells what has happened so far.
    """

    info: SourceInfo
    files: tuple[Path, ...]

    @property
    def report(self) -> SourceReport:
        """What happened while the source was read."""
        ...

    def __iter__(self) -> Iterator[Frame]: ...
    def close(self) -> None:
        """End the reading and release the files."""
        ...

    def __enter__(self) -> Self: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class OnePassSource(ABC):
    """A source that can be read once; its kinds give the frames and count what they met on the way.

    ``n_read``, ``n_skipped``, ``n_corrupt``, ``n_missing``, ``is_truncated`` and ``warnings`` make up
    the report.
    """

    def __init__(self, info: SourceInfo, files: tuple[Path, ...], warnings: tuple[str, ...] = ()) -> None:
        self.info = info
        self.files = files
        self.n_read = 0
        self.n_skipped = 0
        self.n_corrupt = 0
        self.n_missing = 0
        self.is_truncated = False
        self.warnings = warnings
        self._frames: Iterator[Frame] | None = None

    @abstractmethod
    def frames(self) -> Iterator[Frame]:
        """The selected frames, ascending in index."""

    def __iter__(self) -> Iterator[Frame]:
        if self._frames is not None:
            raise RuntimeError(f"{self.info.path}: a source is read once; open it again to read it again")
        self._frames = self._counted()
        return self._frames

    def _counted(self) -> Iterator[Frame]:
        for frame in self.frames():
            self.n_read += 1
            yield frame

    @property
    def report(self) -> SourceReport:
        """What has happened so far; final once the iteration has ended."""
        return SourceReport(self.n_skipped, self.is_truncated, self.warnings, self.n_corrupt, self.n_missing)

    def close(self) -> None:
        """End the reading and release the files."""
        if self._frames is None:
            self._frames = iter(())
        elif hasattr(self._frames, "close"):
            self._frames.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@dataclass(frozen=True)
class Position:
    """A place in a clip: a frame number or a time in s."""

    value: float
    unit: Literal["frames", "seconds"]

    @classmethod
    def parse(cls, option: str, text: str) -> Position:
        """Read ``120`` (frames), ``4.5s`` or ``[HH:]MM:SS[.fraction]``; anything else is a UsageError."""
        text = text.strip()
        if _FRAMES.fullmatch(text):
            return cls(float(int(text)), "frames")
        if match := _SECONDS.fullmatch(text):
            return cls(float(match[1]), "seconds")
        match = _CLOCK.fullmatch(text)
        if match and float(match[3]) < 60 and (match[1] is None or int(match[2]) < 60):
            return cls(int(match[1] or 0) * 3600 + int(match[2]) * 60 + float(match[3]), "seconds")
        raise UsageError(
            f"{option}: {text!r} is no place in a clip: expected frames as 120, or seconds as 4.5s or 00:01:02.5"
        )

    def is_reached(self, frame: Ints, t_s: Floats) -> Bools:
        """For each frame, whether it lies at or behind this place."""
        return np.asarray((frame if self.unit == "frames" else t_s) >= self.value)


@dataclass(frozen=True)
class Selection:
    """Which frames of a source are wanted: what ``--start``, ``--end`` and ``--stride`` say.

    ``start`` (inclusive) and ``end`` (exclusive) are ``120`` (frame numbers of the source), ``4.5s`` or
    ``00:01:02.5`` (compared with ``t_s``). ``stride`` takes every n-th frame number from the first one on.
    """

    start: str | None = None
    end: str | None = None
    stride: int = 1

    def __post_init__(self) -> None:
        if isinstance(self.stride, bool) or not isinstance(self.stride, int) or self.stride < 1:
            raise UsageError(f"--stride: {self.stride!r} is no step: expected a whole number of frames, 1 or more")
        start, end = self._position("start"), self._position("end")
        if start and end and start.unit == end.unit and end.value <= start.value:
            raise UsageError(
                f"--end: {self.end} is not behind --start {self.start}: nothing would be left, give a later --end"
            )

    def _position(self, name: Literal["start", "end"]) -> Position | None:
        text = getattr(self, name)
        return None if text is None else Position.parse(f"--{name}", str(text))

    def wanted(self, frame: Ints, t_s: Floats) -> Bools:
        """For each frame ``(N,)`` of a source with its time ``(N,)`` in s, whether it is selected."""
        start, end = self._position("start"), self._position("end")
        wanted = np.ones(len(frame), dtype=bool)
        if start:
            wanted &= start.is_reached(frame, t_s)
        if end:
            wanted &= ~end.is_reached(frame, t_s)
        if wanted.any():
            wanted &= (frame - frame[np.argmax(wanted)]) % self.stride == 0
        return wanted

    def require_any(self, path: str, frame: Ints, t_s: Floats) -> Bools:
        """``wanted``, with a UsageError where nothing is: it names what the source has."""
        wanted = self.wanted(frame, t_s)
        if not wanted.any():
            given = [f"--{name} {place}" for name, place in (("start", self.start), ("end", self.end)) if place]
            raise UsageError(
                f"{path}: {' '.join(given)} selects no frame of {len(frame)}: "
                f"expected places within frames {frame[0]}..{frame[-1]} or {t_s.min():.3f}s..{t_s.max():.3f}s"
            )
        return wanted

    def wants_more_after(self, frame: int, t_s: float, dt_s: float) -> bool:
        """Whether a next frame, ``dt_s`` after this one, would lie before the end."""
        end = self._position("end")
        return end is None or end.value > (frame + 1 if end.unit == "frames" else t_s + dt_s)


def median_dt_s(t_s: Floats) -> float:
    """Median time difference in s of times ``(N,)`` in order.

    Duplicated and backward times do not count; ``LONE_FRAME_DT_S`` where no difference is left, so that the
    result is always finite and positive.
    """
    dt_s = np.diff(t_s)
    dt_s = dt_s[dt_s > 0]
    return float(np.median(dt_s)) if len(dt_s) else LONE_FRAME_DT_S


def require_plausible_step(what: str, t_s: Floats) -> None:
    """InputError unless times ``(N,)`` in s can be times: within ``LARGEST_TIME_S``, their median step within
    ``STEP_BOUNDS_S``; ``what`` names them.
    """
    farthest_s = float(t_s[np.argmax(np.abs(t_s))])
    if abs(farthest_s) > LARGEST_TIME_S:
        raise InputError(f"{what} is {farthest_s:g} s: expected at most {LARGEST_TIME_S:g}: is it in seconds?")
    step_s, (least_s, most_s) = median_dt_s(t_s), STEP_BOUNDS_S
    if not least_s <= step_s <= most_s:
        raise InputError(
            f"{what} goes on by {step_s:g} s a frame: expected {least_s:g} to {most_s:g} s: is it in seconds?"
        )


def require_file(path: Path) -> None:
    """InputError unless ``path`` is a readable file that is not empty."""
    if not path.exists():
        remedy = "standard input cannot be read twice: save it as a file" if str(path) == "-" else "check the path"
        raise InputError(f"{path}: no such file or folder: {remedy}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder where a file was expected: name a file in it")
    if not path.is_file():
        raise InputError(f"{path}: is a pipe or a device, and what is read here is read twice: save it as a file")
    try:
        with path.open("rb") as stream:
            is_empty = not stream.read(1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): check its permissions") from None
    if is_empty:
        raise InputError(f"{path}: is empty (0 bytes): copy or record it again")
