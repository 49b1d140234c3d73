"""What comes in, with its times: videos, image folders, track tables."""

from __future__ import annotations

import re
from pathlib import Path

from ttcvid.errors import InputError, UsageError, quoted
from ttcvid.model import ImageSize
from ttcvid.picture_header import MAX_IMAGE_MPX
from ttcvid.sources.base import Selection, Source

__all__ = ["Selection", "Source", "open_source"]

_URL = re.compile(r"[a-z][a-z0-9+.-]+:/", re.IGNORECASE)
"""A protocol has two letters or more, a drive one; `Path` leaves one of its two slashes."""


def open_source(
    input_: str,
    *,
    selection: Selection = Selection(),  # noqa: B008  a frozen value
    fps: float | None = None,
    timestamps: Path | None = None,
    image_size: ImageSize | None = None,
    max_image_mpx: float = MAX_IMAGE_MPX,
) -> Source:
    """Open a clip: a video file, an image folder or pattern, or a table of point tracks.

    Parameters
    ----------
    input_ : Path of a video or picture file, of a folder of pictures, of a ``.parquet`` or ``.csv`` track table, or a
        pattern such as ``img_%06d.png`` or ``*.jpg``. What exists under that name goes before its reading as pattern.
    selection : Which frames are wanted.
    fps, timestamps : Frame rate in 1/s, or file with one time a line: required for pictures, instead of the container's
        times for a video, refused for tables, which have their own.
    image_size : Size of the pictures behind a track table; a video or picture of another size is refused.
    max_image_mpx : Picture files that claim more pixels than this, in 10^6, are left out like those that cannot be
        read.

    Raises
    ------
    InputError : The input cannot be read.
    UsageError : An option is missing, or does not go with this input.
    """
    # imported here: PyAV, OpenCV and pyarrow are slow to load, and one input needs one of them
    from ttcvid.sources.clock import Clock
    from ttcvid.sources.images import IMAGE_SUFFIXES, ImageSource, is_pattern, list_pictures
    from ttcvid.sources.tracks import TABLE_SUFFIXES, TrackSource
    from ttcvid.sources.video import VideoSource

    if not input_.strip():
        raise UsageError("INPUT is empty: expected a video, a folder or pattern of pictures, or a track table")
    path = Path(input_)
    _require_place(path, input_)
    clock = Clock(fps, timestamps)
    if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES or (not path.exists() and is_pattern(input_)):
        source: Source = ImageSource(input_, list_pictures(input_), selection, clock, max_image_mpx)
    elif path.suffix.lower() in TABLE_SUFFIXES:
        return TrackSource(path, selection, clock, image_size)
    else:
        source = VideoSource(path, selection, clock)
    if image_size is not None and image_size != source.info.image_size:
        raise UsageError(
            f"--image-size: {image_size}, but {input_} is {source.info.image_size}: leave the option out for pictures"
        )
    return source


def _require_place(path: Path, input_: str) -> None:
    """InputError where INPUT is no place in the file system."""
    try:
        exists = path.exists()
    except OSError as error:  # too long a name, a folder that may not be looked into
        raise InputError(f"{quoted(input_)}: cannot be found ({error.strerror}): check the path") from None
    if not exists and _URL.match(input_):
        raise InputError(f"{input_}: URLs are not read: download the clip and give the file")
