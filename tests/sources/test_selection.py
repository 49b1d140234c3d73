import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ttcvid.errors import UsageError
from ttcvid.sources.base import LONE_FRAME_DT_S, Position, Selection, median_dt_s


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [
        ("0", 0, "frames"),
        ("120", 120, "frames"),
        ("4.5s", 4.5, "seconds"),
        ("4s", 4, "seconds"),
        (".5s", 0.5, "seconds"),
        ("00:01:02.5", 62.5, "seconds"),
        ("01:02", 62, "seconds"),
        ("10:00:00", 36000, "seconds"),
        (" 7 ", 7, "frames"),
    ],
)
def test_a_position_is_frames_or_seconds(text, value, unit):
    assert Position.parse("--start", text) == Position(value, unit)


@pytest.mark.parametrize(
    "text", ["", "4.5", "-3", "4.5 s", "1m", "1:2:3:4", "00:61", "00:70:00", "nan", "infs", "s", "1e3"]
)
def test_anything_else_is_an_error_that_names_option_value_and_remedy(text):
    with pytest.raises(UsageError) as caught:
        Selection(end=text)
    message = str(caught.value)
    assert message.startswith(f"--end: {text!r}")
    assert "expected frames as 120, or seconds as 4.5s or 00:01:02.5" in message
    assert "\n" not in message


@pytest.mark.parametrize("stride", [0, -1, 1.5, "2", True])
def test_a_stride_is_a_whole_number_from_1_up(stride):
    with pytest.raises(UsageError, match="--stride"):
        Selection(stride=stride)


@pytest.mark.parametrize(("start", "end"), [("5", "5"), ("9", "3"), ("2s", "00:00:01.5")])
def test_an_end_that_is_not_behind_the_start_is_an_error(start, end):
    with pytest.raises(UsageError, match=f"--end: {end} is not behind --start {start}"):
        Selection(start, end)


@given(start=st.integers(0, 30), length=st.integers(1, 30), stride=st.integers(1, 7))
def test_frames_are_selected_as_range_does(start, length, stride):
    frame = np.arange(70)
    wanted = Selection(str(start), str(start + length), stride).wanted(frame, frame / 10.0)
    assert frame[wanted].tolist() == list(range(start, start + length, stride))


def test_stride_counts_frame_numbers_not_rows():
    frame = np.array([0, 1, 2, 5, 6, 8, 9])
    assert frame[Selection(stride=3).wanted(frame, frame / 10.0)].tolist() == [0, 6, 9]


def test_the_median_spacing_ignores_duplicated_and_backward_times():
    assert median_dt_s(np.array([0.0, 1.0, 1.0, 2.0, 0.5, 1.5, 9.0])) == 1.0


@pytest.mark.parametrize("times_s", [[], [3.0], [2.0, 2.0], [2.0, 1.0]])
def test_without_any_spacing_the_nominal_one_is_finite_and_positive(times_s):
    assert median_dt_s(np.array(times_s)) == LONE_FRAME_DT_S > 0
