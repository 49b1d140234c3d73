"""Video files: exact times, upright pictures."""

import weakref
from fractions import Fraction

import av
import numpy as np
import pytest
from source_clips import (
    FPS,
    HEIGHT,
    MILLISECOND,
    REORDERED_ERROR,
    WIDTH,
    N,
    luma,
    one_line_error,
    packets_of,
    read,
    write_pictures,
    write_video,
)

from ttcvid.errors import UsageError
from ttcvid.model import ImageSize
from ttcvid.sources import open_source
from ttcvid.sources.pictures import colour_picture

UNEVEN_MS = [0, 40, 100, 101, 250, 251, 252, 400, 1000, 1033, 1066, 1100]


def test_the_test_clips_hold_reordered_frames(tmp_path):
    with av.open(str(write_video(tmp_path / "a.mp4", reordered=True))) as container:
        pts = [packet.pts for packet in container.demux(video=0) if packet.size]
    assert pts != sorted(pts)


@pytest.mark.parametrize("name", ["a.mkv", "a.mp4", "a.ts"])
def test_uneven_times_are_exact(tmp_path, name):
    frames, source = read(write_video(tmp_path / name, pts=UNEVEN_MS, time_base=MILLISECOND, reordered=True))
    start_s = frames[0].t_s  # a transport stream does not start at 0
    np.testing.assert_allclose([f.t_s - start_s for f in frames], np.array(UNEVEN_MS) / 1000, atol=1e-12)
    assert source.info.nominal_dt_s == pytest.approx(0.034)
    for frame in frames:
        np.testing.assert_allclose(frame.grey, luma(frame.index), atol=REORDERED_ERROR)


def test_times_are_pts_times_time_base_to_the_last_bit(tmp_path):
    time_base = Fraction(1001, 30000)
    frames, _ = read(write_video(tmp_path / "a.mp4", n=40, time_base=time_base))
    assert [frame.t_s for frame in frames] == [float(i * time_base) for i in range(40)]


@pytest.mark.parametrize("name", ["a.mkv", "a.mp4"])
def test_a_start_behind_zero_is_kept(tmp_path, name):
    frames, _ = read(write_video(tmp_path / name, n=3, pts=[700, 800, 900], time_base=MILLISECOND))
    assert [frame.t_s for frame in frames] == [0.7, 0.8, 0.9]


def test_duplicated_times_are_passed_on(tmp_path):
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuvj420p"
        for pts in (0, 40, 40, 80):
            frame = av.VideoFrame(WIDTH, HEIGHT, "yuvj420p")
            frame.pts = None
            for packet in stream.encode(frame):
                packet.pts = packet.dts = pts
                packet.time_base = MILLISECOND
                container.mux(packet)
    frames, source = read(path)
    assert [(frame.index, frame.t_s) for frame in frames] == [(0, 0.0), (1, 0.04), (2, 0.04), (3, 0.08)]
    assert source.report.n_packets_skipped == 0


def test_a_clock_that_starts_anew_does_not_mix_the_frames(tmp_path):
    path = tmp_path / "a.ts"
    one = write_video(tmp_path / "one.ts", reordered=True).read_bytes()
    path.write_bytes(one + one)
    frames, source = read(path)
    assert [frame.index for frame in frames] == list(range(2 * N))
    assert [round(f.t_s - frames[0].t_s, 9) for f in frames] == [i / FPS for i in range(N)] * 2
    assert source.info.nominal_dt_s == pytest.approx(1 / FPS)
    for frame in frames:
        np.testing.assert_allclose(frame.grey, luma(frame.index % N), atol=REORDERED_ERROR)


def test_an_avi_with_reordered_frames_is_put_in_order(tmp_path):
    frames, _ = read(write_video(tmp_path / "a.avi", reordered=True))
    assert [frame.index for frame in frames] == list(range(N))
    np.testing.assert_allclose(np.diff([frame.t_s for frame in frames]), 1 / FPS)
    for frame in frames:
        np.testing.assert_allclose(frame.grey, luma(frame.index), atol=REORDERED_ERROR)


@pytest.mark.parametrize("open_gop", [False, True])
@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.ts", "a.avi"])
def test_reading_from_any_frame_on_gives_the_pictures_of_the_whole(tmp_path, name, open_gop):
    path = write_video(tmp_path / name, n=25, key_every=6, reordered=True, open_gop=open_gop)
    whole, _ = read(path)
    for start in range(25):
        frames, source = read(path, str(start), str(start + 2))
        assert [frame.index for frame in frames] == list(range(start, min(start + 2, 25)))
        assert source.report.n_packets_skipped == 0
        for frame in frames:
            np.testing.assert_array_equal(frame.grey, whole[frame.index].grey)


def test_fps_and_timestamps_go_before_the_container(tmp_path):
    path = write_video(tmp_path / "a.mp4")
    frames, source = read(path, fps=4.0)
    assert [frame.t_s for frame in frames] == [i / 4 for i in range(N)]
    assert (source.info.time_origin, source.info.nominal_dt_s) == ("fps", 0.25)
    times = tmp_path / "times.txt"
    times.write_text("".join(f"{t / 1000}\n" for t in UNEVEN_MS))
    frames, source = read(path, "0.1s", "0.3s", timestamps=times)
    assert [(frame.index, frame.t_s) for frame in frames] == [(2, 0.1), (3, 0.101), (4, 0.25), (5, 0.251), (6, 0.252)]
    assert source.info.time_origin == "timestamps"
    assert source.files == (path, times)


@pytest.mark.parametrize("name", ["a.h264", "a.mjpeg"])
def test_a_bare_stream_needs_times(tmp_path, name):
    codec = {"codec": "mjpeg", "pixel_format": "yuvj420p"} if name == "a.mjpeg" else {}
    path = write_video(tmp_path / name, **codec)
    assert "give --fps or --timestamps" in one_line_error(UsageError, path)
    assert len(read(path, fps=5)[0]) == N


@pytest.mark.parametrize(
    ("rotation", "turn"),
    [
        ((0, False, False), lambda p: p),
        ((90, False, False), lambda p: np.rot90(p, 1)),  # shown turned by 90 deg counterclockwise
        ((180, False, False), lambda p: np.rot90(p, 2)),
        ((270, False, False), lambda p: np.rot90(p, 3)),
        ((-90, False, False), lambda p: np.rot90(p, 3)),
        ((0, True, False), lambda p: p[:, ::-1]),
        ((0, False, True), lambda p: p[::-1]),
        ((90, True, False), lambda p: np.rot90(p, 1)[:, ::-1]),
    ],
)
def test_pictures_are_brought_upright(tmp_path, rotation, turn):
    frames, source = read(write_video(tmp_path / "a.mp4", n=2, rotation=rotation))
    plain, _ = read(write_video(tmp_path / "b.mp4", n=2))
    expected = turn(luma(1))
    assert source.info.image_size == ImageSize(expected.shape[1], expected.shape[0])
    np.testing.assert_array_equal(frames[1].grey, expected)
    np.testing.assert_array_equal(frames[1].colour(), turn(plain[1].colour()))
    assert frames[1].grey.flags.c_contiguous
    assert source.report.warnings == ()


def test_the_display_matrix_of_a_telephone_held_upright_turns_clockwise(tmp_path):
    # ISO 14496-12: (p, q) goes to (a p + c q, b p + d q); a = 0, b = 1, c = -1, d = 0 sends the top left corner
    # of the stored picture to the top right one
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FPS, options={"qp": "0"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.set_display_matrix([0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30])
        grey = luma(0)
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.vstack([grey, grey[: HEIGHT // 2]]), "yuv420p")))
        container.mux(stream.encode(None))
    upright = read(path)[0][0].grey
    assert upright.shape == (WIDTH, HEIGHT)
    assert upright[0, -1] == 220 != upright[0, 0]


def test_a_slanted_rotation_is_rounded_and_said(tmp_path):
    _, source = read(write_video(tmp_path / "a.mp4", n=2, rotation=(100, False, False)))
    assert source.info.image_size == ImageSize(HEIGHT, WIDTH)
    assert "nearest right angle" in source.report.warnings[0]


def test_pixels_that_are_not_square_are_said(tmp_path):
    _, source = read(write_video(tmp_path / "a.mp4", n=2, aspect=Fraction(4, 3)))
    assert "not square (4/3)" in source.report.warnings[0]


@pytest.mark.parametrize("pixel_format", ["yuv422p", "yuv444p", "yuvj420p", "gray", "nv12"])
def test_8_bit_luma_is_taken_as_it_is(tmp_path, pixel_format):
    frames, _ = read(write_video(tmp_path / "a.mkv", n=3, pixel_format=pixel_format))
    full_range = pixel_format in ("yuvj420p", "gray")  # converted on the way into the test clip
    expected = np.rint((luma(2) - 16.0) * 255 / 219) if full_range else luma(2)
    np.testing.assert_allclose(frames[2].grey, expected, atol=2 if full_range else 0)


@pytest.mark.parametrize(
    ("codec", "pixel_format"),
    [
        ("ffv1", "yuv420p10le"),
        ("ffv1", "gray16le"),
        ("ffv1", "bgr0"),
        ("rawvideo", "yuyv422"),
        ("libx264", "yuv420p10le"),
    ],
)
def test_other_formats_are_converted(tmp_path, codec, pixel_format):
    frames, _ = read(write_video(tmp_path / "a.mkv", n=2, codec=codec, pixel_format=pixel_format))
    assert frames[1].grey.shape == (HEIGHT, WIDTH)
    np.testing.assert_allclose(frames[1].grey, (luma(1) - 16.0) * 255 / 219, atol=3)


def test_a_single_frame_is_read(tmp_path):
    frames, source = read(write_video(tmp_path / "a.mp4", n=1))
    assert [frame.index for frame in frames] == [0]
    assert source.info.nominal_dt_s > 0


def test_names_with_colons_percents_and_brackets_are_names(tmp_path):
    for name in ("10:30.mp4", "a%03d.mp4", "a[1]*.mp4", "http:x.mp4"):
        assert len(read(write_video(tmp_path / "x.mp4").rename(tmp_path / name))[0]) == N


def test_passed_frames_are_let_go(tmp_path):
    with open_source(str(write_video(tmp_path / "a.mp4"))) as source:
        passed = []
        for frame in source:
            passed.append(weakref.ref(frame.colour))
            assert sum(reference() is not None for reference in passed) <= 2


def test_fps_and_timestamps_together_are_an_error(tmp_path):
    with pytest.raises(UsageError, match="give only one"):
        open_source(str(write_pictures(tmp_path / "p")), fps=3, timestamps=tmp_path / "t.txt")


@pytest.mark.parametrize("fps", [0, -1, 1e-300, 1e308, float("nan"), float("inf")])
def test_a_frame_rate_is_finite_and_positive(tmp_path, fps):
    with pytest.raises(UsageError, match="--fps"):
        open_source(str(write_video(tmp_path / "a.mp4")), fps=fps)


def test_every_packet_of_the_test_clips_is_a_frame(tmp_path):
    assert len(packets_of(write_video(tmp_path / "a.mkv"))) == N


def test_a_frame_that_is_stored_as_it_is_shown_is_not_drawn_on():
    frame = av.VideoFrame.from_ndarray(np.dstack([luma(0)] * 3), format="bgr24")
    colour_picture(frame)[:] = 0
    np.testing.assert_array_equal(colour_picture(frame)[:, :, 1], luma(0))
