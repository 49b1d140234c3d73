"""What holds for every kind of source."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from source_clips import (
    FPS,
    HEIGHT,
    REORDERED_ERROR,
    WIDTH,
    N,
    luma,
    track_table,
    write_pictures,
    write_tracks,
    write_video,
)

from ttcvid.errors import UsageError
from ttcvid.model import ImageSize
from ttcvid.sources import Selection, open_source

SIZE = ImageSize(WIDTH, HEIGHT)


@dataclass(frozen=True)
class Clip:
    """An input with N frames at FPS, and what is true of it."""

    input_: str
    options: dict
    kind: str
    time_origin: str
    files: int
    grey: Callable[[int], np.ndarray] | None = luma
    tolerance: float = 0


def mp4(folder: Path) -> Clip:
    return Clip(
        str(write_video(folder / "a.mp4", reordered=True)), {}, "video", "presentation", 1, luma, REORDERED_ERROR
    )


def mkv(folder: Path) -> Clip:
    return Clip(
        str(write_video(folder / "a.mkv", reordered=True)), {}, "video", "presentation", 1, luma, REORDERED_ERROR
    )


def bare_stream_with_fps(folder: Path) -> Clip:
    return Clip(
        str(write_video(folder / "a.h264", reordered=True)), {"fps": FPS}, "video", "fps", 1, luma, REORDERED_ERROR
    )


def folder_with_fps(folder: Path) -> Clip:
    return Clip(str(write_pictures(folder / "p")), {"fps": FPS}, "images", "fps", N)


def printf_with_timestamps(folder: Path) -> Clip:
    write_pictures(folder / "p", name="img_{:06d}.png")
    times = folder / "times.txt"
    times.write_text("".join(f"{i / FPS}\n" for i in range(N)))
    return Clip(str(folder / "p" / "img_%06d.png"), {"timestamps": times}, "images", "timestamps", N + 1)


def glob_of_deep_pictures(folder: Path) -> Clip:
    def deep(index):
        return luma(index).astype(np.uint16) * 16

    write_pictures(folder / "p", name="{}.tif", make=deep)
    low, high = 40, 220
    return Clip(
        str(folder / "p" / "*.tif"),
        {"fps": FPS},
        "images",
        "fps",
        N,
        lambda index: (luma(index).astype(float) - low) * 255 / (high - low),
        tolerance=0.51,  # rounding
    )


def colour_pictures(folder: Path) -> Clip:
    def colour(index):
        return np.dstack([luma(index), luma(index) // 2, 255 - luma(index)])

    write_pictures(folder / "p", name="{}.bmp", make=colour)
    return Clip(
        str(folder / "p"), {"fps": FPS}, "images", "fps", N, lambda i: cv2.cvtColor(colour(i), cv2.COLOR_BGR2GRAY)
    )


def csv(folder: Path) -> Clip:
    return Clip(str(write_tracks(folder / "a.csv")), {"image_size": SIZE}, "tracks", "table", 1, None)


def parquet(folder: Path) -> Clip:
    return Clip(str(write_tracks(folder / "a.parquet")), {"image_size": SIZE}, "tracks", "table", 1, None)


VIDEOS = [mp4, mkv, bare_stream_with_fps]
PICTURES = [*VIDEOS, folder_with_fps, printf_with_timestamps, glob_of_deep_pictures, colour_pictures]
TABLES = [csv, parquet]


@pytest.fixture(params=[*PICTURES, *TABLES], ids=lambda kind: kind.__name__)
def clip(request, tmp_path) -> Clip:
    return request.param(tmp_path)


@pytest.fixture(params=PICTURES, ids=lambda kind: kind.__name__)
def picture_clip(request, tmp_path) -> Clip:
    return request.param(tmp_path)


@pytest.fixture(params=TABLES, ids=lambda kind: kind.__name__)
def table_clip(request, tmp_path) -> Clip:
    return request.param(tmp_path)


def read(clip: Clip, *selection):
    with open_source(clip.input_, selection=Selection(*selection), **clip.options) as source:
        return list(source), source


def test_all_frames_come_in_order_with_their_times(clip):
    frames, source = read(clip)
    assert [frame.index for frame in frames] == list(range(N))
    assert [frame.t_s for frame in frames] == [i / FPS for i in range(N)]
    assert source.n_read == N
    assert (source.report.n_packets_skipped, source.report.is_truncated, source.report.warnings) == (0, False, ())


def test_info_is_known_before_the_first_frame(clip):
    with open_source(clip.input_, **clip.options) as source:
        info = source.info
        assert (info.path, info.kind, info.time_origin) == (clip.input_, clip.kind, clip.time_origin)
        assert (info.image_size, info.n_frames) == (SIZE, N)
        assert info.nominal_dt_s == pytest.approx(1 / FPS, rel=1e-12)
        assert len(source.files) == clip.files
        assert all(path.is_file() for path in source.files)


def test_pictures_are_the_ones_that_were_written(picture_clip):
    frames, source = read(picture_clip)
    for frame in frames:
        assert frame.points is None
        assert frame.grey.dtype == np.uint8
        assert frame.grey.flags.c_contiguous
        assert frame.grey.shape == (source.info.image_size.height_px, source.info.image_size.width_px)
        np.testing.assert_allclose(frame.grey, picture_clip.grey(frame.index), atol=picture_clip.tolerance)


def test_colour_shows_what_grey_shows_in_a_fresh_array(picture_clip):
    frames, _ = read(picture_clip)
    for frame in frames:
        colour = frame.colour()
        assert (colour.shape, colour.dtype) == ((*frame.grey.shape, 3), np.uint8)
        seen = cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)
        # limited range video: grey keeps 16..235, colour shows it as 0..255
        expected = (frame.grey - 16.0) * 255 / 219 if picture_clip.kind == "video" else frame.grey
        np.testing.assert_allclose(seen, expected, atol=2)
        colour[:] = 0
        assert frame.colour().any()


def test_points_are_the_ones_of_the_table(table_clip):
    frames, _ = read(table_clip)
    table = track_table().sort_values(["frame", "track_id"])
    for frame in frames:
        rows = table[table.frame == frame.index]
        assert frame.grey is None
        assert frame.colour is None
        np.testing.assert_array_equal(frame.points.track_id, rows.track_id)
        np.testing.assert_array_equal(frame.points.xy_px, rows[["x_px", "y_px"]])


@pytest.mark.parametrize(
    ("selection", "indices"),
    [
        (("3",), range(3, 12)),
        ((None, "5"), range(5)),
        (("2", "9", 3), [2, 5, 8]),
        ((None, None, 5), [0, 5, 10]),
        (("0.3s",), range(3, 12)),
        (("0.25s", "0.7s"), range(3, 7)),
        (("00:00:00.5", "8"), [5, 6, 7]),
        (("0:01",), [10, 11]),
        (("11", "500"), [11]),
        (("7", "0.9s", 2), [7]),
    ],
)
def test_selection_keeps_source_indices_times_and_pictures(clip, selection, indices):
    frames, source = read(clip, *selection)
    assert [frame.index for frame in frames] == list(indices)
    assert [frame.t_s for frame in frames] == [i / FPS for i in indices]
    assert source.info.n_frames == len(frames) == source.n_read
    assert source.info.nominal_dt_s == pytest.approx(1 / FPS, rel=1e-12)
    assert (source.report.n_packets_skipped, source.report.is_truncated) == (0, False)
    whole = {frame.index: frame for frame in read(clip)[0]}
    for frame in frames:
        np.testing.assert_array_equal(frame.grey, whole[frame.index].grey)


def test_selecting_nothing_is_an_error_that_says_what_there_is(clip):
    with pytest.raises(UsageError, match=r"--start 50 selects no frame of 12.*0\.\.11.*0\.000s\.\.1\.100s"):
        open_source(clip.input_, selection=Selection("50"), **clip.options)


def test_a_source_is_read_once(clip):
    with open_source(clip.input_, **clip.options) as source:
        list(source)
        with pytest.raises(RuntimeError, match="read once"):
            iter(source)


def test_leaving_the_context_ends_the_reading(clip):
    with open_source(clip.input_, **clip.options) as source:
        frames = iter(source)
        assert next(frames).index == 0
    assert list(frames) == []
    assert source.n_read == 1
    source.close()


def test_two_readings_are_identical(clip):
    for one, other in zip(read(clip)[0], read(clip)[0], strict=True):
        assert (one.index, one.t_s) == (other.index, other.t_s)
        np.testing.assert_array_equal(one.grey, other.grey)


def test_image_size_of_a_clip_with_pictures_has_to_agree(picture_clip):
    open_source(picture_clip.input_, **picture_clip.options, image_size=SIZE).close()
    with pytest.raises(UsageError, match=r"--image-size: 64x48, but .* is 70x48"):
        open_source(picture_clip.input_, **picture_clip.options, image_size=ImageSize(64, 48))
