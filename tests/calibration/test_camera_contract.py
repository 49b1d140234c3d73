"""What holds for every camera format: the same camera gives the same numbers and the same rays."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from camera_texts import FORMATS, SIZELESS_FORMATS, own
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ttcvid.calibration import read_camera, read_camera_image_size, write_camera
from ttcvid.errors import CalibrationError
from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.model import Camera, ImageSize

SIZE = ImageSize(1241, 376)
LENSES = {
    "none": (),
    "plumb_bob": (-0.31, 0.11, 0.0008, -4e-05, 0.0),
    "rational": (0.52, -2.62, 7e-04, -0.0001, 1.49, 0.40, -2.45, 1.42),
    "fisheye": (0.06, -0.012, 0.009, -0.004),
}
CASES = [(fmt, model) for fmt, models in FORMATS.items() for model in sorted(models)]
every_case = pytest.mark.parametrize(("write", "model"), CASES, ids=[f"{fmt.__name__}-{model}" for fmt, model in CASES])
every_format = pytest.mark.parametrize("write", FORMATS, ids=lambda fmt: fmt.__name__)


def camera_with(model):
    return Camera(718.5, 717.5, 607.1928, 185.2157, SIZE, model, LENSES[model], "truth")


def camera_or_refusal(path):
    """The camera of a file, or None where it is refused, as it must be, by one line that names the file."""
    try:
        return read_camera(path, SIZE)
    except CalibrationError as error:
        message = str(error)
    assert message.startswith(str(path))
    assert "\n" not in message
    return None


def saved(folder, text):
    path = Path(folder) / "camera.calibration"
    path.write_text(text, encoding="utf-8")
    return path


@every_case
def test_the_file_gives_the_camera(write, model, tmp_path):
    path = saved(tmp_path, write(camera_with(model)))
    camera = read_camera(path, SIZE)
    assert camera == replace(camera_with(model), origin=str(path))
    assert not camera.is_assumed


@every_case
def test_the_file_gives_the_rays(write, model, tmp_path):
    xy = np.random.default_rng(5).uniform(0, 1, (50, 2)) * (1240, 375)
    camera = read_camera(saved(tmp_path, write(camera_with(model))), SIZE)
    np.testing.assert_array_equal(rays_from_pixels(camera, xy), rays_from_pixels(camera_with(model), xy))


@every_case
def test_the_name_of_the_file_does_not_matter_nor_do_windows_line_ends(write, model, tmp_path):
    text = write(camera_with(model))
    for name in ("a.txt", "b.yaml", "c.xml", "d", "ü e.json"):
        path = tmp_path / name
        path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
        assert read_camera(path, SIZE) == replace(camera_with(model), origin=str(path))


@every_case
def test_the_file_says_its_picture_size_where_the_format_does(write, model, tmp_path):
    size = read_camera_image_size(saved(tmp_path, write(camera_with(model))))
    assert size == (None if write in SIZELESS_FORMATS else SIZE)


@every_case
def test_another_picture_size_is_refused_and_both_are_named(write, model, tmp_path):
    path = saved(tmp_path, write(camera_with(model)))
    if write in SIZELESS_FORMATS:
        assert read_camera(path, ImageSize(1300, 400)).image_size == ImageSize(1300, 400)
        return
    with pytest.raises(CalibrationError, match=r"the file is for 1241x376; expected 640x480.*camera file of this clip"):
        read_camera(path, ImageSize(640, 480))


@every_format
def test_cut_anywhere_the_file_gives_one_line_or_still_the_focal_length(write, tmp_path):
    model = sorted(FORMATS[write])[-1]
    text = write(camera_with(model))
    for cut in np.linspace(0, len(text) - 1, 40).astype(int):
        camera = camera_or_refusal(saved(tmp_path, text[:cut]))
        assert camera is None or camera.fx_px == 718.5


@every_format
@pytest.mark.parametrize("bad", ["nan", "inf", "-718.5", "0.0"])
def test_a_focal_length_that_cannot_be_is_refused_in_one_line(write, bad, tmp_path):
    model = sorted(FORMATS[write])[0]
    text = write(camera_with(model))
    spelled = {"nan": ".Nan", "inf": ".Inf"}.get(bad, bad) if "kitti" not in write.__name__ else bad
    at = text.index("718.5")
    end = at + next(i for i, c in enumerate(text[at:]) if c in ", \n<]")
    with pytest.raises(CalibrationError) as caught:
        read_camera(saved(tmp_path, text[:at] + spelled + text[end:]), SIZE)
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)


@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from(CASES),
    st.floats(300, 5000),
    st.floats(0.8, 1.25),
    st.floats(100, 1100),
    st.floats(20, 350),
    st.lists(st.floats(-0.05, 0.05), min_size=8, max_size=8),
)
def test_any_camera_comes_back_with_the_same_numbers(case, fx, ratio, cx, cy, coefficients):
    write, model = case
    coefficients = tuple(coefficients[: len(LENSES[model])])
    coefficients = (*coefficients[:4], 0.0) if model == "plumb_bob" else coefficients
    camera = Camera(fx, fx * ratio, cx, cy, SIZE, model, coefficients)
    with tempfile.TemporaryDirectory() as folder:
        read = camera_or_refusal(saved(folder, write(camera)))
    # A lens that folds over within the picture is none.
    assume(read is not None)
    np.testing.assert_allclose(
        [read.fx_px, read.fy_px, read.cx_px, read.cy_px, *read.distortion],
        [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion],
        rtol=1e-15,
    )
    assert read.distortion_model == model


@settings(deadline=None)
@given(
    st.sampled_from(sorted(LENSES)), st.floats(300, 5000), st.floats(0.8, 1.25), st.floats(0, 1240), st.floats(0, 375)
)
def test_what_write_camera_writes_is_read_back_exactly(model, fx, ratio, cx, cy):
    camera = Camera(fx, fx * ratio, cx, cy, SIZE, model, LENSES[model])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "camera.yaml"
        write_camera(path, camera)
        assert read_camera(path, SIZE) == replace(camera, origin=str(path))


@settings(deadline=None, max_examples=30)
@given(st.sampled_from(CASES), st.data())
def test_damaged_files_give_one_line_and_never_crash(case, data):
    write, model = case
    text = write(camera_with(model))
    at = data.draw(st.integers(0, len(text) - 1))
    n_lost = data.draw(st.integers(0, 30))
    junk = data.draw(st.text(st.characters(codec="utf-8"), max_size=4) | st.sampled_from(list("[]{}<>:\"'!%-&*#\n\t0")))
    assume(n_lost or junk)
    with tempfile.TemporaryDirectory() as folder:
        camera_or_refusal(saved(folder, text[:at] + junk + text[at + n_lost :]))


def test_own_format_needs_no_distortion(tmp_path):
    lines = own(camera_with("none")).splitlines()[:5]
    assert read_camera(saved(tmp_path, "\n".join(lines)), SIZE).distortion_model == "none"
