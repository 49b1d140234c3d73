"""Where settings come from, which place wins, and what is said of wrong ones."""

import os
from pathlib import Path

import numpy as np
import pytest

from ttcvid.config import TrackingConfig
from ttcvid.errors import UsageError
from ttcvid.jobs.settings.configuration import Configuration, configure_from_arguments, configure_from_command_line
from ttcvid.model import ImageSize, Platform

PLACES = ("command line", "environment", "config", "project")


@pytest.fixture(autouse=True)
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder, and no TTCVID variable from outside."""
    for name in list(os.environ):
        if name.startswith("TTCVID_"):
            monkeypatch.delenv(name)
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def configure_with(given: dict[str, str], monkeypatch: pytest.MonkeyPatch, folder: Path) -> Configuration:
    """Give ``tracking.max_tracks`` in each of the places of ``given``."""
    settings = [f"tracking.max_tracks={given['command line']}"] if "command line" in given else []
    if "environment" in given:
        monkeypatch.setenv("TTCVID_TRACKING__MAX_TRACKS", given["environment"])
    config = None
    if "config" in given:
        config = folder / "run.toml"
        config.write_text(f"[tracking]\nmax_tracks = {given['config']}\n")
    if "project" in given:
        (folder / "ttcvid.toml").write_text(f"[tracking]\nmax_tracks = {given['project']}\n")
    return configure_from_command_line({}, settings, config)


@pytest.mark.parametrize("strongest", range(len(PLACES)))
def test_a_stronger_place_wins_over_all_weaker_ones(
    strongest: int, monkeypatch: pytest.MonkeyPatch, empty_folder: Path
) -> None:
    given = {place: str(100 + n) for n, place in enumerate(PLACES) if n >= strongest}
    configuration = configure_with(given, monkeypatch, empty_folder)
    assert configuration.pipeline.tracking.max_tracks == 100 + strongest
    origin = configuration.as_manifest()["tracking"]["max_tracks"]["origin"]
    expected = ("command line", "environment variable TTCVID_TRACKING__MAX_TRACKS", "run.toml", "ttcvid.toml")
    assert expected[strongest] in origin


def test_without_any_setting_the_defaults_hold() -> None:
    configuration = configure_from_command_line({})
    default = TrackingConfig().max_tracks
    assert configuration.pipeline.tracking.max_tracks == default
    assert configuration.as_manifest()["tracking"]["max_tracks"] == {"value": default, "origin": "default"}
    assert configuration.origins == {}


def test_smooth_needs_the_whole_tracks() -> None:
    assert configure_from_command_line({"smooth": "true"}).pipeline.collision_times.smooth
    with pytest.raises(UsageError, match=r"\[collision_times\] smooth needs estimator = multi-frame, got two-frame"):
        configure_from_command_line({"smooth": "true", "estimator": "two-frame"})


@pytest.mark.parametrize("option", ["tracker", "platform", "estimator"])
def test_a_shortcut_option_is_kept_in_its_stage_alone(option: str) -> None:
    value = {"tracker": "akaze", "platform": "vehicle", "estimator": "three-frame"}[option]
    manifest = configure_from_command_line({option: value}).as_manifest()
    section = {"tracker": "tracking", "platform": "egomotion", "estimator": "collision_times"}[option]
    assert manifest[section][option] == {"value": value, "origin": "command line"}
    assert option not in manifest["analyze"]


def test_a_shortcut_works_in_environment_file_and_python_too(
    monkeypatch: pytest.MonkeyPatch, empty_folder: Path
) -> None:
    assert configure_from_arguments({"platform": "aircraft"}).pipeline.egomotion.platform is Platform.aircraft
    monkeypatch.setenv("TTCVID_PLATFORM", "vehicle")
    assert configure_from_command_line({}).pipeline.egomotion.platform is Platform.vehicle
    monkeypatch.delenv("TTCVID_PLATFORM")
    (empty_folder / "ttcvid.toml").write_text('[analyze]\nplatform = "static"\n')
    assert configure_from_command_line({}).pipeline.egomotion.platform is Platform.static


def test_one_parameter_given_two_ways_in_one_place_must_agree() -> None:
    configure_from_command_line({"platform": "vehicle"}, ["egomotion.platform=vehicle"])
    with pytest.raises(UsageError, match=r"--set egomotion.platform = 'free' contradicts --platform = 'vehicle'"):
        configure_from_command_line({"platform": "vehicle"}, ["egomotion.platform=free"])


def test_one_place_gives_only_one_kind_of_intrinsics() -> None:
    with pytest.raises(UsageError, match="--camera and --focal-px exclude each other"):
        configure_from_command_line({"camera": "c.yaml", "focal_px": "700"})


def test_intrinsics_of_a_stronger_place_replace_another_kind_of_a_weaker_one(empty_folder: Path) -> None:
    (empty_folder / "ttcvid.toml").write_text('[analyze]\ncamera = "c.yaml"\n')
    configuration = configure_from_command_line({"focal_px": "700"})
    assert configuration.options.camera is None
    assert configuration.options.focal_px == 700.0
    assert "analyze.camera" not in configuration.origins


def test_relative_paths_of_a_file_are_relative_to_that_file(tmp_path: Path, empty_folder: Path) -> None:
    (tmp_path / "run.toml").write_text('[analyze]\ncamera = "cameras/front.yaml"\nmask = "/abs/mask.png"\n')
    options = configure_from_command_line({"horizon": "h.json"}, config=Path("../run.toml")).options
    assert options.camera is not None
    assert options.camera.resolve() == (tmp_path / "cameras/front.yaml").resolve()
    assert options.mask == Path("/abs/mask.png")
    assert options.horizon == Path("h.json")


def test_text_of_the_command_line_becomes_typed_values() -> None:
    options = configure_from_command_line(
        {
            "fps": "9.6525",
            "stride": "2",
            "start": "120",
            "end": "00:01:02.5",
            "overlay": "false",
            "image_size": "640x480",
        }
    ).options
    assert (options.fps, options.stride, options.start, options.end) == (9.6525, 2, "120", "00:01:02.5")
    assert options.overlay is False
    assert options.image_size == ImageSize(640, 480)


def test_python_arguments_take_numbers_paths_and_stages() -> None:
    configuration = configure_from_arguments(
        {"start": 120, "camera": Path("c.yaml"), "tracking": {"max_tracks": 800}, "image_size": "640x480", "fps": None}
    )
    assert configuration.options.start == "120"
    assert configuration.options.camera == Path("c.yaml")
    assert configuration.pipeline.tracking.max_tracks == 800
    assert configuration.as_manifest()["analyze"]["image_size"]["value"] == "640x480"


def test_a_file_of_an_editor_that_marks_its_texts_is_read(empty_folder: Path) -> None:
    (empty_folder / "ttcvid.toml").write_text("[tracking]\nmax_tracks = 800\n", encoding="utf-8-sig")
    assert configure_from_command_line({}).pipeline.tracking.max_tracks == 800


def test_the_seed_is_recorded() -> None:
    """Nothing in an analysis is random: it is a part of the resolved configuration, and reaches no stage."""
    configuration = configure_from_command_line({"seed": "7"})
    assert configuration.options.seed == 7
    assert configuration.pipeline == configure_from_command_line({}).pipeline


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "[tracking]\nmax_track = 5\n",
            r"ttcvid.toml: \[tracking\] max_track: unknown key 'max_track': did you mean 'max_tracks'\?",
        ),
        ("[trakcing]\nmax_tracks = 500\n", r"ttcvid.toml: unknown section \[trakcing\]: did you mean 'tracking'\?"),
        ("[analyze]\nmax_tracks = 1\n", r"unknown key 'max_tracks': it belongs under \[tracking\]"),
        ("[analyze]\nqwxyz = 1\n", "unknown key 'qwxyz': expected one of camera, "),
        ('platform = "vehicle"\n', r"ttcvid.toml: 'platform' stands outside a section"),
        ("[tracking]\nmax_tracks = 5\n", r"\[tracking\] max_tracks = 5: expected greater than or equal to 20"),
        ('[tracking]\nmax_tracks = "500"\n', r"max_tracks = '500': expected a valid integer"),
        ("[tracking]\nmax_tracks = true\n", r"max_tracks = True: expected a valid integer"),
        ("[analyze]\nfps = true\n", r"\[analyze\] fps = True: expected a valid number"),
        ("[analyze]\nfocal_px = nan\n", r"focal_px = nan: expected a finite number"),
        ("[analyze]\nfocal_px = -1\n", r"focal_px = -1: expected greater than 0"),
        ("[analyze]\nhfov = 180\n", r"hfov = 180: expected less than 180"),
        ("[analyze]\noverlay = 1\n", r"overlay = 1: expected a valid boolean"),
        ('[analyze]\nimage_size = "0x480"\n', r"image_size = '0x480': expected WIDTHxHEIGHT in px"),
        ("[analyze]\ncamera = {a = 1}\n", r"camera = {'a': 1}: "),
        (
            '[egomotion]\nplatform = "car"\n',
            r"platform = 'car': expected 'auto', 'vehicle', 'aircraft', 'free' or 'static'",
        ),
        ("[tracking\nmax_tracks = 5\n", r"ttcvid.toml: is no valid TOML: .*line 1"),
        ("a = " + "[" * 5000, "ttcvid.toml: is nested too deeply"),
    ],
)
def test_a_wrong_configuration_file_is_one_line_that_names_file_key_and_expectation(
    content: str, message: str, empty_folder: Path
) -> None:
    (empty_folder / "ttcvid.toml").write_text(content)
    with pytest.raises(UsageError, match=message) as caught:
        configure_from_command_line({})
    assert "\n" not in str(caught.value)


def test_a_configuration_file_that_is_no_text_or_no_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for config in (tmp_path / "binary.toml", tmp_path / "missing.toml", tmp_path):
        with pytest.raises(UsageError, match=str(config)):
            configure_from_command_line({}, config=config)


@pytest.mark.parametrize(
    ("options", "settings", "message"),
    [
        ({"focal_px": "nan"}, [], "--focal-px = 'nan': expected a finite number"),
        ({"stride": "1.5"}, [], "--stride = '1.5': expected a valid integer"),
        ({}, ["tracking.max_tracks"], "--set tracking.max_tracks: expected section.key=value"),
        ({}, ["max_tracks=5"], "--set max_tracks=5: expected section.key=value"),
        ({}, ["tracking.max_tracsk=500"], "did you mean 'max_tracks'"),
        ({}, ["tracking.max_tracks=many"], "--set tracking.max_tracks = 'many': expected a valid integer"),
    ],
)
def test_a_wrong_argument_is_named_as_it_was_typed(options: dict[str, str], settings: list[str], message: str) -> None:
    with pytest.raises(UsageError) as caught:
        configure_from_command_line(options, settings)
    assert message in str(caught.value)


def test_unknown_variables_are_refused_and_reserved_or_empty_ones_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TTCVID_DATA", "/somewhere")
    monkeypatch.setenv("TTCVID_DEBUG", "1")
    monkeypatch.setenv("TTCVID_FPS", "")
    assert configure_from_command_line({}).options.fps is None
    monkeypatch.setenv("TTCVID_PLATFROM", "vehicle")
    with pytest.raises(UsageError, match="TTCVID_PLATFROM: unknown key 'platfrom': did you mean 'platform'"):
        configure_from_command_line({})


def test_an_unknown_python_argument_is_refused() -> None:
    with pytest.raises(UsageError, match="focal: unknown key 'focal': did you mean 'focal_px'"):
        configure_from_arguments({"focal": 700})


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"mask": np.zeros((3, 4))}, "mask: got an array of shape (3, 4): expected the path of a file"),
        ({"focal_px": np.array([700.0])}, "focal_px: got an array of shape (1,): expected one value"),
        ({"tracking": 5}, "tracking = 5: expected the parameters of this stage as a mapping"),
        ({"focal_px": np.float64(-1.0)}, "focal_px = -1.0: expected greater than 0"),
        ({"fps": 1e308}, "fps = 1e+308"),
        ({"start": 4.5}, 'start = 4.5: expected a frame number, or text such as "120"'),
        ({"timestamps": 3}, "timestamps = 3: expected"),
    ],
)
def test_what_is_no_value_of_an_option_is_said_in_one_line(options: dict[str, object], says: str) -> None:
    with pytest.raises(UsageError) as caught:
        configure_from_arguments(options)
    assert says in str(caught.value)
    assert "valid" not in str(caught.value)


def test_numbers_of_numpy_are_numbers() -> None:
    assert configure_from_arguments({"focal_px": np.float32(700.0)}).options.focal_px == 700
