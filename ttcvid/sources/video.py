"""Video files: frames with their exact presentation times."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from av.video.frame import VideoFrame

from ttcvid.errors import InputError, UsageError
from ttcvid.model import Floats, Frame, ImageSize, Ints, Picture, SourceInfo
from ttcvid.sources.base import OnePassSource, Selection, require_file
from ttcvid.sources.clock import Clock
from ttcvid.sources.decoding import decode
from ttcvid.sources.packets import PacketIndex, index_packets, open_video
from ttcvid.sources.pictures import Orientation, colour_picture, grey_picture


class VideoSource(OnePassSource):
    """A video file, upright, with ``t_s`` = pts x time base of the container (or what ``clock`` says instead).

    Times may be unevenly spaced, stand still or run backward: they are passed on as they are. ``frame`` is the
    place in the order of presentation of all frames of the file: a frame that cannot be decoded, or only from damaged
    packets, leaves a gap and is counted in ``n_packets_skipped``. ``is_truncated``: the file ends, or its pictures do,
    earlier than its own index or header says, within what the selection asks for. Frames that the decoder calls
    damaged are passed on and counted.

    Raises InputError where the file is no video, holds none, or nothing in it can be decoded, and where the size
    of the picture changes on the way; UsageError where the file knows no times and ``clock`` gives none.
    """

    def __init__(self, path: Path, selection: Selection, clock: Clock) -> None:
        require_file(path)
        self._path = path
        self._selection = selection
        self._index = index_packets(path)
        self._orientation, size, warnings = _probe(path, self._index)
        n = self._index.n_frames
        times_s = clock.times_s(n, f"frames in {path}")
        if times_s is None:
            times_s = self._index.times_s()
        if times_s is None:
            raise UsageError(
                f"{path}: a bare stream holds no times: give --fps or --timestamps (they are never guessed)"
            )
        self._times_s: Floats = times_s
        frames: Ints = np.arange(n)
        self._wanted = selection.require_any(str(path), frames, times_s)
        info = SourceInfo(
            path=str(path),
            kind="video",
            image_size=size,
            nominal_dt_s=clock.nominal_dt_s(times_s),
            n_frames=int(self._wanted.sum()),
            time_origin=clock.origin or "presentation",
        )
        super().__init__(info, (path, *clock.files), warnings)
        self.n_missing = self._index.n_missing

    def frames(self) -> Iterator[Frame]:
        """The selected frames; decoding starts at a keyframe before the first and ends with the last."""
        first, last = (int(i) for i in np.flatnonzero(self._wanted)[[0, -1]])
        due = first  # the frame that comes next if nothing is missing
        for index, picture in self._decoded(first, last):
            self.n_skipped += min(index, last + 1) - due
            due = index + 1
            if index <= last and self._wanted[index]:
                yield self._frame(index, picture)
        self._judge_end(due, last)

    def _decoded(self, first: int, last: int) -> Iterator[tuple[int, VideoFrame]]:
        """Frames from ``first`` to ``last``; where ``last`` cannot be decoded, to the next one that can."""
        container, stream = open_video(self._path, self._index.stream)
        with container:
            entry_packet = int(self._index.entry_packet[first : last + 1].min())
            pictures = decode(container, stream, self._index, entry_packet)
            for index, picture in self._index.number(pictures):
                if index >= first:
                    yield index, picture
                if index >= last:
                    return

    def _frame(self, index: int, picture: VideoFrame) -> Frame:
        orientation = self._orientation
        size = orientation.size(picture)
        if size != self.info.image_size:
            raise InputError(
                f"{self._path}: frame {index} is {size}, the frames before it {self.info.image_size}: expected one "
                f"size throughout, cut the clip there (--end {index})"
            )
        self.n_corrupt += picture.is_corrupt
        grey = orientation.upright(grey_picture(picture))
        return Frame(index, float(self._times_s[index]), grey, None, _colour(orientation, picture))

    def _judge_end(self, due: int, last: int) -> None:
        """Tell a clip that ends too early from one that was read as asked, and say what was lost."""
        if self.n_read == 0:
            raise InputError(
                f"{self._path}: none of the {self.info.n_frames} selected frames can be decoded: copy the clip again "
                f"or select others (--start, --end)"
            )
        end = self._index.n_frames - 1
        wants_more = self._selection.wants_more_after(end, float(self._times_s[end]), self.info.nominal_dt_s)
        self.is_truncated = due <= last or (self._index.is_cut and wants_more)
        if self._index.n_missing:
            self.warnings += (
                f"{self._path}: about {self._index.n_missing} frames are missing where the file is damaged: the times "
                "jump over them",
            )
        if self.n_corrupt:
            self.warnings += (
                f"{self._path}: {self.n_corrupt} frames are damaged, and analysed as the decoder patched them up, with "
                "what is made from them up to the next keyframe: copy the clip again",
            )
        if self._index.damaged:
            self.warnings += (
                f"{self._path}: {len(self._index.damaged)} packets are damaged: what is made from them, mostly "
                "all up to the next keyframe, is left out",
            )
        if self.n_skipped:
            self.warnings += (f"{self._path}: {self.n_skipped} frames cannot be decoded and are left out",)
        if self.is_truncated:
            self.warnings += (f"{self._path}: ends early, after frame {due - 1}: the file is cut or damaged there",)


def _colour(orientation: Orientation, picture: VideoFrame) -> Callable[[], Picture]:
    """A function that keeps this one decoded frame alive, and nothing else."""
    return lambda: orientation.upright(colour_picture(picture))


def _probe(path: Path, index: PacketIndex) -> tuple[Orientation, ImageSize, tuple[str, ...]]:
    """What only a decoded picture tells: how the clip is turned, its upright size, and what is odd about it."""
    container, stream = open_video(path, index.stream)
    with container:
        picture = next((picture for picture in decode(container, stream, index, 0) if picture is not None), None)
        aspect = stream.sample_aspect_ratio
    if picture is None:
        raise InputError(f"{path}: no picture in it can be decoded: it is cut or damaged, copy or record it again")
    orientation = Orientation.of(picture)
    warnings = []
    if index.n_streams > 1:
        warnings.append(
            f"{path}: holds {index.n_streams} video streams: number {index.stream} is analysed, "
            f"{orientation.size(picture)}; for another copy it out (ffmpeg -i {path.name} -map 0:N -c copy other.mkv)"
        )
    if not orientation.is_exact:
        warnings.append(f"{path}: is to be shown turned by {picture.rotation} deg: taken as the nearest right angle")
    if aspect and aspect != 1:
        warnings.append(f"{path}: its pixels are not square ({aspect}): the camera's fx and fy have to say so")
    return orientation, orientation.size(picture), tuple(warnings)
