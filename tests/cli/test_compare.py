"""``ttcvid compare`` from analysis to verdict: what has to pass, what has to be caught and named, what is refused."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from compared_runs import (
    DROPPED,
    N_FRAMES,
    analyzed,
    changed_copy,
    focal_off,
    horizon_off,
    negated,
    with_column,
    without_a_frame,
)

import ttcvid
from ttcvid.cli.main import main
from ttcvid.schema import VERSION_KEY

EXACT = "columns: {'*': {}}\nparts: {'*': {max_share: 0, typical: 0}}\n"


@pytest.fixture
def clip(small_clip: Path) -> Path:
    return small_clip


@pytest.fixture(scope="module")
def baseline(few_tracks_run: Path) -> Path:
    return few_tracks_run


@pytest.fixture
def compared(baseline: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    """Exit code and words of a comparison with the baseline."""

    def run(other: Path, *options: str, beside: Path = baseline) -> tuple[int, str]:
        code = main(["compare", str(beside), str(other), *options])
        printed = capsys.readouterr()
        return code, printed.out + printed.err

    return run


def test_a_rerun_into_another_folder_is_the_same_even_exactly(clip, compared, tmp_path):
    exact = tmp_path / "exact.yaml"
    exact.write_text(EXACT)
    again = analyzed(clip, tmp_path / "elsewhere" / "again", overlay=True)
    code, text = compared(again, "--tolerance", str(exact))
    assert code == 0, text
    assert "changed" not in text
    assert "DIFFERENT" not in text


def test_another_seed_is_named_and_passes(clip, compared, tmp_path):
    code, text = compared(analyzed(clip, tmp_path / "run", seed=3))
    assert code == 0, text
    assert "changed: configuration.analyze.seed: 0 -> 3" in text


def test_a_frame_dropped_from_the_clip_or_added_is_named_by_its_time(clip, baseline, compared, tmp_path):
    pictures, times = without_a_frame(clip, tmp_path / "dropped")
    shorter = analyzed(clip, tmp_path / "run", pictures, timestamps=times)
    code, text = compared(shorter)
    assert code == 1
    assert f"DIFFERENT frames: frame {DROPPED} ({DROPPED / 20:.3f} s) is missing" in text
    assert "changed: input.sha256" in text
    assert f"{N_FRAMES - 1} joined of {N_FRAMES} and {N_FRAMES - 1}" in text
    code, text = compared(baseline, beside=shorter)
    assert code == 1
    assert f"DIFFERENT frames: frame {DROPPED} ({DROPPED / 20:.3f} s) is additional" in text


def test_a_frame_dropped_from_a_clip_without_times_of_its_own_is_named_by_the_pictures(clip, compared, tmp_path):
    pictures, _ = without_a_frame(clip, tmp_path / "dropped")
    code, text = compared(analyzed(clip, tmp_path / "run", pictures, fps=20))
    assert code == 1
    assert "joined by what they show" in text
    assert f"DIFFERENT frames: frame {DROPPED} ({DROPPED / 20:.3f} s) is missing" in text
    assert "frames.t_s" in text


def test_a_focal_length_off_by_2_percent_is_named(clip, compared, tmp_path):
    camera = focal_off(clip, 1.02, tmp_path / "camera.yaml")
    code, text = compared(analyzed(clip, tmp_path / "run", camera=camera))
    assert code == 1
    assert re.search(r"changed: camera.fx_px: .* -> .* \(\+9.32, \+2 %\)", text)
    assert "DIFFERENT collision_times.alpha_rad: factor 0.98" in text


def test_a_horizon_off_by_5_px_is_named(clip, horizon_run, compared, tmp_path):
    off = analyzed(clip, tmp_path / "off", horizon=horizon_off(clip, 5.0, tmp_path / "horizon.yaml"))
    code, text = compared(off, beside=horizon_run)
    assert code == 1
    assert re.search(r"changed: horizon.y_left_px: .* -> .* \(\+5, ", text)
    assert "DIFFERENT epipoles.scene.y_px: offset +5 px" in text


SIGNED = [
    ("frames", ["rot_x_rad", "rot_y_rad"]),
    ("epipoles", ["dir_y", "dir_z"]),
    ("collision_times", ["tcpa_s", "ttc_z_s", "k_frames"]),
]


@pytest.mark.parametrize(("table", "column"), [(table, column) for table, columns in SIGNED for column in columns])
def test_a_swapped_sign_is_named(table, column, baseline, compared, tmp_path):
    code, text = compared(changed_copy(baseline, tmp_path / "run", table, lambda rows: negated(rows, column)))
    assert code == 1
    part = "epipoles.scene" if table == "epipoles" else table
    assert f"DIFFERENT {part}.{column}: the sign is swapped" in text


def test_worst_rows_are_printed_with_frame_time_and_both_values(baseline, compared, tmp_path):
    def change(rows: pa.Table) -> pa.Table:
        values = rows.column("rot_y_rad").to_numpy().copy()
        values[5:9] = 0.25
        return with_column(rows, "rot_y_rad", values)

    code, text = compared(changed_copy(baseline, tmp_path / "run", "frames", change))
    assert code == 1
    assert f"DIFFERENT frames.rot_y_rad (4 of {N_FRAMES - 1} rows outside the tolerance" in text
    (line,) = (line for line in text.splitlines() if "frame 5 (0.250 s)" in line)
    before = ttcvid.Run.open(baseline).frames.rot_y_rad[5]
    assert f"{before:.6g} -> 0.25 rad" in line


def test_few_rows_outside_are_within_the_tolerance_of_their_table(baseline, compared, tmp_path):
    def change(rows: pa.Table) -> pa.Table:
        values = rows.column("alpha_rad").to_numpy().copy()
        values[1000 : 1000 + len(values) // 50] += 1.0
        return with_column(rows, "alpha_rad", values)

    run = changed_copy(baseline, tmp_path / "run", "collision_times", change)
    assert compared(run)[0] == 0
    strict = tmp_path / "strict.yaml"
    strict.write_text("parts: {collision_times: {max_share: 0.001}}\n")
    code, text = compared(run, "--tolerance", str(strict))
    assert code == 1
    assert "collision_times.alpha_rad" in text


def test_json_and_junit_say_the_same(baseline, tmp_path, capsys):
    run = changed_copy(baseline, tmp_path / "run", "frames", lambda rows: negated(rows, "rot_x_rad"))
    junit = tmp_path / "result.xml"
    assert main(["compare", str(baseline), str(run), "--json", "--junit", str(junit)]) == 1
    content = json.loads(capsys.readouterr().out)
    assert content["is_same"] is False
    different = [column["name"] for column in content["columns"] if not column["is_same"]]
    assert different == ["frames.rot_x_rad"]
    assert {part["part"] for part in content["parts"]} >= {"frames", "collision_times", "events"}
    (suite,) = ElementTree.parse(junit).getroot()
    failed = [case.get("name") for case in suite if case.find("failure") is not None]
    assert failed == ["frames.rot_x_rad"]
    assert (suite.get("tests"), suite.get("failures")) == (str(len(suite)), "1")


def test_python_gives_the_comparison(baseline):
    comparison = ttcvid.compare(ttcvid.Run.open(baseline), baseline)
    assert comparison.is_same
    assert comparison.changes == ()


def truncated(run: Path) -> None:
    path = run / "collision_times.parquet"
    path.write_bytes(path.read_bytes()[:-1000])


def half_written(run: Path) -> None:
    (run / "manifest.json").unlink()


def without_a_table(run: Path) -> None:
    (run / "clusters.parquet").unlink()


def half_manifest(run: Path) -> None:
    path = run / "manifest.json"
    path.write_text(path.read_text()[:200])


def of_another_program(run: Path) -> None:
    (run / "manifest.json").write_text('{"name": "a web page"}')


def without_state(run: Path) -> None:
    content = json.loads((run / "manifest.json").read_text())
    del content["state"]
    (run / "manifest.json").write_text(json.dumps(content))


def of_another_schema(run: Path) -> None:
    table = pq.read_table(run / "frames.parquet")
    metadata = {**table.schema.metadata, VERSION_KEY.encode(): b"0"}
    pq.write_table(table.replace_schema_metadata(metadata), run / "frames.parquet")


def foreign_table(run: Path) -> None:
    pq.write_table(pa.table({"frame": [1, 2]}), run / "events.parquet")


def without_a_column(run: Path) -> None:
    table = pq.read_table(run / "frames.parquet")
    pq.write_table(table.drop_columns(["rot_x_rad"]), run / "frames.parquet")


def text_for_numbers(run: Path) -> None:
    table = pq.read_table(run / "frames.parquet")
    place = table.schema.get_field_index("rot_x_rad")
    texts = pc.cast(table.column("rot_x_rad"), pa.string())
    pq.write_table(table.set_column(place, "rot_x_rad", texts), run / "frames.parquet")


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (truncated, "collision_times.parquet: cannot be read as a table"),
        (half_written, "manifest.json: not found, so this is no finished run"),
        (without_a_table, "clusters.parquet: not found, so the result is not whole"),
        (half_manifest, "manifest.json: cannot be read as JSON"),
        (of_another_program, "ttcvid did not write it"),
        (without_state, "field 'state' is missing"),
        (of_another_schema, "frames.parquet: schema version 0, expected"),
        (foreign_table, "events.parquet: schema version none, expected"),
        (without_a_column, "frames.parquet: column 'rot_x_rad' is missing"),
        (text_for_numbers, "frames.parquet: column 'rot_x_rad' is string, expected double"),
        (shutil.rmtree, "no such folder"),
    ],
)
@pytest.mark.parametrize("side", ["baseline", "run"])
def test_what_is_not_whole_or_foreign_is_refused_with_the_reason(damage, reason, side, baseline, compared, tmp_path):
    damaged = Path(shutil.copytree(baseline, tmp_path / "damaged"))
    damage(damaged)
    code, text = compared(damaged) if side == "run" else compared(baseline, beside=damaged)
    assert code == 2
    assert text.count("\n") == 1
    assert "damaged" in text
    assert reason in text


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (
            "columns: {frames.rot_x: {abs: 1}}",
            "'frames.rot_x' is no column or part of a table: did you mean 'frames.rot_x_rad'",
        ),
        ("columns: {frames.rot_x_rad: {abs: -1}}", "greater than or equal to 0"),
        ("parts: {frames: {share: 1}}", "field 'share'"),
        ("objects: {min_frames: many}", "field 'objects.min_frames' = 'many'"),
        ("[1, 2]", "expected sections"),
        ("a: [", "is no valid YAML"),
    ],
)
def test_a_mistake_in_the_tolerances_is_named(content, reason, baseline, compared, tmp_path):
    file = tmp_path / "tolerance.yaml"
    file.write_text(content)
    code, text = compared(baseline, "--tolerance", str(file))
    assert code == 2
    assert "tolerance.yaml" in text
    assert reason in text
