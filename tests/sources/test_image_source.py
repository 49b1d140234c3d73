"""Image folders and patterns: order, depth, alpha, EXIF, times."""

import struct

import cv2
import numpy as np
import pytest
from source_clips import FPS, HEIGHT, WIDTH, N, luma, write_pictures

from ttcvid.errors import InputError, UsageError
from ttcvid.model import ImageSize
from ttcvid.sources import Selection, open_source
from ttcvid.sources.images import natural_key

KITTI_TIMES = ["2011-09-26 23:59:59.964389445", "2011-09-27 00:00:00.068018764", "2011-09-27 00:00:00.1715"]


def read(input_, *selection, **options):
    options = {"fps": FPS} | options
    with open_source(str(input_), selection=Selection(*selection), **options) as source:
        return list(source), source


def one_line_error(kind, input_, **options) -> str:
    with pytest.raises(kind) as caught:
        read(input_, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def save_as_exif(path, picture, orientation: int) -> None:
    """A JPEG whose EXIF orientation tag (0x0112) is set."""
    data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    body = b"Exif\0\0" + tiff
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:])


def test_order_is_natural_not_alphabetic(tmp_path):
    frames, source = read(write_pictures(tmp_path / "p", name="img{}.png"))
    assert [path.name for path in source.files] == [f"img{i}.png" for i in range(N)]
    np.testing.assert_array_equal(frames[10].grey, luma(10))


def test_natural_order_of_mixed_names(tmp_path):
    names = ["a", "a1", "a01", "a2b3", "a2b10", "a10", "b"]
    assert [p.name for p in sorted((tmp_path / n for n in reversed(names)), key=natural_key)] == [
        "a",
        "a01",
        "a1",
        "a2b3",
        "a2b10",
        "a10",
        "b",
    ]


def test_a_folder_takes_its_pictures_alone(tmp_path):
    folder = write_pictures(tmp_path / "p", n=3)
    (folder / "notes.txt").write_text("no picture")
    (folder / ".hidden.png").write_text("no picture")
    (folder / "sub").mkdir()
    (folder / "thumbnails.png").mkdir()
    assert len(read(folder)[0]) == 3


def test_a_folder_with_two_kinds_of_pictures_is_ambiguous(tmp_path):
    folder = write_pictures(tmp_path / "p", n=3)
    write_pictures(folder, n=2, name="{}.jpg")
    assert "several kinds (2 .jpg, 3 .png): choose by a pattern" in one_line_error(UsageError, folder)
    assert len(read(folder / "*.jpg")[0]) == 2


@pytest.mark.parametrize(
    ("pattern", "names", "taken"),
    [
        ("img_%06d.png", "img_{:06d}.png", N),
        ("img_%d.png", "img_{}.png", N),
        ("%02d.png", "{:02d}.png", N),
        ("%06d.png", "{}.png", 0),  # not padded
        ("x%d.png", "img_{}.png", 0),
        ("*.png", "{}.png", N),
        ("1?.png", "{}.png", 2),
        ("[0-4].png", "{}.png", 5),
    ],
)
def test_patterns(tmp_path, pattern, names, taken):
    write_pictures(tmp_path / "p", name=names)
    if taken:
        assert len(read(tmp_path / "p" / pattern)[0]) == taken
    else:
        assert "no images there" in one_line_error(InputError, tmp_path / "p" / pattern)


def test_a_folder_before_a_pattern_is_meant_as_it_is_spelled(tmp_path):
    folder = write_pictures(tmp_path / "drive [2] *", n=3)
    write_pictures(tmp_path / "drive 2 x", n=5)
    assert len(read(folder / "*.png")[0]) == 3
    assert len(read(tmp_path / "drive ? [x]" / "*.png")[0]) == 5


def test_a_printf_number_may_outgrow_its_width(tmp_path):
    folder = write_pictures(tmp_path / "p", n=12, name="{:01d}.png")
    frames, source = read(folder / "%01d.png")
    assert len(frames) == 12
    assert source.files[-1].name == "11.png"


def test_missing_numbers_are_said_because_fps_does_not_see_them(tmp_path):
    folder = write_pictures(tmp_path / "p")
    (folder / "4.png").unlink()
    (folder / "5.png").unlink()
    frames, source = read(folder)
    assert [frame.index for frame in frames] == list(range(N - 2))
    assert "2 numbers are missing" in source.report.warnings[0]


@pytest.mark.parametrize(("skipped_s", "is_said"), [(0.1, True), (0.3, False)], ids=["even times", "times that jump"])
def test_missing_numbers_are_said_where_the_times_do_not_know_of_them(tmp_path, skipped_s, is_said):
    folder = write_pictures(tmp_path / "p")
    (folder / "4.png").unlink()
    (folder / "5.png").unlink()
    steps_s = np.full(N - 3, 0.1)
    steps_s[3] = skipped_s
    times = write_times(tmp_path, [f"{t_s:.3f}" for t_s in np.cumsum([0.0, *steps_s])])
    said = [w for w in read(folder, fps=None, timestamps=times)[1].report.warnings if "2 numbers are missing" in w]
    assert bool(said) == is_said
    assert all("mend the file" in warning for warning in said)


def test_names_that_are_times_are_no_missing_numbers(tmp_path):
    write_pictures(tmp_path / "p", n=4)
    for i in range(4):
        (tmp_path / "p" / f"{i}.png").rename(tmp_path / "p" / f"{1403636579763555584 + 50_000_128 * i}.png")
    assert read(tmp_path / "p")[1].report.warnings == ()


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif", ".pgm", ".webp", ".jpg"])
def test_formats(tmp_path, suffix):
    frames, _ = read(write_pictures(tmp_path / "p", n=2, name="{}" + suffix))
    mean_error = np.abs(frames[1].grey.astype(float) - luma(1)).mean()
    assert mean_error < (6 if suffix in (".webp", ".jpg") else 1e-9)


def test_alpha_is_left_out(tmp_path):
    bgr = np.dstack([luma(0), luma(1), luma(2)])
    alpha = np.zeros((HEIGHT, WIDTH, 1), np.uint8)
    frames, _ = read(write_pictures(tmp_path / "p", n=1, make=lambda i: np.dstack([bgr, alpha])))
    np.testing.assert_array_equal(frames[0].colour(), bgr)
    np.testing.assert_array_equal(frames[0].grey, cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY))


@pytest.mark.parametrize(
    ("orientation", "turn"),
    [(1, lambda p: p), (3, lambda p: np.rot90(p, 2)), (6, lambda p: np.rot90(p, 3)), (8, lambda p: np.rot90(p, 1))],
)
def test_exif_orientation_is_applied(tmp_path, orientation, turn):
    picture = np.zeros((48, 64), np.uint8)
    picture[:16, :24] = 255
    save_as_exif(tmp_path / "a.jpg", picture, orientation)
    frames, source = read(tmp_path / "a.jpg")
    expected = turn(picture)
    assert source.info.image_size == ImageSize(expected.shape[1], expected.shape[0])
    np.testing.assert_allclose(frames[0].grey, expected, atol=3)


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_deep_pictures_fill_the_8_bits_whatever_their_depth(tmp_path, bits):
    def ramp(index):
        return (np.linspace(0, 2**bits - 1, WIDTH * HEIGHT).reshape(HEIGHT, WIDTH)).astype(np.uint16)

    frames, _ = read(write_pictures(tmp_path / "p", n=1, make=ramp))
    np.testing.assert_allclose(frames[0].grey, ramp(0) * (255 / (2**bits - 1)), atol=1)


def test_one_scale_serves_the_whole_clip(tmp_path):
    def brightening(index):
        return np.full((HEIGHT, WIDTH), 1000 * (index + 1), np.uint16)

    folder = write_pictures(tmp_path / "p", n=9, make=brightening)
    levels = [int(frame.grey[0, 0]) for frame in read(folder)[0]]
    np.testing.assert_allclose(levels, np.arange(9) * 255 / 8, atol=0.51)
    assert [int(frame.grey[0, 0]) for frame in read(folder, "3", "5")[0]] == levels[3:5]


def test_a_hot_pixel_does_not_darken_deep_pictures(tmp_path):
    def hot(index):
        picture = luma(index).astype(np.uint16) * 16
        picture[0, 0] = 65535
        return picture

    assert read(write_pictures(tmp_path / "p", n=3, make=hot))[0][0].grey.mean() > 80


def test_a_flat_deep_picture_is_readable(tmp_path):
    frames, _ = read(write_pictures(tmp_path / "p", n=2, make=lambda i: np.full((8, 8), 700, np.uint16)))
    assert not frames[0].grey.any()


def test_deep_colour_stays_colour(tmp_path):
    def deep(index):
        return np.dstack([luma(1), luma(2), luma(3)]).astype(np.uint16) * 16

    frames, _ = read(write_pictures(tmp_path / "p", n=1, make=deep))
    assert frames[0].colour().shape == (HEIGHT, WIDTH, 3)


def test_float_pictures_are_refused(tmp_path):
    folder = write_pictures(tmp_path / "p", n=1, name="{}.tif", make=lambda i: luma(i).astype(np.float32))
    assert "expected 8 or 16 bit" in one_line_error(InputError, folder)


def test_mixed_sizes_name_the_file_and_both_sizes(tmp_path):
    folder = write_pictures(tmp_path / "p", n=3)
    cv2.imwrite(str(folder / "1.png"), luma(1, 64, 32))
    message = one_line_error(InputError, folder)
    assert f"{folder}/1.png: is 64x32" in message
    assert "70x48" in message


def test_mixed_depths_are_refused(tmp_path):
    folder = write_pictures(tmp_path / "p", n=3)
    cv2.imwrite(str(folder / "2.png"), luma(2).astype(np.uint16))
    assert "2.png: is uint16" in one_line_error(InputError, folder)


@pytest.mark.parametrize("content", [b"", b"no picture"])
def test_an_unreadable_picture_leaves_a_gap(tmp_path, content):
    folder = write_pictures(tmp_path / "p")
    (folder / "0.png").write_bytes(content)
    (folder / "5.png").write_bytes(content)
    frames, source = read(folder)
    good = [i for i in range(N) if i not in (0, 5)]
    assert [frame.index for frame in frames] == good
    assert [frame.t_s for frame in frames] == [i / FPS for i in good]
    assert (source.report.n_packets_skipped, source.report.is_truncated) == (2, False)


def test_unreadable_last_pictures_are_a_truncation(tmp_path):
    folder = write_pictures(tmp_path / "p")
    data = (folder / "10.png").read_bytes()
    (folder / "10.png").write_bytes(data[: len(data) // 2])
    (folder / "11.png").write_bytes(b"")
    frames, source = read(folder)
    assert len(frames) == N - 2
    assert (source.report.n_packets_skipped, source.report.is_truncated) == (0, True)
    assert "the last 2 images cannot be read, from 10.png on" in source.report.warnings[0]
    report = read(folder, None, "11")[1].report
    assert (report.n_packets_skipped, report.is_truncated) == (1, False)


def test_unreadable_and_absent_pictures_are_errors(tmp_path):
    folder = write_pictures(tmp_path / "p", n=2)
    for path in folder.iterdir():
        path.write_text("no picture")
    assert "none of its 2 images can be read" in one_line_error(InputError, folder)
    (tmp_path / "empty").mkdir()
    assert "no images there" in one_line_error(InputError, tmp_path / "empty")
    assert "no images there" in one_line_error(InputError, tmp_path / "none" / "%d.png")


def test_a_selection_without_a_readable_picture_is_an_error(tmp_path):
    folder = write_pictures(tmp_path / "p", n=4)
    (folder / "2.png").write_text("no picture")
    with pytest.raises(InputError, match="none of the 1 selected images can be read"):
        read(folder, "2", "3")


def test_images_without_times_are_an_error_that_names_the_remedy(tmp_path):
    message = one_line_error(UsageError, write_pictures(tmp_path / "p", n=2), fps=None)
    assert "give --fps or --timestamps" in message


def test_one_image_is_a_clip_of_one_frame(tmp_path):
    frames, source = read(write_pictures(tmp_path / "p", n=1) / "0.png")
    assert [(frame.index, frame.t_s) for frame in frames] == [(0, 0.0)]
    assert source.info.nominal_dt_s == 1 / FPS


def write_times(folder, lines):
    path = folder / "times.txt"
    path.write_text("".join(f"{line}\n" for line in lines))
    return path


def test_kitti_times_count_from_the_first_line_to_the_nanosecond(tmp_path):
    folder = write_pictures(tmp_path / "p", n=3)
    frames, _ = read(folder, fps=None, timestamps=write_times(tmp_path, KITTI_TIMES))
    assert [frame.t_s for frame in frames] == [0.0, 0.103629319, 0.207110555]


def test_times_in_seconds_are_taken_as_they_are_even_backward(tmp_path):
    folder = write_pictures(tmp_path / "p", n=4)
    frames, source = read(folder, fps=None, timestamps=write_times(tmp_path, ["1.5e1", "16", "16", "14.25"]))
    assert [frame.t_s for frame in frames] == [15.0, 16.0, 16.0, 14.25]
    assert source.info.nominal_dt_s == 1.0


def test_times_of_an_editor_that_marks_its_texts_are_read(tmp_path):
    times = tmp_path / "times.txt"
    times.write_text("0.0\n0.1\n0.2\n", encoding="utf-8-sig")
    frames, _ = read(write_pictures(tmp_path / "p", n=3), fps=None, timestamps=times)
    assert [frame.t_s for frame in frames] == [0.0, 0.1, 0.2]


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        (["0", "1"], "has 2 times for 3 images in"),
        (["0", "1", "2", "3"], "has 4 times for 3 images in"),
        ([], "has 0 times for 3 images in"),
        (["0", "nan", "2"], "line 2: 'nan' is no time"),
        (["0", "1", "inf"], "line 3: 'inf' is no time"),
        (["0", "", "2"], "line 2: '' is no time"),
        (["0", "a b", "2"], "line 2: 'a b' is no time"),
        ([KITTI_TIMES[0], "17", KITTI_TIMES[2]], "line 2: '17' is no time"),
        ([KITTI_TIMES[0], "2011-13-26 13:02:25.9", KITTI_TIMES[2]], "line 2: '2011-13-26 13:02:25.9' is no time"),
        (["0", "1", KITTI_TIMES[0]], "line 3"),
    ],
)
def test_a_bad_file_of_times_names_its_line(tmp_path, lines, complaint):
    folder = write_pictures(tmp_path / "p", n=3)
    times = write_times(tmp_path, lines or ["\n"])
    message = one_line_error(InputError, folder, fps=None, timestamps=times)
    assert message.startswith(f"{times}: {complaint}")


def test_a_missing_or_binary_file_of_times_is_an_error(tmp_path):
    folder = write_pictures(tmp_path / "p", n=3)
    assert "no such file" in one_line_error(InputError, folder, fps=None, timestamps=tmp_path / "none.txt")
    assert "is no text" in one_line_error(InputError, folder, fps=None, timestamps=folder / "0.png")


def test_what_cannot_be_read_is_named_and_nothing_else_is_said(tmp_path, capfd):
    folder = write_pictures(tmp_path / "p")
    for name in ("4.png", "6.png"):
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: len(data) // 2])
    (folder / "5.png").write_bytes(b"garbage")
    _, source = read(folder)
    assert source.report.warnings == (f"{folder}: 3 images cannot be read and are left out, 4.png is the first",)
    assert capfd.readouterr().err == ""
