"""The demo works anywhere, and says where to look and how good it is."""

from pathlib import Path

import pytest

from ttcvid.cli.main import main

REPOSITORY = Path(__file__).parents[2]


def test_the_demo_shows_the_roundabout_of_the_sample_scenes() -> None:
    shipped = REPOSITORY / "ttcvid/jobs/demo_scene.yaml"
    assert shipped.read_text() == (REPOSITORY / "sample_configs/scenes/roundabout.yaml").read_text()


@pytest.mark.slow
def test_the_demo_runs_in_an_empty_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--frames", "2"]) == 0
    text = capsys.readouterr().out
    assert "look at  ttcvid_demo/result/overlay.mp4" in text
    assert (tmp_path / "ttcvid_demo/result/overlay.mp4").is_file()
    assert text.endswith("report   ttcvid_demo/result/report.html\n")
    assert (tmp_path / "ttcvid_demo/result/report.html").is_file()
    assert "errors   ttcvid_demo/evaluation.html" in text
    assert (tmp_path / "ttcvid_demo/evaluation.html").is_file()
    assert "of own rotation " in text
    assert "object 1 (bus): " in text
    assert main(["demo", "--frames", "2"]) == 2
    assert "--overwrite" in capsys.readouterr().err
