"""Pictures in files of their own: folders, printf and glob patterns."""

from __future__ import annotations

import glob
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ttcvid.errors import InputError, UsageError
from ttcvid.model import Floats, Frame, ImageSize, Picture, SourceInfo
from ttcvid.picture_header import MAX_IMAGE_MPX, size_in_header
from ttcvid.plain_files import read_plain
from ttcvid.sources.base import OnePassSource, Selection, require_file
from ttcvid.sources.clock import Clock

IMAGE_SUFFIXES = frozenset(
    [".png", ".jpg", ".jpeg", ".jp2", ".bmp", ".tif", ".tiff", ".webp", ".avif", ".pgm", ".ppm", ".pnm", ".pbm"]
)
SAME_KIND = {".jpeg": ".jpg", ".tiff": ".tif"}

MAX_FILE_BYTES = 2_000_000_000
DEPTH_SAMPLES = 5
"""Pictures, evenly spread over the clip, from which the range of deep pictures is taken."""

DEPTH_PERCENTILES = (0.1, 99.9)
"""Range of deep pictures that is kept; single hot or dead pixels do not count."""

_PNG_START, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND"
_LONGER_STEP = 1.5
"""Times see that a picture is missing where their step is longer by this than where none is."""
_PRINTF = re.compile(r"%(0?)(\d*)d")


class ImageSource(OnePassSource):
    """Pictures in natural order (``2.png`` before ``10.png``), upright as their EXIF data say.

    ``frame`` is the place in that order, whatever the numbers in the names. Times come from ``clock``, and
    without one there is a UsageError. 8 bit grey is taken as it is; colour becomes grey as in OpenCV, alpha is
    left out. 16 bit pictures are brought to 8 bit by one scale for the whole clip (``DepthScale``).

    A picture that cannot be read, or claims more than ``max_image_mpx`` million pixels, leaves a gap and is counted in
    ``n_packets_skipped``; where the last ones of the clip cannot be read, its recording broke off: ``is_truncated``.
    Raises InputError where none can be read, and where size or depth change on the way.
    """

    def __init__(
        self, path: str, pictures: list[Path], selection: Selection, clock: Clock, max_image_mpx: float = MAX_IMAGE_MPX
    ) -> None:
        times_s = clock.times_s(len(pictures), f"images in {path}")
        if times_s is None:
            raise UsageError(f"{path}: images hold no times: give --fps or --timestamps (they are never guessed)")
        self._times_s: Floats = times_s
        self._first_lost: int | None = None
        self._wanted = selection.require_any(path, np.arange(len(pictures)), times_s)
        self._max_image_mpx = max_image_mpx
        first = _first_readable(path, pictures, max_image_mpx)
        self._dtype = first.dtype
        self._scale = DepthScale.of(pictures, max_image_mpx) if first.dtype == np.uint16 else None
        info = SourceInfo(
            path=path,
            kind="images",
            image_size=_size(first),
            nominal_dt_s=clock.nominal_dt_s(times_s),
            n_frames=int(self._wanted.sum()),
            time_origin=str(clock.origin),
        )
        super().__init__(info, (*pictures, *clock.files), _gaps_in_numbers(path, pictures, times_s, clock))

    def frames(self) -> Iterator[Frame]:
        """The selected frames; the pictures between them (``stride``) are not read."""
        lost: list[int] = []
        for index in np.flatnonzero(self._wanted).tolist():
            picture = read_picture(self.files[index], self._max_image_mpx)
            if picture is None:
                self._first_lost = index if self._first_lost is None else self._first_lost
                lost.append(index)
                continue
            self.n_skipped += len(lost)
            lost = []
            yield self._frame(index, picture)
        self._judge_end(lost)

    def _frame(self, index: int, picture: NDArray[np.uint8 | np.uint16]) -> Frame:
        self._require_alike(self.files[index], picture)
        shown = self._scale.to_8_bit(picture) if self._scale else picture.astype(np.uint8, copy=False)
        is_grey = shown.ndim == 2
        grey = shown if is_grey else np.asarray(cv2.cvtColor(shown, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        return Frame(index, float(self._times_s[index]), grey, None, _colour(shown))

    def _require_alike(self, path: Path, picture: NDArray[np.uint8 | np.uint16]) -> None:
        if _size(picture) != self.info.image_size:
            raise InputError(
                f"{path}: is {_size(picture)}, the images before it {self.info.image_size}: expected one size "
                f"throughout, take it out or choose by a pattern"
            )
        if picture.dtype != self._dtype:
            raise InputError(
                f"{path}: is {picture.dtype}, the images before it {self._dtype}: expected one depth throughout, "
                f"take it out or choose by a pattern"
            )

    def _judge_end(self, lost: list[int]) -> None:
        """Tell a clip that ends too early from one that was read as asked, and say what was lost."""
        if self.n_read == 0:
            raise InputError(
                f"{self.info.path}: none of the {self.info.n_frames} selected images can be read: "
                f"copy them again or select others (--start, --end)"
            )
        self.is_truncated = bool(lost) and lost[-1] + 1 == len(self._wanted)
        if not self.is_truncated:
            self.n_skipped += len(lost)
        if self.n_skipped and self._first_lost is not None:
            first = self.files[self._first_lost]
            self.warnings += (
                f"{self.info.path}: {self.n_skipped} images cannot be read and are left out, {first.name} is the first"
                f"{_complaint_about_size(first, self._max_image_mpx)}",
            )
        if self.is_truncated:
            first = self.files[lost[0]]
            self.warnings += (
                f"{self.info.path}: the last {len(lost)} images cannot be read, from {first.name} on: the clip is cut "
                f"short{_complaint_about_size(first, self._max_image_mpx)}",
            )


@dataclass(frozen=True)
class DepthScale:
    """The one linear scale that brings the 16 bit pictures of a clip to 8 bit.

    ``low`` becomes 0 and ``high`` 255; what lies outside is cut off. Cameras of 10, 12 and 14 bits and thermal
    ones fill a small part of the 16 bits only, so the range is that of ``DEPTH_SAMPLES`` pictures spread over the
    whole clip, between ``DEPTH_PERCENTILES``. It does not depend on the selection.
    """

    low: float
    high: float

    @classmethod
    def of(cls, pictures: list[Path], max_image_mpx: float) -> DepthScale:
        """The scale of a clip; pictures that cannot be read do not count."""
        places = np.unique(np.linspace(0, len(pictures) - 1, DEPTH_SAMPLES).round().astype(int))
        read = (read_picture(pictures[i], max_image_mpx) for i in places)
        samples = [picture for picture in read if picture is not None]
        ranges = [np.percentile(sample, DEPTH_PERCENTILES) for sample in samples]
        low = float(min((low for low, _ in ranges), default=0))
        high = float(max((high for _, high in ranges), default=np.iinfo(np.uint16).max))
        return cls(low, max(high, low + 1))

    def to_8_bit(self, picture: NDArray[np.uint8 | np.uint16]) -> Picture:
        """A 16 bit picture (H, W) or (H, W, 3) as uint8."""
        scaled = (picture.astype(np.float32) - np.float32(self.low)) * np.float32(255 / (self.high - self.low))
        return np.asarray(np.clip(np.rint(scaled), 0, 255), dtype=np.uint8)


def read_picture(path: Path, max_image_mpx: float = MAX_IMAGE_MPX) -> NDArray[np.uint8 | np.uint16] | None:
    """A picture file upright, (H, W) grey or (H, W, 3) BGR without alpha; None where it cannot be read.

    One that claims more than ``max_image_mpx`` million pixels is not read either. Raises InputError where a picture can
    be read but is neither 8 nor 16 bit.
    """
    try:
        content = read_plain(path, MAX_FILE_BYTES)
    except OSError:
        return None
    size = size_in_header(content)
    if size is None or _is_cut_png(content):
        return None
    if size[0] * size[1] > max_image_mpx * 1e6:
        return None
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what cannot be read is told in our own words
    try:
        picture = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    except cv2.error:
        return None  # a damaged file, or one beyond OpenCV's own bounds
    finally:
        cv2.utils.logging.setLogLevel(level)
    if picture is None:
        return None
    if picture.dtype == np.uint8:
        return picture.astype(np.uint8, copy=False)
    if picture.dtype == np.uint16:
        return picture.astype(np.uint16, copy=False)
    raise InputError(f"{path}: holds {picture.dtype} pixels: expected 8 or 16 bit whole numbers, convert it")


def _is_cut_png(data: bytes) -> bool:
    """Whether a PNG file has no end; libpng would complain of it on the terminal."""
    return data.startswith(_PNG_START) and _PNG_END not in data


def list_pictures(input_: str) -> list[Path]:
    """The picture files that a folder, a printf pattern, a glob pattern or a file name means, in natural order.

    Raises InputError where there are none, and UsageError where a folder holds pictures of several kinds.
    """
    path = Path(input_)
    if path.is_dir():
        named = [p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]
        pictures = [p for p in named if not p.is_dir()]
        _require_one_kind(input_, pictures)
    elif path.exists():
        require_file(path)
        pictures = [path]
    elif _PRINTF.search(path.name):
        name = re.compile(_PRINTF.sub(_digits, re.escape(path.name)))
        pictures = [p for p in path.parent.iterdir() if name.fullmatch(p.name)] if path.parent.is_dir() else []
    else:
        # A folder that is there is meant as it is spelled: brackets are ordinary in names.
        folder = glob.escape(str(path.parent)) if path.parent.is_dir() else str(path.parent)
        pictures = [Path(p) for p in glob.glob(f"{folder}/{path.name}") if Path(p).is_file()]
    pictures = [p for p in pictures if p.is_file() or not p.exists()]  # a pipe is no picture, a lost file is a lost one
    if not pictures:
        raise InputError(f"{input_}: no images there: expected a folder, or a pattern such as img_%06d.png or '*.jpg'")
    return sorted(pictures, key=natural_key)


def is_pattern(input_: str) -> bool:
    """Whether an input that is no file is a printf or glob pattern."""
    return bool(_PRINTF.search(Path(input_).name)) or glob.has_magic(input_)


def natural_key(path: Path) -> list[tuple[int, int, str]]:
    """Order in which ``img2`` stands before ``img10``; equal numbers (``1``, ``01``) by their text."""
    parts = re.split(r"(\d+)", str(path))
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part) for part in parts if part]


def _digits(match: re.Match[str]) -> str:
    """``%06d`` as a regular expression: as many digits at least, and more only without leading zero."""
    width = int(match[2] or 1)
    return rf"(?:\d{{{width}}}|[1-9]\d{{{width},}})"


def _require_one_kind(input_: str, pictures: list[Path]) -> None:
    kinds = Counter(SAME_KIND.get(p.suffix.lower(), p.suffix.lower()) for p in pictures)
    if len(kinds) > 1:
        counts = ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items()))
        raise UsageError(f"{input_}: holds images of several kinds ({counts}): choose by a pattern such as '*.png'")


def _gaps_in_numbers(path: str, pictures: list[Path], times_s: Floats, clock: Clock) -> tuple[str, ...]:
    """A warning where names count 1, 2, 4, and the times do not see that a picture is missing."""
    numbers = [re.findall(r"\d+", p.stem)[-1:] for p in pictures]
    if len(pictures) < 3 or not all(numbers):
        return ()
    steps, steps_s = np.diff([float(number[0]) for number in numbers]), np.diff(times_s)
    if steps.min() != 1:
        return ()
    is_unseen = (steps > 1) & (steps_s < _LONGER_STEP * np.median(steps_s[steps == 1]))
    if not is_unseen.any():
        return ()
    n = int((steps[is_unseen] - 1).sum())
    remedy = "--fps counts images, give --timestamps" if clock.fps else "the times go on evenly there, mend the file"
    return (f"{path}: {n} numbers are missing in the file names: {remedy} if time passed",)


def _first_readable(path: str, pictures: list[Path], max_image_mpx: float) -> NDArray[np.uint8 | np.uint16]:
    for name in pictures:
        if (picture := read_picture(name, max_image_mpx)) is not None:
            return picture
    raise InputError(
        f"{path}: none of its {len(pictures)} images can be read: copy or convert them again"
        f"{_complaint_about_size(pictures[0], max_image_mpx)}"
    )


def _complaint_about_size(path: Path, max_image_mpx: float) -> str:
    """What to add of a picture that was left out for what it claims; empty for others."""
    try:
        size = size_in_header(read_plain(path, MAX_FILE_BYTES))
    except OSError:
        return ""
    if size is None or size[0] * size[1] <= max_image_mpx * 1e6:
        return ""
    return f" ({path.name} claims {size[0]}x{size[1]} px: raise --max-image-mpx if it is meant)"


def _size(picture: NDArray[np.uint8 | np.uint16]) -> ImageSize:
    return ImageSize(width_px=picture.shape[1], height_px=picture.shape[0])


def _colour(shown: Picture) -> Callable[[], Picture]:
    """A function that keeps this one picture alive, and nothing else."""
    if shown.ndim == 3:
        return lambda: shown.copy()
    return lambda: np.asarray(cv2.cvtColor(shown, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
