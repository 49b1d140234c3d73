"""The doctor finds what is broken, and says so with a remedy."""

import importlib.metadata
import json
import re
import sys
import tomllib
from pathlib import Path

import pytest

import ttcvid
from ttcvid.cli.main import main
from ttcvid.jobs import doctor
from ttcvid.jobs.runs.provenance import versions


def test_a_sound_installation_is_well(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    text = capsys.readouterr().out
    assert "all is well" in text
    assert ttcvid.__version__ in text


def test_the_version_is_that_of_the_package() -> None:
    assert importlib.metadata.version("ttcvid") == ttcvid.__version__


def test_json_is_one_object(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["problems"] == []
    assert content["machine"]["cores"] >= 1
    assert {"numpy", "opencv", "av"} <= set(content["versions"])


def test_every_library_that_ttcvid_needs_is_looked_at_and_those_that_compute_stand_in_manifests() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = {re.split("[<>=]", line)[0].removesuffix("-python-headless") for line in project["dependencies"]}
    assert set(doctor.LIBRARIES) == needed
    assert {"numpy", "scipy", "numba", "opencv", "av"} <= set(versions())


def test_two_opencv_wheels_are_found(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(doctor, "installed_opencv_wheels", lambda: ["opencv-python 4.9", "opencv-python-headless 4.10"])
    assert main(["doctor"]) == 1
    assert "opencv-python 4.9 and opencv-python-headless 4.10" in capsys.readouterr().out


def test_opencv_without_akaze_and_av_without_h264_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("cv2.AKAZE_create")

    def no_codec(*_: object) -> None:
        raise ValueError("unknown codec")

    monkeypatch.setattr("av.codec.Codec", no_codec)
    problems = doctor.examine().problems
    assert any("no AKAZE" in problem for problem in problems)
    assert any("no libx264" in problem for problem in problems)


def test_a_library_that_cannot_be_imported_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    diagnosis = doctor.examine()
    assert diagnosis.exit_code == 1
    assert any(problem.startswith("av: cannot be imported") for problem in diagnosis.problems)


def test_an_installation_that_can_keep_no_compiled_code_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ttcvid.jobs.processes.compilation.has_place_on_disk", lambda: False)
    problems = [problem for problem in doctor.examine().problems if problem.startswith("numba: no folder to keep")]
    assert any("NUMBA_CACHE_DIR" in problem for problem in problems)
