"""What comes in, with its times: videos, image folders, track tables."""

from __future__ import annotations

from pathlib import Path

from ttcvid.errors import UsageError
from ttcvid.model import ImageSize
from ttcvid.sources.base import Selection, Source

__all__ = ["Selection", "Source", "open_source"]


def open_source(
    input_: str,
    *,
    selection: Selection = Selection(),  # noqa: B008  a frozen value
    fps: float | None = None,
    timestamps: Path | None = None,
    image_size: ImageSize | None = None,
) -> Source:
    """Open a clip: a video file, an image folder or pattern, or a table of point tracks.

    Parameters
    ----------
    input_
        Path of a video or picture file, of a folder of pictures, of a ``.parquet`` or ``.csv`` track table, or a
        pattern such as ``img_%06d.png`` or ``*.jpg``. What exists under that name goes before its reading as pattern.
    selection
        Which frames are wanted.
    fps, timestamps
        Frame rate in 1/s, or file with one time a line: required for pictures, instead of the container's times
        for a video, refused for tables, which have their own.
    image_size
        Size of the pictures behind a track table; a video or picture of another size is refused.

    Raises
    ------
    InputError
        The input cannot be read.
    UsageError
        An option is missing, or does not go with this input.
    """
    # imported here: PyAV, OpenCV and pyarrow are slow to load, and one input needs one of them
    from ttcvid.sources.clock import Clock
    from ttcvid.sources.images import IMAGE_SUFFIXES, ImageSource, is_pattern, list_pictures
    from ttcvid.sources.tracks import TABLE_SUFFIXES, TrackSource
    from ttcvid.sources.video import VideoSource

    if not input_.strip():
        raise UsageError("INPUT is empty: expected a video, a folder or pattern of pictures, or a track table")
    path = Path(input_)
    clock = Clock(fps, timestamps)
    if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES or (not path.exists() and is_pattern(input_)):
        source: Source = ImageSource(input_, list_pictures(input_), selection, clock)
    elif path.suffix.lower() in TABLE_SUFFIXES:
        return TrackSource(path, selection, clock, image_size)
    else:
        source = VideoSource(path, selection, clock)
    if image_size is not None and image_size != source.info.image_size:
        raise UsageError(
            f"--image-size: {image_size}, but {input_} is {source.info.image_size}: leave the option out for pictures"
        )
    return source
