"""Which clips a batch has, what they are called, and what is said of inputs that cannot be used."""

import os
import re
from pathlib import Path

import pytest

from ttcvid.errors import InputError, UsageError
from ttcvid.jobs.batch.inputs import read_inputs
from ttcvid.jobs.settings.configuration import configure_each, configure_from_arguments
from ttcvid.jobs.settings.layers import layer_from_command_line

FILES = ("a/front.mp4", "a/rear.mkv", "b/front.mp4", "b/notes.txt", "b/.hidden.mp4", "pictures/000.png", "top.avi")


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    folder = tmp_path / "clips"
    for name in FILES:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return folder


def names(*inputs: Path | str, out: Path = Path("results")) -> list[str]:
    return [clip.name for clip in read_inputs([str(given) for given in inputs], out)]


def text(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_a_folder_gives_its_videos_and_folders_of_pictures_named_by_their_place_in_it(clips: Path) -> None:
    assert names(clips) == ["a__front", "a__rear", "b__front", "pictures", "top"]
    assert names(clips / "pictures") == ["pictures"]
    assert [clip.input for clip in read_inputs([str(clips / "a")], Path("x"))] == [
        str(clips / "a/front.mp4"),
        str(clips / "a/rear.mkv"),
    ]


def test_results_are_no_clips(clips: Path) -> None:
    for name in ("out/front/overlay.mp4", "out/front/manifest.json", "b/out/overlay.mp4"):
        path = clips / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    (clips / "b/out/manifest.json").touch()
    assert names(clips, out=clips / "out") == ["a__front", "a__rear", "b__front", "pictures", "top"]


def test_a_pattern_gives_what_fits_named_by_its_place_below_the_plain_part(clips: Path) -> None:
    assert names(f"{clips}/*/front.mp4") == ["a__front", "b__front"]
    assert names(f"{clips}/**/*.mp4") == ["a__front", "b__front"]
    assert names(f"{clips}/*") == ["a__front", "a__rear", "b__front", "pictures", "top"]


def test_a_list_names_clips_folders_and_patterns_relative_to_itself(clips: Path) -> None:
    path = text(clips / "some.txt", "# a comment", "top.avi", "", "a", "*/front.mp4", "gone.mp4", "pictures")
    assert names(path) == ["b__front", "front", "gone", "pictures", "rear", "top"]


def test_a_clip_that_is_named_twice_counts_once(clips: Path) -> None:
    assert names(clips / "top.avi", clips, f"{clips}/*.avi") == ["a__front", "a__rear", "b__front", "pictures", "top"]
    table = text(clips / "batch.csv", "clip,fps", "a/front.mp4,10")
    read = read_inputs([str(clips), str(table)], Path("x"))
    assert [clip.name for clip in read] == ["a__rear", "b__front", "front", "pictures", "top"]
    assert [clip.name for clip in read if clip.layer.entries] == ["front"]


def test_two_clips_of_one_name_are_an_error_that_names_both(clips: Path) -> None:
    with pytest.raises(UsageError, match=r"two clips are called 'front'.*a/front.mp4.*b/front.mp4.*column 'name'"):
        names(clips / "a/front.mp4", clips / "b/front.mp4")
    (clips / "Top.mp4").touch()
    with pytest.raises(UsageError, match="two clips are called 'top'"):
        names(clips)


def test_a_table_gives_clips_their_own_options_over_those_of_all(clips: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(clips)
    path = text(
        clips / "batch.csv",
        "clip, name, platform, camera, horizon, tracking.max_tracks",
        "a/front.mp4, first, vehicle, a/camera.yaml,,",
        "",
        "b/front.mp4, second,,, auto, 500",
    )
    read = read_inputs([str(path)], Path("x"))
    assert [clip.name for clip in read] == ["first", "second"]
    for_all = layer_from_command_line({"platform": "static", "hfov": "60"}, ())
    first, second = configure_each(for_all, [clip.layer for clip in read])
    assert first.pipeline.egomotion.platform.value == "vehicle"
    assert first.options.camera == clips / "a/camera.yaml"
    assert first.options.hfov is None, "a camera file takes the place of the angle that all others have"
    assert second.pipeline.egomotion.platform.value == "static"
    assert second.options.wants_auto_horizon
    assert second.options.hfov == 60
    assert second.pipeline.tracking.max_tracks == 500
    assert first.pipeline.tracking == configure_from_arguments({}).pipeline.tracking


def test_a_table_may_have_semicolons_and_a_table_of_tracks_is_a_clip(tmp_path: Path) -> None:
    table = text(tmp_path / "list.csv", "clip;fps", "clip.mp4;10")
    tracks = text(tmp_path / "tracks.csv", "frame,t_s,track_id,x_px,y_px", "0,0,0,1,1")
    assert names(table, tracks) == ["clip", "tracks"]


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        (["clip,platfrom", "a.mp4,vehicle"], "unknown column 'platfrom': did you mean 'platform'"),
        (["clip,tracking.max_track", "a.mp4,5"], "did you mean 'tracking.max_tracks'"),
        (["clip,qqq", "a.mp4,1"], "unknown column 'qqq': expected an option of analyze, or SECTION.KEY"),
        (["clip,overwrite", "a.mp4,true"], "unknown column 'overwrite'"),
        (["clip,fps,fps", "a.mp4,1,2"], "column 'fps' stands there twice"),
        (["clip,fps", "a.mp4,1,2"], "line 2: 3 cells for 2 columns"),
        (["clip,fps", ",1"], "line 2: column 'clip' is empty"),
        (["clip,name", "a.mp4,../b"], r"would be called '\.\./b'"),
        (["clip,name", "a.mp4,.hidden"], r"would be called '\.hidden'"),
        (["clip,fps", "a.mp4,10", "a.mp4,20"], r"two clips are called 'a': .*line 2.*line 3"),
    ],
)
def test_a_mistake_in_a_table_is_named(lines: list[str], reason: str, tmp_path: Path) -> None:
    table = text(tmp_path / "batch.csv", *lines)
    with pytest.raises(UsageError) as caught:
        names(table)
    assert "batch.csv" in str(caught.value)
    assert re.search(reason, str(caught.value))


def test_a_value_of_a_table_that_cannot_be_used_is_named_with_line_and_column(tmp_path: Path) -> None:
    table = text(tmp_path / "batch.csv", "clip,fps", "a.mp4,10", "b.mp4,fast")
    with pytest.raises(UsageError, match=r"batch.csv: line 3: column 'fps' = 'fast': expected a valid number"):
        configure_each(layer_from_command_line({}, ()), [clip.layer for clip in read_inputs([str(table)], Path("x"))])


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ("gone.mp4", "no such file or folder"),
        ("*.mp5", "no file fits the pattern"),
        ("pictures/*.png", "a picture is no clip: give its folder"),
        ("empty", "holds no video and no folder of pictures"),
    ],
)
def test_an_input_that_is_not_there_is_an_error_before_anything_begins(given: str, reason: str, clips: Path) -> None:
    (clips / "empty").mkdir()
    with pytest.raises(InputError, match=reason):
        names(clips / given)


def test_names_that_are_no_utf8_become_names_that_tables_can_hold(tmp_path: Path) -> None:
    (tmp_path / os.fsdecode(b"caf\xe9.mp4")).touch()
    (clip,) = read_inputs([str(tmp_path)], Path("x"))
    assert clip.name == "caf_xe9"
    assert Path(clip.input).exists()


@pytest.mark.parametrize(("name", "content"), [("clips.txt", "# none yet\n\n"), ("batch.csv", "clip,fps\n\n")])
def test_a_list_or_table_without_clips_is_an_error(name: str, content: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=f"{name}: names no clip"):
        names(tmp_path / name)


def test_nothing_given_is_an_error() -> None:
    with pytest.raises(UsageError, match="no INPUT"):
        read_inputs([], Path("x"))
    with pytest.raises(UsageError, match="an INPUT is empty"):
        read_inputs([""], Path("x"))
