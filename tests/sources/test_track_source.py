"""Tables of point tracks: what is taken, and what is refused."""

import numpy as np
import pandas as pd
import pytest
from source_clips import track_table, write_tracks

from ttcvid.errors import InputError, UsageError
from ttcvid.model import ImageSize
from ttcvid.sources import Selection, open_source

SIZE = ImageSize(70, 48)


@pytest.fixture(params=["csv", "parquet"])
def path(request, tmp_path):
    return tmp_path / f"tracks.{request.param}"


def read(path, table=None, **options):
    options = {"image_size": SIZE} | options
    with open_source(str(path if table is None else write_tracks(path, table)), **options) as source:
        return list(source), source


def one_line_error(kind, path, table=None, **options) -> str:
    with pytest.raises(kind) as caught:
        read(path, table, **options)
    message = str(caught.value)
    assert message.startswith(str(path)) or str(path) in message
    assert "\n" not in message
    return message


def test_rows_in_any_order_give_the_same_frames(path):
    shuffled = track_table().sample(frac=1, random_state=3)
    for one, other in zip(read(path, track_table())[0], read(path, shuffled)[0], strict=True):
        assert (one.index, one.t_s) == (other.index, other.t_s)
        np.testing.assert_array_equal(one.points.track_id, other.points.track_id)
        np.testing.assert_array_equal(one.points.xy_px, other.points.xy_px)
        assert (np.diff(one.points.track_id) > 0).all()


def test_other_columns_do_not_matter(path):
    table = track_table().assign(label="car", score=np.nan)
    assert len(read(path, table)[0]) == 12


def test_frame_numbers_may_have_gaps_and_tracks_may_end(path):
    table = track_table()
    table = table[~table.frame.isin([3, 4]) & ~((table.frame > 7) & (table.track_id == 3))]
    frames, source = read(path, table)
    assert [frame.index for frame in frames] == [0, 1, 2, 5, 6, 7, 8, 9, 10, 11]
    assert [len(frame.points.track_id) for frame in frames] == [3] * 6 + [2] * 4
    assert source.info.nominal_dt_s == pytest.approx(0.1)


def test_points_outside_the_picture_are_kept(path):
    table = track_table()
    table.loc[table.track_id == 3, ["x_px", "y_px"]] = [-700.0, 500.0]
    frames, _ = read(path, table)
    assert (frames[0].points.xy_px[0] == [-700.0, 500.0]).all()


def test_points_that_mostly_lie_outside_mean_a_wrong_picture_size(path):
    message = one_line_error(InputError, path, track_table(), image_size=ImageSize(5, 5))
    assert "points lie in pictures of 5x5: give the --image-size" in message


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("frame", 2.0**31, "row 2: frame is 2.14748e+09: expected whole numbers from 0 to 2^31 - 1"),
        ("x_px", 1e12, "row 2: the point is at (1e+12, 6): expected pixels of the picture"),
        ("y_px", -1e200, "row 2: the point is at (10, -1e+200)"),
    ],
)
def test_numbers_too_large_are_named_with_their_row(path, column, value, says):
    table = track_table().astype(float)
    table.loc[1, column] = value
    assert says in one_line_error(InputError, path, table)


@pytest.mark.parametrize("shift", [0.0, 0.5], ids=["parts of the picture", "plane"])
def test_normalised_coordinates_are_no_pixels(path, shift):
    table = track_table()
    table[["x_px", "y_px"]] = table[["x_px", "y_px"]] / [SIZE.width_px, SIZE.height_px] - shift
    message = one_line_error(InputError, path, table)
    assert "x_px runs from" in message
    assert "70x48" in message
    assert "normalised" in message


@pytest.mark.parametrize("factor", [1e-200, 1e-6, 1e9])
def test_times_that_are_not_in_seconds_are_refused(path, factor):
    table = track_table()
    message = one_line_error(InputError, path, table.assign(t_s=table.t_s * factor))
    assert f"t_s goes on by {0.1 * factor:g} s a frame: expected 1e-05 to 1000 s" in message


def test_a_column_given_twice_is_refused(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text("frame,t_s,track_id,x_px,y_px,y_px\n0,0,1,2,3,4\n")
    assert "column y_px is there 2 times" in one_line_error(InputError, path)


@pytest.mark.parametrize(("mark", "word"), [(";", "semicolons"), ("\t", "tabs")])
def test_other_separators_are_recognised(tmp_path, mark, word):
    path = tmp_path / "tracks.csv"
    track_table().to_csv(path, index=False, sep=mark)
    assert f"its columns are separated by {word}, write it with commas" in one_line_error(InputError, path)


@pytest.mark.parametrize(
    ("content", "remedy"),
    [
        (
            "frame;t_s;track_id;x_px;y_px\n0;0,0;1;2,5;3,5\n",
            "separated by semicolons, write it with commas, and numbers",
        ),
        ("frame,t_s,track_id,x_px,y_px\n0,0,1,2,3\n".encode("utf-16"), "it is UTF-16, save it as UTF-8"),
        ("# of my tracker\nframe,t_s,track_id,x_px,y_px\n0,0,1,2,3\n", "its first line has to name the columns"),
        ("frame,t_s,track_id,x_px,y_px\n0,0,1,2,3\n0,0,2\n", "expected a table, write it again"),
    ],
)
def test_what_is_no_table_with_commas_is_told_apart(tmp_path, content, remedy):
    path = tmp_path / "tracks.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert remedy in one_line_error(InputError, path)


def test_tracks_with_names_are_to_be_numbered(path):
    table = track_table().astype({"track_id": str})
    message = one_line_error(InputError, path, table.assign(track_id="car" + table.track_id))
    assert "row 1: track_id is 'car7': expected a finite number (36 such rows), number the tracks" in message


def test_whole_numbers_written_as_floats_are_whole(path):
    frames, _ = read(path, track_table().astype({"frame": float, "track_id": float}))
    assert frames[0].points.track_id.dtype == np.int64


def test_times_that_run_backward_are_passed_on(path):
    table = track_table()
    table.loc[table.frame == 5, "t_s"] = 0.1
    assert read(path, table)[0][5].t_s == 0.1


def test_a_single_frame_is_read(path):
    frames, source = read(path, track_table(n=1))
    assert [frame.index for frame in frames] == [0]
    assert source.info.nominal_dt_s > 0


def test_an_image_size_is_needed(path):
    assert "give --image-size WxH or a --camera file" in one_line_error(
        UsageError, path, track_table(), image_size=None
    )


@pytest.mark.parametrize("option", ["fps", "timestamps"])
def test_a_table_has_its_own_times(path, tmp_path, option):
    value = 10.0 if option == "fps" else tmp_path / "t.txt"
    message = one_line_error(UsageError, path, track_table(), **{option: value})
    assert message.startswith(f"--{option}: ")
    assert "column t_s: leave the option out" in message


@pytest.mark.parametrize("gone", [["x_px"], ["t_s", "track_id"]])
def test_missing_columns_are_named_with_those_present(path, gone):
    table = track_table().drop(columns=gone)
    message = one_line_error(InputError, path, table)
    assert f"lacks column {', '.join(gone)}" in message
    assert f"found {', '.join(table.columns)}" in message


@pytest.mark.parametrize("column", ["frame", "t_s", "track_id", "x_px", "y_px"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none_are_named_with_their_row(path, column, value):
    table = track_table().astype(float)
    table.loc[[4, 8], column] = value
    message = one_line_error(InputError, path, table)
    assert f"row 5: {column} is " in message
    assert "(2 such rows)" in message


def test_words_among_the_numbers_are_named_with_their_row(path):
    table = track_table().astype({"x_px": str})
    table.loc[2, "x_px"] = "left"
    assert "row 3: x_px is 'left': expected a finite number" in one_line_error(InputError, path, table)


def test_nulls_are_refused(path):
    table = track_table().astype({"track_id": "Int64"})
    table.loc[1, "track_id"] = pd.NA
    assert "row 2: track_id is nothing" in one_line_error(InputError, path, table)


@pytest.mark.parametrize("column", ["frame", "track_id"])
@pytest.mark.parametrize("value", [-1, 1.5, 1e300])
def test_numbers_of_frames_and_tracks_are_whole_and_not_negative(path, column, value):
    table = track_table().astype({column: float})
    table.loc[6, column] = value
    message = one_line_error(InputError, path, table)
    assert f"row 7: {column} is {value:g}: expected whole numbers from 0" in message


def test_a_track_twice_in_a_frame_is_refused(path):
    table = track_table()
    message = one_line_error(InputError, path, pd.concat([table, table.iloc[[10]]]))
    assert "frame 3 has track_id 5 more than once" in message


def test_two_times_in_one_frame_are_refused(path):
    table = track_table()
    table.loc[4, "t_s"] = 0.11
    message = one_line_error(InputError, path, table)
    assert "frame 1 has t_s " in message
    assert "0.11" in message


def test_a_table_without_rows_is_refused(path):
    assert "has no rows" in one_line_error(InputError, path, track_table(n=0))


def test_unreadable_tables_are_refused(path):
    assert "no such file" in one_line_error(InputError, path)
    path.touch()
    assert "is empty" in one_line_error(InputError, path)
    path.write_bytes(b"\x00\xff\xfe no table\n1,2,3\n" * 3)
    one_line_error(InputError, path)


def test_selecting_between_the_frames_of_a_table_is_an_error(path):
    table = track_table()
    with pytest.raises(UsageError, match="selects no frame"):
        read(path, table[table.frame != 4], selection=Selection("4", "5"))
