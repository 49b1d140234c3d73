"""The demo works anywhere, and compares the right things."""

from pathlib import Path

import pandas as pd
import pytest

from ttcvid.cli.demo import describe
from ttcvid.cli.main import main
from ttcvid.jobs.demo import compare_movers


def boxes(**columns: list[object]) -> pd.DataFrame:
    n = len(columns["frame"])
    table = pd.DataFrame({"x0_px": 0.0, "y0_px": 0.0, "x1_px": 10.0, "y1_px": 10.0}, index=range(n))
    return table.assign(**columns)


TRUTH = boxes(
    frame=[0, 0, 1, 1, 1],
    object_id=[1, 2, 1, 2, 3],
    name=["far", "near", "far", "near", "parked"],
    is_moving=[True, True, True, True, False],
    ttc_z_s=[5.0, 2.0, 4.9, 1.9, 0.5],
    x0_px=[50.0, 0.0, 50.0, 0.0, 0.0],
    x1_px=[60.0, 10.0, 60.0, 10.0, 10.0],
)


def test_each_mover_is_compared_with_the_object_over_it_nearest_first() -> None:
    found = boxes(
        frame=[0, 1, 1, 1],
        role=["scene", "object", "object", "object"],
        x1_px=[10.0, 9.0, 6.0, 60.0],
        ttc_z_s=[2.0, 2.1, 1.0, 4.0],
        ttc_z_lo_s=[1.0, 2.0, 0.9, 3.0],
        ttc_z_hi_s=[3.0, 2.2, 1.1, 5.0],
    )
    comparison, far = compare_movers(TRUTH, found)
    assert (comparison.name, comparison.n_visible) == ("near", 2)
    assert describe(far) == "far: not found in any of 2 frames"
    assert comparison.matches.to_dict("list") == {
        "frame": [1],
        "true_s": [1.9],
        "estimated_s": [2.1],
        "lo_s": [2.0],
        "hi_s": [2.2],
    }
    assert comparison.median_error == pytest.approx(1 - 1.9 / 2.1)
    assert "near: found in 1 of 2 frames, time to collision off by 9.5 % (median); at frame 1 2.10 s" in describe(
        comparison
    )


@pytest.mark.slow
def test_the_demo_runs_in_an_empty_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--frames", "2"]) == 0
    text = capsys.readouterr().out
    assert "look at  ttcvid_demo/result/overlay.mp4" in text
    assert (tmp_path / "ttcvid_demo/result/overlay.mp4").is_file()
    assert "oncoming car: " in text
    assert main(["demo", "--frames", "2"]) == 2
    assert "--overwrite" in capsys.readouterr().err
