"""The report of a run: what it says, what it leaves out, and where it is written."""

import doctest
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from made_runs import DT_S, WARNED_FROM, made_run, smallest_ttc_s
from moving_clips import approach, write_clip

import ttcvid
from ttcvid.cli.main import main
from ttcvid.errors import InputError, OutputError, UsageError
from ttcvid.report import colours, series, sphere

MAX_PAGE_BYTES = 5_000_000


def data_of(page: Path) -> dict:
    """The numbers in a page."""
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page.read_text(encoding="utf-8"))
    return json.loads(text)


@pytest.mark.parametrize("module", [colours, series, sphere])
def test_examples_in_the_documentation_hold(module) -> None:
    failed, attempted = doctest.testmod(module)
    assert attempted >= 1
    assert failed == 0


def test_every_analysis_has_a_report_that_its_manifest_lists(tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip.mp4", approach(6))
    run = ttcvid.analyze(clip, tmp_path / "run", overlay=False)
    assert run.report == tmp_path / "run/report.html"
    assert run.manifest["files"]["report.html"] == run.report.stat().st_size
    text = run.report.read_text(encoding="utf-8")
    assert "<h1>clip.mp4: report of the analysis</h1>" in text
    assert "6 frames of 192 × 128 px" in text
    assert "The focal length is assumed" in text
    assert "There is no annotated video of this run" in text
    assert run.manifest["configuration"]["analyze"]["report"] == {"value": True, "origin": "default"}
    without = ttcvid.analyze(clip, tmp_path / "run", overlay=False, report=False, overwrite=True)
    assert without.report is None
    assert not (tmp_path / "run/report.html").exists()


def test_a_report_says_what_was_found_and_where_it_is(tmp_path: Path) -> None:
    nearest = {"cluster_id": 1, "frame": 39, "ttc_z_s": 0.6, "ttc_z_lo_s": 0.54, "ttc_z_hi_s": 0.72}
    page = ttcvid.report(made_run(tmp_path / "run", nearest=nearest))
    text = page.read_text(encoding="utf-8")
    assert "2 objects were found; 1 warning was given." in text
    assert "Object 1 was on collision course from 2.00 to 3.90 s" in text
    assert "The smallest time to collision is 0.60 s (90 % interval 0.54 to 0.72 s), of object 1 at frame 39" in text
    assert f'class="warning" data-frame="{WARNED_FROM}"' in text
    assert "Others, of which it was never sure that they come nearer" in text
    run = data_of(page)["runs"][0]
    assert [one["id"] for one in run["objects"]] == [1, 2]
    assert run["objects"][0]["ttc_z"][0] == pytest.approx(4.5)
    assert run["objects"][0]["ttc_z_lo"][0] == pytest.approx(4.05)
    # It comes from where -dir points: 0.6 to the left over 0.8 ahead.
    assert run["objects"][0]["epipole"][0][0] == pytest.approx(np.degrees(np.arctan2(-0.6, 0.8)), abs=0.01)
    assert run["frames"]["rates"]["y"][1] == pytest.approx(np.degrees(-0.002 / DT_S), abs=0.001)
    assert run["frames"]["rates"]["y"][0] is None
    assert ttcvid.Run.open(tmp_path / "run").report == page


def test_names_from_outside_cannot_become_part_of_the_page(tmp_path: Path) -> None:
    name = "<script>alert(1)</script><img src=x onerror=alert(2)>.mp4"
    given = {"path": f"clips/{name}", "nominal_dt_s": DT_S, "sha256": "", "n_files": 1, "kind": "video"}
    warning = "</script><b>" + name
    text = ttcvid.report(made_run(tmp_path / "run", input=given, warnings=[warning])).read_text(encoding="utf-8")
    assert "alert(1)" in text
    assert "<script>alert" not in text
    assert "<img" not in text
    assert "<b>" not in text
    assert json.loads(series.as_json({"a": warning})) == {"a": warning}
    assert "<" not in series.as_json({"a": warning})


def test_ten_minutes_stay_small_and_keep_the_smallest_time(tmp_path: Path) -> None:
    n_frames = 18_000
    page = ttcvid.report(made_run(tmp_path / "run", n_frames, n_objects=5))
    assert page.stat().st_size < MAX_PAGE_BYTES
    run = data_of(page)["runs"][0]
    shown = [len(one["at"]) for one in run["objects"]]
    assert sum(shown) <= series.MAX_ROWS + 2 * len(shown)
    assert min(run["objects"][0]["ttc_z"]) == pytest.approx(smallest_ttc_s(n_frames), abs=1e-3)
    assert len(run["clock"]["frame"]) == n_frames
    assert "one frame in 3" in page.read_text(encoding="utf-8")


def test_of_many_objects_those_warned_of_and_the_soonest_are_shown(tmp_path: Path) -> None:
    page = ttcvid.report(made_run(tmp_path / "run", 25, n_objects=series.MAX_OBJECTS + 10))
    assert data_of(page)["runs"][0]["objects"][0]["id"] == 1
    assert f"{series.MAX_OBJECTS} of {series.MAX_OBJECTS + 10} objects are shown" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(("n_frames", "n_objects"), [(1, 0), (1, 1), (30, 0)])
def test_the_smallest_runs_have_a_report(n_frames: int, n_objects: int, tmp_path: Path) -> None:
    text = ttcvid.report(made_run(tmp_path / "run", n_frames, n_objects)).read_text(encoding="utf-8")
    assert ("No object was found" in text) == (n_objects == 0)


def test_the_command_writes_where_it_is_told_and_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = made_run(tmp_path / "a run", has_video=True)
    manifest = (run / "manifest.json").read_bytes()
    (tmp_path / "pages").mkdir()
    page = tmp_path / "pages/one.html"
    assert main(["report", str(run), "-o", str(page)]) == 0
    assert capsys.readouterr().out == f"{page}\n"
    assert 'src="./../a%20run/overlay.mp4"' in page.read_text(encoding="utf-8")
    assert (run / "manifest.json").read_bytes() == manifest
    assert not (run / "report.html").exists()


def test_of_several_runs_the_page_says_what_they_differ_in(tmp_path: Path) -> None:
    one, other = made_run(tmp_path / "one"), made_run(tmp_path / "other", n_objects=1, state="truncated")
    ttcvid.report(one)
    page = ttcvid.report(one, other, out=tmp_path / "both.html")
    text = page.read_text(encoding="utf-8")
    table = text[text.index('<table class="compared">') : text.index("</table>")]
    rows = {name: kind for kind, name in re.findall(r'<tr( class="differs")?><th scope="row">(.*?)</th>', table)}
    assert rows["state"] == rows["objects"] == ' class="differs"'
    assert rows["frames"] == rows["focal length"] == ""
    assert '<a href="./one/report.html">' in table
    assert len(data_of(page)["runs"]) == 2
    assert len(data_of(page)["runs"][1]["objects"]) == 1
    assert not (other / "report.html").exists()


def test_what_cannot_be_reported_is_refused_with_a_reason(tmp_path: Path) -> None:
    run = made_run(tmp_path / "run")
    with pytest.raises(UsageError, match="-o FILE"):
        ttcvid.report(run, run)
    with pytest.raises(UsageError, match="needs a run"):
        ttcvid.report()
    with pytest.raises(InputError, match="no such folder"):
        ttcvid.report(tmp_path / "nowhere")
    with pytest.raises(InputError, match="no finished run"):
        ttcvid.report(tmp_path)
    with pytest.raises(OutputError, match="is a folder"):
        ttcvid.report(run, out=tmp_path)
    (run / "report.html").write_text("mine")
    with pytest.raises(OutputError, match="not a file of this run"):
        ttcvid.report(run)
    assert (run / "report.html").read_text() == "mine"
    (run / "clusters.parquet").unlink()
    with pytest.raises(InputError, match=r"clusters\.parquet: cannot be read as a table"):
        ttcvid.report(run, out=tmp_path / "page.html")
    assert main(["report", str(tmp_path)]) == 3


def test_a_report_loads_no_library_that_takes_longer_than_itself(tmp_path: Path) -> None:
    run = made_run(tmp_path / "run")
    code = (
        "import sys; from pathlib import Path; from ttcvid.jobs.report import write_report; "
        "from ttcvid.sinks.manifest import read_manifest; run = Path(sys.argv[1]); "
        "write_report(run, 'run', read_manifest(run), False); "
        "print([name for name in ('pandas', 'matplotlib') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(run)], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
