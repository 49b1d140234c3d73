"""The annotated video: H.264 in mp4 that a browser plays, with the source's own times."""

from __future__ import annotations

from contextlib import nullcontext, suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Self

import av
import cv2
import numpy as np

from ttcvid.errors import OutputError
from ttcvid.model import ImageSize, Picture
from ttcvid.sinks.failures import output_errors

MAX_SIDE_PX = 16384
"""What H.264 can hold, and libx264 takes."""
TICKS_PER_S = 90_000  # the clock of broadcast video: exact for the usual frame rates
KEYFRAME_INTERVAL_S = 2.0  # how far back a browser has to decode after a jump
SD_COLOUR = 6  # ITU-T H.273 code of BT.601 (SMPTE 170M), in which OpenCV converts
LIMITED_RANGE = 1  # luma from 16 to 235


class OverlayVideo:
    """Writes pictures to ``path`` as H.264, yuv420p, index first (faststart).

    The first picture stands at time 0, all others at their exact distance from it, to 1/90000 s. A picture whose time
    does not lie after the one before gets that one's time plus one tick: no picture is dropped, order is kept.
    Odd sizes are padded by repeating the last column or row; nothing is scaled.

    Parameters
    ----------
    path : Where to write; mp4 whatever the name.
    image_size : Size of every picture.
    nominal_dt_s : Usual frame interval in s: shows the last picture that long, and spaces the key frames.
    preset, crf : x264's speed and quality (`ttcvid.config.OverlayConfig`).

    Raises
    ------
    OutputError : From any method, where this installation cannot encode H.264 or the file cannot be written.
    """

    def __init__(self, path: Path, image_size: ImageSize, nominal_dt_s: float, preset: str, crf: int) -> None:
        if max(image_size.width_px, image_size.height_px) > MAX_SIDE_PX:
            raise OutputError(
                f"{path}: a video of {image_size} cannot be encoded (at most {MAX_SIDE_PX} px a side): use --no-overlay"
            )
        self._path = path
        self._image_size = image_size
        self._first_t_s: float | None = None
        self._last_tick = -1
        self._is_open = False  # true while pictures have been written and none has failed
        self._duration_ticks = max(1, round(nominal_dt_s * TICKS_PER_S))
        _require_encoder()
        with output_errors(path):
            path.touch()  # PyAV opens the file at the first picture only; what is wrong with the place shows here
            self._container = av.open(local_url(path), "w", format="mp4", options={"movflags": "+faststart"})
        try:
            options = {"preset": preset, "crf": str(crf)}
            self._stream = self._add_stream(nominal_dt_s, options)
        except BaseException:
            self._container.close()
            raise

    def _add_stream(self, nominal_dt_s: float, options: dict[str, str]) -> av.VideoStream:
        rate = Fraction(1 / nominal_dt_s).limit_denominator(1001)
        stream = self._container.add_stream("libx264", rate=max(rate, Fraction(1, 1001)), options=options)
        stream.width = self._image_size.width_px + self._image_size.width_px % 2
        stream.height = self._image_size.height_px + self._image_size.height_px % 2
        stream.pix_fmt = "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS_PER_S)
        context = stream.codec_context
        context.thread_count = 1  # the analysis runs beside
        context.gop_size = max(1, round(KEYFRAME_INTERVAL_S / nominal_dt_s))
        context.color_range = LIMITED_RANGE
        context.colorspace = context.color_primaries = context.color_trc = SD_COLOUR
        return stream

    def write(self, bgr: Picture, t_s: float) -> None:
        """Add a picture, ``(H, W, 3)`` BGR uint8, presented at ``t_s``."""
        size = self._image_size
        if bgr.shape != (size.height_px, size.width_px, 3):
            raise ValueError(f"{self._path}: expected a picture of {size} with 3 channels, got shape {bgr.shape}")
        frame = _video_frame(_yuv_from_bgr(bgr))
        frame.pts = self._next_tick(t_s)
        frame.time_base = Fraction(1, TICKS_PER_S)
        frame.duration = self._duration_ticks
        self._mux(frame)

    def _next_tick(self, t_s: float) -> int:
        if self._first_t_s is None:
            self._first_t_s = t_s
        self._last_tick = max(self._last_tick + 1, round((t_s - self._first_t_s) * TICKS_PER_S))
        return self._last_tick

    def _mux(self, frame: av.VideoFrame | None) -> None:
        # After a failure the container must not be written to again: FFmpeg crashes on a second header.
        self._is_open = False
        with output_errors(self._path):
            self._container.mux(self._stream.encode(frame))
        self._is_open = frame is not None

    def close(self) -> None:
        """Write the pictures that the encoder still holds, and the index. Further calls do nothing.

        After a failed `write` it only lets go of the file, which is of no use then.
        """
        if self._is_open:
            try:
                self._mux(None)
            except OutputError:
                self._let_go()
                raise
            with output_errors(self._path):
                self._container.close()
        else:
            self._let_go()

    def _let_go(self) -> None:
        # The failure that made the file useless has been reported; that it cannot be finished is no news.
        with suppress(av.FFmpegError):
            self._container.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        # What failed first is the error to report, not that the video cannot be finished either.
        with nullcontext() if error is None else suppress(OutputError):
            self.close()


def check_video(path: Path) -> int:
    """Read all packets of a video, decode its key frames, and return the number of its pictures.

    What a full disk or a cut leaves behind shows in the packets, what a decoder refuses in the key frames; to decode
    the pictures between them too would take as long as decoding the input once more.

    Raises
    ------
    OutputError
        Where it cannot be opened or decoded, holds no picture, or fewer than its index lists.
    """
    try:
        with av.open(local_url(path)) as container:
            stream = container.streams.video[0]
            stream.thread_type = "NONE"  # key frames alone: threads would not pay, and may not be allowed
            n_listed, n_pictures, n_key_frames, n_decoded = stream.frames, 0, 0, 0
            for packet in container.demux(stream):
                is_end = packet.size == 0
                n_pictures += not is_end and not packet.is_corrupt
                n_key_frames += packet.is_keyframe
                if packet.is_keyframe or is_end:
                    n_decoded += len(packet.decode())
    except (av.FFmpegError, IndexError) as error:
        reason = " ".join(str(error).split())
        raise OutputError(
            f"{path}: the video just written cannot be decoded ({reason}): run 'ttcvid doctor'"
        ) from error
    if n_pictures == 0 or n_pictures < n_listed or n_decoded < n_key_frames:
        raise OutputError(
            f"{path}: the video just written holds {n_pictures} of {n_listed} pictures, {n_decoded} of {n_key_frames} "
            f"key frames can be decoded: run again, or 'ttcvid doctor'"
        )
    return n_pictures


def local_url(path: Path) -> str:
    """A path as FFmpeg takes it for a file whatever its name: what precedes a colon would be a protocol."""
    return f"file:{path}"


def _require_encoder() -> None:
    try:
        av.codec.Codec("libx264", "w")
    except ValueError as error:
        raise OutputError(
            "libx264: this PyAV has no H.264 encoder: install PyAV's own wheel (pip install --force-reinstall av), "
            "or run with --no-overlay"
        ) from error


def _yuv_from_bgr(bgr: Picture) -> Picture:
    """Planes of yuv420p below each other, from a picture padded to even sides."""
    height, width = bgr.shape[:2]
    if height % 2 or width % 2:
        bgr = np.asarray(cv2.copyMakeBorder(bgr, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE), dtype=np.uint8)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_I420), dtype=np.uint8)


def _video_frame(yuv: Picture) -> av.VideoFrame:
    """The planes of `_yuv_from_bgr` as a frame, copied whole: PyAV's own way goes line by line."""
    frame, flat, start = av.VideoFrame(yuv.shape[1], yuv.shape[0] * 2 // 3, "yuv420p"), yuv.ravel(), 0
    for plane in frame.planes:
        stop = start + plane.height * plane.width
        lines: Picture = np.frombuffer(memoryview(plane), dtype=np.uint8).reshape(-1, plane.line_size)
        lines[: plane.height, : plane.width] = flat[start:stop].reshape(plane.height, plane.width)
        start = stop
    return frame
