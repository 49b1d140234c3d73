"""``ttcvid sensitivity``: what it writes, from where it is configured, and what it refuses."""

import json
from pathlib import Path

import pytest

import ttcvid
from ttcvid.cli.main import main
from ttcvid.schema import STUDY_TABLES

SAMPLE = Path(__file__).parent.parent.parent / "sample_configs" / "sensitivity.toml"


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("studies") / "study"
    assert main(["sensitivity", str(SAMPLE), "--trials", "100", "-o", str(out), "-q"]) == 0
    return out


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures take a second, and most tests look at none."""
    monkeypatch.setattr("ttcvid.jobs.sensitivity.write_figure", lambda figure, path: path.touch())


def test_table_and_pictures_are_there(study: Path):
    import pandas as pd

    table = pd.read_parquet(study / "sensitivity.parquet")
    assert list(table) == [column.name for column in STUDY_TABLES["sensitivity"]]
    # 12 distances, and planar, three frames, 10, 30 and stereo.
    assert len(table) == 12 * 5
    assert (study / "sensitivity.png").stat().st_size > 20_000
    assert (study / "sensitivity.svg").read_text().startswith("<?xml")


@pytest.mark.usefixtures("no_pictures")
def test_configuration_of_the_file_counts_and_the_command_line_is_stronger(study: Path, tmp_path: Path):
    manifest = json.loads((study / "manifest.json").read_text())
    assert manifest["configuration"]["focal_mm"] == 16
    result = ttcvid.sensitivity(SAMPLE, tmp_path / "other", focal_mm=8.0, steps=2, trials=100)
    assert json.loads((tmp_path / "other" / "manifest.json").read_text())["configuration"]["focal_mm"] == 8
    assert result.reach_m["stereo pair"] < manifest["reach_m"]["stereo pair"]
    assert len(result.table) == 2 * 5


@pytest.mark.usefixtures("no_pictures")
def test_summary_is_one_line_or_one_json_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ["sensitivity", "--steps", "2", "--trials", "100", "--frames", "5", "-o", str(tmp_path / "a")]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert said.count("\n") == 1
    assert "stereo pair up to" in said
    assert main([*words, "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["reach_m"]["stereo pair"] == pytest.approx(6.6, abs=0.1)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--baseline-m", "-0.15"], "--baseline-m = '-0.15': expected greater than 0"),
        (["--frames", ""], "--frames is empty"),
        (["--frames", "2"], "at least 3 pictures"),
        (["--focal-mm", "0"], "--focal-mm = '0'"),
        (["--sigma-px", "nan"], "--sigma-px = 'nan'"),
        (["--angle-deg", "90"], "--angle-deg = '90': expected less than 90"),
        (["--over", "colour"], "--over = 'colour': expected 'distance', 'angle'"),
        (["--first", "50", "--last", "5"], "first = 50 is not below last = 5"),
        (["--last", "4"], "first = 5 is not below last = 4"),
        (["--over", "angle", "--last", "95"], "last = 95 deg"),
        (["--trials", "1"], "--trials = '1'"),
        (["--height-m", "0"], "--height-m = '0'"),
    ],
)
def test_impossible_parameters_are_refused_in_one_line(
    options: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "study"
    assert main(["sensitivity", "-o", str(out), *options]) == 2
    said = capsys.readouterr().err
    assert said.startswith("ttcvid: error: ")
    assert said.count("\n") == 1
    assert complaint in said
    assert not out.exists()
