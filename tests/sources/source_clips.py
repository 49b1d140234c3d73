"""Tiny clips with known pictures and times, for the tests of the sources."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pandas as pd
import pytest

from ttcvid.sources import Selection, open_source

N = 12
FPS = 10
WIDTH, HEIGHT = 70, 48  # 70: the decoder pads its lines
REORDERED_ERROR = 2  # grey levels that libx264 gets wrong at qp 1
MILLISECOND = Fraction(1, 1000)


def luma(index: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """A noisy picture without any symmetry, another one for each index; values of limited range."""
    picture = np.random.default_rng(index).integers(90, 110, (height, width), dtype=np.uint8)
    picture[: height // 3, : width // 4] = 220
    picture[-4:, :] = 40 + 5 * (index % 30)
    return picture


def yuv_frame(grey: np.ndarray, pixel_format: str = "yuv420p") -> av.VideoFrame:
    height, width = grey.shape
    neutral = np.full((height // 2, width), 128, np.uint8)
    frame = av.VideoFrame.from_ndarray(np.vstack([grey, neutral]), format="yuv420p")
    return frame if pixel_format == "yuv420p" else frame.reformat(format=pixel_format, threads=1)


def write_video(
    path: Path,
    n: int = N,
    *,
    codec: str = "libx264",
    pixel_format: str = "yuv420p",
    pts: list[int] | None = None,
    time_base: Fraction = Fraction(1, FPS),
    key_every: int = 5,
    reordered: bool = False,
    open_gop: bool = False,
    rotation: tuple[float, bool, bool] | None = None,
    aspect: Fraction | None = None,
    container_options: dict[str, str] | None = None,
) -> Path:
    """Pictures ``luma(0), luma(1)...``; ``pts`` in units of ``time_base``.

    libx264 is without loss, or with B frames (``reordered``) and errors up to ``REORDERED_ERROR``.
    """
    h264 = {"qp": "1", "bf": "2", "b_strategy": "0", "sc_threshold": "0"} if reordered else {"qp": "0"}
    if open_gop:
        h264["x264-params"] = "open-gop=1"
    options = h264 if codec.startswith("libx264") else {}
    with av.open(str(path), "w", options=container_options or {}) as container:
        stream = container.add_stream(codec, rate=FPS, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, pixel_format
        stream.gop_size = key_every
        stream.codec_context.time_base = time_base
        if aspect:
            stream.codec_context.sample_aspect_ratio = aspect
        if rotation:
            degrees, flip_x, flip_y = rotation
            stream.set_display_rotation(degrees, hflip=flip_x, vflip=flip_y)
        for index in range(n):
            frame = yuv_frame(luma(index), pixel_format)
            frame.pts, frame.time_base = (pts[index] if pts else index), time_base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def write_pictures(folder: Path, n: int = N, *, name: str = "{}.png", make=luma) -> Path:
    folder.mkdir(exist_ok=True)
    for index in range(n):
        assert cv2.imwrite(str(folder / name.format(index)), make(index))
    return folder


def track_table(n: int = N, n_tracks: int = 3) -> pd.DataFrame:
    """Tracks 7, 5, 3 (descending on purpose) that move by 1 px a frame."""
    rows = [
        (frame, frame / FPS, 2 * (n_tracks - k) + 1, 10.0 * k + frame, 5.0 + k)
        for frame in range(n)
        for k in range(n_tracks)
    ]
    return pd.DataFrame(rows, columns=["frame", "t_s", "track_id", "x_px", "y_px"])


def write_tracks(path: Path, table: pd.DataFrame | None = None) -> Path:
    table = track_table() if table is None else table
    if path.suffix == ".csv":
        table.to_csv(path, index=False)
    else:
        table.to_parquet(path, index=False)
    return path


def packets_of(path: Path) -> list[bytes]:
    """The video packets in file order."""
    with av.open(str(path)) as container:
        return [bytes(packet) for packet in container.demux(video=0) if packet.size]


def damage(path: Path, number: int) -> None:
    """Overwrite one video packet, and leave its container alone."""
    packet = packets_of(path)[number]
    data = path.read_bytes()
    assert data.count(packet) == 1
    path.write_bytes(data.replace(packet, b"\x55" * len(packet)))


def cut(path: Path, share: float) -> Path:
    """Keep the first part of a file."""
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


def read(path, *selection, **options):
    """The frames of a clip, and its source; ``selection`` is start, end and stride."""
    with open_source(str(path), selection=Selection(*selection), **options) as source:
        return list(source), source


def one_line_error(kind, path, **options) -> str:
    """The message of an error that opening or reading has to raise: one line, with the path."""
    with pytest.raises(kind) as caught, open_source(str(path), **options) as source:
        list(source)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message
