"""``ttcvid regress`` from suite to verdict: baselines, what is caught, missing clips, mistakes in the suite."""

import re
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from compared_runs import DROPPED, FEW_TRACKS, focal_off, horizon_off, without_a_frame
from moving_clips import approach, write_clip
from processes import DEADLINE_S, STOPPED_WITHIN_S, are_gone, begun, children_of, wait_for
from workers_here import WorkerHere

import ttcvid
from ttcvid.cli.main import main
from ttcvid.cli.regress import regress
from ttcvid.jobs.compare.baseline import baseline_text, write_baseline
from ttcvid.jobs.compare.result_tables import read_run
from ttcvid.jobs.processes.workers import WorkerLostError
from ttcvid.jobs.regress.suite import read_suite
from ttcvid.studies.compare.thinned import thinned
from ttcvid.studies.compare.tolerance import Tolerance, tolerance_from

REPOSITORY = Path(__file__).resolve().parents[2]
LARGEST_BASELINE_BYTES = 30_000
SCENE = """
name: small
camera: {image_size: [240, 160], hfov_deg: 70, height_m: 1.4, fps: 20, n_frames: 20}
own_motion: {speed_m_s: 10}
ground: {kind: street, road_width_m: 8}
bodies:
  - {name: house, kind: house, at_m: [20, 12, 0], size_m: [12, 9, 7.5]}
  - {name: other house, kind: house, at_m: [22, -12, 0], size_m: [12, 9, 7.5]}
"""


@pytest.fixture(autouse=True)
def in_this_process(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes of their own cost seconds each: only tests marked `slow` have them."""
    if "slow" not in request.keywords:
        monkeypatch.setattr("ttcvid.jobs.regress.run_suite.LocalWorker", lambda **_: WorkerHere())


@pytest.fixture(scope="module")
def clip(small_clip: Path) -> Path:
    return small_clip


@pytest.fixture(scope="module")
def baselines(few_tracks_run: Path, horizon_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of baselines of a clip, with and without horizon, as --update writes them."""
    folder = tmp_path_factory.mktemp("baselines")
    for name, run in (("plain", few_tracks_run), ("planar", horizon_run)):
        write_baseline(folder / f"{name}.yaml", baseline_text(thinned(read_run(run), Tolerance().objects)))
    return folder


def entry(clip: Path, name: str = "plain", expectations: Any = (), **options: Any) -> dict[str, Any]:
    """A clip of a suite: the simulated one, unless its pictures are said to be elsewhere."""
    chosen = {"camera": str(clip / "camera.yaml"), "timestamps": str(clip / "timestamps.txt"), "platform": "vehicle"}
    chosen |= options
    pictures = chosen.pop("pictures", str(clip / "frames"))
    return {"name": name, "clip": pictures, "options": chosen, "expectations": list(expectations)}


def written(folder: Path, clips: list[dict[str, Any]], **more: Any) -> Path:
    path = folder / "suite.yaml"
    path.write_text(yaml.safe_dump({"clips": clips, "options": FEW_TRACKS, **more}))
    return path


@pytest.fixture
def ran(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    """Exit code and words of a suite of clips."""

    def run(clips: list[dict[str, Any]], *options: str, baselines: Path | None = None) -> tuple[int, str]:
        suite = written(tmp_path, clips, **({"baselines": str(baselines)} if baselines else {}))
        code = main(["regress", str(suite), "-o", str(tmp_path / "out"), *options])
        printed = capsys.readouterr()
        return code, printed.out + printed.err

    return run


def copies(baselines: Path, folder: Path, **names: str) -> Path:
    """Baselines under other names."""
    folder.mkdir()
    for name, source in names.items():
        shutil.copy(baselines / f"{source}.yaml", folder / f"{name}.yaml")
    return folder


@pytest.mark.slow
def test_a_rerun_passes_and_the_junit_file_says_so(clip, baselines, ran, tmp_path):
    code, text = ran([entry(clip)], baselines=baselines)
    assert code == 0, text
    assert text.startswith("passed   plain:")
    assert "1 clips: 1 passed" in text
    (suite,) = ElementTree.parse(tmp_path / "out/junit.xml").getroot()
    assert (suite.get("name"), suite.get("failures"), suite.get("errors")) == ("plain", "0", "0")
    assert int(suite.get("tests", 0)) > 50


def test_baselines_are_small_texts_and_the_same_each_time(clip, baselines, ran, tmp_path):
    folder = copies(baselines, tmp_path / "b", plain="plain")
    before = (folder / "plain.yaml").read_bytes()
    assert len(before) < LARGEST_BASELINE_BYTES
    code, text = ran([entry(clip)], "--update", baselines=folder)
    assert code == 0
    assert "baseline unchanged" in text
    assert (folder / "plain.yaml").read_bytes() == before


def test_what_is_wrong_with_a_clip_is_caught_and_named(clip, baselines, ran, tmp_path):
    pictures, times = without_a_frame(clip, tmp_path / "dropped")
    clips = [
        entry(clip, name="dropped", pictures=str(pictures), timestamps=str(times)),
        entry(clip, name="focal", camera=str(focal_off(clip, 1.02, tmp_path / "camera.yaml"))),
        entry(clip, name="horizon", horizon=str(horizon_off(clip, 5.0, tmp_path / "horizon.yaml"))),
    ]
    folder = copies(baselines, tmp_path / "b", dropped="plain", focal="plain", horizon="planar")
    junit = tmp_path / "regress.xml"
    code, text = ran(clips, "--junit", str(junit), baselines=folder)
    assert code == 1
    of_clip = {
        name: text[text.index(f"failed   {name}:") :].split("\nfailed")[0] for name in ("dropped", "focal", "horizon")
    }
    assert f"DIFFERENT frames: frame {DROPPED} ({DROPPED / 20:.3f} s) is missing" in of_clip["dropped"]
    # what is printed of a clip ends after some columns; the JUnit file has them all
    assert "collision_times.alpha_rad: factor 0.98" in junit.read_text()
    assert "changed: camera.fx_px" in of_clip["focal"]
    assert "DIFFERENT epipoles.scene.y_px: offset +5 px" in of_clip["horizon"]
    assert "changed: horizon.y_left_px" in of_clip["horizon"]
    few_frames = {**clips[1], "options": {**clips[1]["options"], "end": 4}}
    code, text = ran([few_frames], "--update", baselines=folder)
    assert code == 0
    assert "baseline changed in" in text
    assert "changed: camera.fx_px" in text


def test_expectations_fail_by_themselves_and_are_named(clip, ran):
    right = ["horizon y centre: 141 +- 5", "max_rss_mb: 2000", "min_fps_ratio: 0.001", "events: at most 5"]
    wrong = ["ttc_z of object at (2, 2) in frame 3: 1 s +- 10 %", "max_rss_mb: 1", "events: at least 9"]
    clip_entry = entry(clip, expectations=[*right, *wrong], horizon=str(clip / "horizon.yaml"), end=6)
    code, text = ran([{**clip_entry, "baseline": False}])
    assert code == 1
    assert "4 of 7 expectations met" in text
    assert "no object at (2, 2) in frame 3" in text
    assert "MB of memory, expected at most 1" in text
    assert re.search("warnings?, expected at least 9", text)


def test_what_is_missing_is_compiled_before_the_first_clip(clip, ran, monkeypatch):
    calls = []

    def counted(function, *arguments):
        calls.append(function.__name__)

    monkeypatch.setattr("ttcvid.jobs.regress.run_suite.LocalWorker", lambda **_: WorkerHere(counted))
    monkeypatch.setattr("ttcvid.jobs.regress.run_suite.compile_missing", lambda: calls.append("compile_missing"))
    ran([{**entry(clip, expectations=["max_rss_mb: 2000"], end=2), "baseline": False}])
    assert calls == ["compile_missing", "run_clip"]


def test_a_scene_is_rendered_with_camera_horizon_and_truth(ran, tmp_path):
    (tmp_path / "small.yaml").write_text(SCENE)
    scene = {
        "name": "scene",
        "scene": "small.yaml",
        "frames": 6,
        "options": {"horizon": "horizon.yaml", "platform": "vehicle"},
        "expectations": ["rotation.median <= 0.1", "events: none", "rotation.n >= 100"],
    }
    code, text = ran([scene], "--update")
    assert code == 1
    assert "6 frames" in text
    assert "2 of 3 expectations met" in text
    assert "rotation.n is 5, expected >= 100" in text
    run = ttcvid.Run.open(tmp_path / "out/scene")
    assert run.manifest["image_size"] == {"width_px": 240, "height_px": 160}
    assert run.manifest["horizon"] is not None
    assert (tmp_path / "baselines/scene.yaml").is_file()


def test_a_missing_clip_is_an_error_or_where_optional_a_skip(clip, ran, tmp_path):
    gone = {"clip": "nowhere.mp4", "optional": True, "name": "gone"}
    code, text = ran([gone])
    assert code == 0
    assert "skipped  gone: " in text
    assert "nowhere.mp4: no such clip" in text
    code, text = ran([gone, {**gone, "name": "needed", "optional": False}])
    assert code == 3
    assert "error    needed: " in text
    suites = ElementTree.parse(tmp_path / "out/junit.xml").getroot()
    assert [(s.get("skipped"), s.get("errors")) for s in suites] == [("1", "0"), ("0", "1")], text


def test_an_unreadable_clip_is_an_error_of_that_clip_only(clip, ran, tmp_path):
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(b"no video")
    clips = [{"name": "broken", "clip": str(broken)}, entry(clip, expectations=["events: none"], end=2)]
    code, text = ran([{**one, "baseline": False} for one in clips])
    assert code == 3
    assert "error    broken: " in text
    assert "passed   plain" in text


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda path: path.unlink(), "there is no such baseline yet: write it with 'ttcvid regress --update'"),
        (lambda path: path.write_text(path.read_text()[: -len("...\n")]), "is not whole"),
        (lambda path: path.write_text("a: [1"), "cannot be read as a baseline"),
        (lambda path: path.write_text("name: something else\n"), "is no baseline"),
        (
            lambda path: path.write_text(path.read_text().replace("schema_version: '", "schema_version: 'x")),
            "schema version 'x",
        ),
        (lambda path: path.write_text(path.read_text().replace("rot_x_rad", "rot_x_deg")), "has no column 'rot_x_rad'"),
    ],
)
def test_a_damaged_baseline_is_refused_with_the_reason(damage, reason, clip, baselines, ran, tmp_path):
    folder = copies(baselines, tmp_path / "b", plain="plain")
    damage(folder / "plain.yaml")
    code, text = ran([entry(clip)], baselines=folder)
    assert code == 2
    assert "error    plain: " in text
    assert reason in text


def test_an_update_replaces_a_damaged_baseline(clip, ran, tmp_path):
    baseline = tmp_path / "b/plain.yaml"
    written_texts = []
    for _ in range(2):
        code, text = ran([entry(clip, end=3)], "--update", baselines=baseline.parent)
        assert code == 0, text
        written_texts.append(baseline.read_text())
        baseline.write_text("nothing")
    assert written_texts[0] == written_texts[1] != "nothing"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("clips: []", "field 'clips'"),
        ("clips: [{name: a}]", "clip 'a': expected either 'clip' or 'scene'"),
        ("clips: [{name: a, clip: x, scene: y}]", "clip 'a': expected either 'clip' or 'scene'"),
        ("clips: [{clip: x}]", "clip number 1: field 'name'"),
        ("clips: [{name: a/b, clip: x}]", "clip 'a/b': field 'name'"),
        ("clips: [{name: a, clip: x, frames: 3}]", "'frames' is for scenes"),
        ("clips: [{name: a, clip: x, expectation: x}]", "clip 'a': field 'expectation'"),
        ("clips: [{name: a, clip: x}, {name: a, clip: y}]", "two clips are called 'a'"),
        (
            "clips: [{name: a, clip: x, expectations: ['events: few']}]",
            "clip 'a': expectation 'events: few': expected one of",
        ),
        ("clips: [{name: a, clip: x, expectations: ['ttc_z.medan <= 1']}]", "did you mean 'ttc_z.median'"),
        ("clips: [{name: a, clip: x, tolerance: {frames: 3}}]", "tolerance of clip 'a': field 'frames'"),
        ("clips: {", "is no valid YAML"),
        ("- 1", "expected a list 'clips:'"),
    ],
)
def test_a_mistake_in_the_suite_is_named(content, reason, tmp_path, capsys):
    suite = tmp_path / "suite.yaml"
    suite.write_text(content)
    assert main(["regress", str(suite)]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "suite.yaml" in message
    assert reason in message


def test_an_unknown_name_is_answered_by_the_nearest(clip, ran):
    code, text = ran([entry(clip)], "--only", "plan")
    assert code == 2
    assert "did you mean 'plain'" in text


def test_python_gives_the_outcomes(tmp_path):
    suite = written(tmp_path, [{"clip": "nowhere.mp4", "optional": True, "name": "gone"}])
    seen = []
    result = ttcvid.regress(suite, out=tmp_path / "out", junit=tmp_path / "result.xml", on_clip=seen.append)
    assert result.exit_code == 0
    assert [outcome.status for outcome in result.outcomes] == ["skipped"]
    assert seen == list(result.outcomes)
    assert (tmp_path / "result.xml").is_file()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "jobs"), [(signal.SIGTERM, 2), pytest.param(signal.SIGKILL, 1, marks=pytest.mark.exhaustive)]
)
def test_it_stops_at_once_and_its_processes_end_with_it(number, jobs, tmp_path):
    video = write_clip(tmp_path / "long.mp4", approach(30) * 20)
    clips = [{"name": name, "clip": str(video), "options": {"focal_px": 200}} for name in ("one", "two", "three")]
    out = tmp_path / "out"
    process = begun("regress", written(tmp_path, clips, baselines="none"), "--update", "--jobs", jobs, "-o", out)
    wait_for(lambda: any(out.glob("*/.ttcvid-partial/*.parquet")), process)
    children = children_of(process)
    process.send_signal(number)
    started_s = time.monotonic()
    _, stderr = process.communicate(timeout=DEADLINE_S)
    if number == signal.SIGTERM:
        assert time.monotonic() - started_s < STOPPED_WITHIN_S
        assert process.returncode == 130, stderr
        assert not (out / "junit.xml").exists()
    assert len(children) >= 2
    assert are_gone(children)


def test_a_clip_whose_process_was_killed_is_checked_once_more(clip, ran, monkeypatch):
    killed = []

    def killed_once(function, *arguments):
        if not killed:
            killed.append(function)
            raise WorkerLostError("ended from outside")

    monkeypatch.setattr("ttcvid.jobs.regress.run_suite.LocalWorker", lambda **_: WorkerHere(killed_once))
    code, text = ran([{**entry(clip, expectations=["events: none"], end=2), "baseline": False}])
    assert (code, len(killed)) == (0, 1), text
    assert "1 clips: 1 passed" in text


def yaml_blocks() -> list[Any]:
    text = (REPOSITORY / "docs/regression.md").read_text()
    return [yaml.safe_load(part.split("```")[0]) for part in text.split("```yaml\n")[1:]]


def test_suites_and_tolerances_of_the_manual_and_of_the_samples_can_be_read(tmp_path):
    blocks = yaml_blocks()
    tolerances, suites = ([block for block in blocks if key in block] for key in ("columns", "clips"))
    assert (len(tolerances), len(suites)) == (2, 1)
    for block in tolerances:
        tolerance_from(block, "manual")
    (tmp_path / "tolerance.yaml").write_text("")
    (tmp_path / "suite.yaml").write_text(yaml.safe_dump(suites[0]))
    assert len(read_suite(tmp_path / "suite.yaml").clips) == 2
    for name, n_clips in (("regression", 4), ("regression_data", 5)):
        assert len(read_suite(REPOSITORY / f"sample_configs/{name}.yaml").clips) == n_clips


def test_commands_of_the_workflow_in_the_manual_exist():
    (workflow,) = (block for block in yaml_blocks() if "jobs" in block)
    lines = [step["run"] for step in workflow["jobs"]["regress"]["steps"] if "run" in step]
    (command,) = (line.split() for line in lines if line.startswith("ttcvid"))
    known = {option for parameter in regress.params for option in parameter.opts}
    assert command[1] == "regress"
    assert {word for word in command if word.startswith("-")} <= known
