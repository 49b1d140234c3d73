"""Runs in which one thing has been changed by hand: what ``ttcvid compare`` says of them.

A drive (pictures), a resting camera, and a table of points that ends in a warning.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from compared_runs import SCENE

import ttcvid
from ttcvid.jobs.compare.result_tables import read_run
from ttcvid.model import NO_CLUSTER
from ttcvid.simulate.tracks import TrackOptions
from ttcvid.studies.compare.objects import join_objects
from ttcvid.studies.compare.results import Results, compare_results
from ttcvid.studies.compare.tolerance import ObjectTolerance, Tolerance
from ttcvid.studies.compare.wording import describe_comparison

TIMES = ("ttc_z", "tcpa", "miss")
RUNS = ("drive", "resting", "table")
OF_CLUSTERS = ("clusters", "epipoles", "collision_times")


@pytest.fixture(scope="module")
def runs(small_run: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Results]:
    folder = tmp_path_factory.mktemp("runs")
    found = {"drive": read_run(small_run)}
    for name, scene, platform, sees in (
        ("resting", "resting_six_movers", "static", {"n_frames": 50}),
        ("table", "lead_car_brakes", "vehicle", {}),
    ):
        points = ttcvid.simulate(
            SCENE.with_name(f"{scene}.yaml"), folder / name, tracks=TrackOptions(n_tracks=150), **sees
        )
        table = points.folder / "tracks.parquet"
        run = ttcvid.analyze(
            table,
            folder / f"{name}_run",
            camera=points.folder / "camera.yaml",
            platform=platform,
            overlay=False,
            report=False,
        )
        found[name] = read_run(run)
    return found


def said(one: Results, tables: dict[str, pd.DataFrame]) -> tuple[bool, str]:
    """Whether the run with these tables instead is the same, and the words."""
    other = Results("changed", {**one.tables, **tables}, one.facts, one.clock)
    comparison = compare_results(one, other, Tolerance())
    text = "\n".join(describe_comparison(comparison))
    assert "nan" not in text
    return comparison.is_same, text


def with_numbers(one: Results, number: dict[int, int], first_frame: int = 0) -> dict[str, pd.DataFrame]:
    """The tables with other ``cluster_id`` from a frame on; NO_CLUSTER takes rows of clusters away."""
    tables = {}
    for name in OF_CLUSTERS:
        table = one.tables[name]
        numbers = table.cluster_id.where(table.frame < first_frame, table.cluster_id.replace(number))
        table = table.assign(cluster_id=numbers)
        tables[name] = table if name == "collision_times" else table[table.cluster_id != NO_CLUSTER]
        tables[name] = tables[name].sort_values(list(tables[name].columns[:1]), kind="stable").reset_index(drop=True)
    return tables


def objects_of(one: Results) -> list[int]:
    return sorted(number for number in one.tables["clusters"].cluster_id.unique() if number > 0)


def main_object(one: Results) -> int:
    """What carries a warning, else what has most tracks."""
    if len(one.tables["events"]):
        return int(one.tables["events"].cluster_id.iloc[0])
    objects = one.tables["clusters"][one.tables["clusters"].cluster_id > 0]
    return int(objects.groupby("cluster_id").n_tracks.sum().idxmax())


def test_the_runs_have_what_is_taken_from_them(runs):
    assert [len(objects_of(runs[name])) >= n for name, n in zip(RUNS, (1, 4, 1), strict=True)] == [True] * 3
    assert len(runs["table"].tables["events"]) == 1


@pytest.mark.parametrize("name", RUNS)
def test_unchanged_it_is_the_same_and_says_what_counted(name, runs):
    is_same, text = said(runs[name], {})
    assert is_same
    n = len(objects_of(runs[name]))
    (line,) = (line for line in text.splitlines() if line.startswith("clusters.objects"))
    assert f"{n} and {n} objects, " in line
    assert " counted, " in line
    assert ", 0 counted" not in line


@pytest.mark.parametrize("name", RUNS)
def test_all_objects_gone(name, runs):
    one = runs[name]
    is_same, text = said(one, with_numbers(one, dict.fromkeys(objects_of(one), NO_CLUSTER)))
    assert not is_same
    assert f"{len(objects_of(one))} and 0 objects" in text
    assert "missing" in text


@pytest.mark.parametrize("name", RUNS)
def test_all_objects_gone_from_the_tables_of_clusters_alone(name, runs):
    one = runs[name]
    tables = with_numbers(one, dict.fromkeys(objects_of(one), NO_CLUSTER))
    is_same, text = said(one, {part: tables[part] for part in ("clusters", "epipoles")})
    assert not is_same
    assert "missing" in text


@pytest.mark.parametrize("name", RUNS)
def test_one_object_gone(name, runs):
    one = runs[name]
    is_same, text = said(one, with_numbers(one, {main_object(one): NO_CLUSTER}))
    assert not is_same
    assert f"DIFFERENT clusters.objects: object {main_object(one)} (frames " in text
    assert "is missing" in text


def test_an_object_with_a_warning_is_missed_however_few_its_tracks(runs):
    one = runs["table"]
    few = {**one.tables, "clusters": one.tables["clusters"].assign(n_tracks=4)}
    one = Results("few tracks", few, one.facts, one.clock)
    is_same, text = said(one, with_numbers(one, {main_object(one): NO_CLUSTER}))
    assert not is_same
    assert "with a warning) is missing" in text


@pytest.mark.parametrize("name", RUNS)
def test_one_object_new(name, runs):
    one = runs[name]
    tables = {}
    for part in ("clusters", "epipoles"):
        table = one.tables[part]
        new = table[table.cluster_id == main_object(one)].assign(cluster_id=99)
        moved = {column: new[column] + 900.0 for column in ("x0_px", "x1_px", "ref_x_px") if column in new}
        tables[part] = pd.concat([table, new.assign(**moved)]).sort_values(["frame", "cluster_id"], ignore_index=True)
    is_same, text = said(one, tables)
    assert not is_same
    assert "object 99 (frames " in text
    assert "is additional" in text


def test_other_numbers_for_life_are_no_difference(runs):
    one = runs["resting"]
    first, second = objects_of(one)[:2]
    is_same, text = said(one, with_numbers(one, {first: second, second: first}))
    assert is_same, text


def test_exchanged_numbers_are_named(runs):
    one = runs["resting"]
    of_objects = one.tables["clusters"][one.tables["clusters"].cluster_id > 0]
    both = of_objects.cluster_id.value_counts().index[:2].tolist()
    is_same, text = said(one, with_numbers(one, dict(zip(both, both[::-1], strict=True)), first_frame=25))
    assert not is_same
    for number in both:
        assert f"DIFFERENT clusters.objects: object {number} does not keep one number in the run" in text


@pytest.mark.parametrize("name", ["drive", "table"])
def test_a_number_that_changes_on_the_way_is_named(name, runs):
    one = runs[name]
    frames = one.tables["clusters"].frame[one.tables["clusters"].cluster_id == main_object(one)]
    is_same, text = said(one, with_numbers(one, {main_object(one): 98}, int(frames.median())))
    assert not is_same
    assert f"object {main_object(one)} does not keep one number in the run" in text


def test_a_warning_of_another_object_is_named(runs):
    one = runs["table"]
    is_same, text = said(one, with_numbers(one, {main_object(one): 98}))
    assert not is_same
    assert f"is of object {main_object(one)} in the run, which is another one" in text


@pytest.mark.parametrize("name", RUNS)
def test_the_times_of_one_object_tripled(name, runs):
    one = runs[name]
    clusters = one.tables["clusters"].copy()
    own = clusters.cluster_id == main_object(one)
    columns = [f"{stem}{end}_s" for stem in TIMES for end in ("", "_lo", "_hi")]
    clusters.loc[own, columns] *= 3
    is_same, text = said(one, {"clusters": clusters})
    assert not is_same
    assert f"object {main_object(one)}" in text


@pytest.mark.parametrize("name", RUNS)
@pytest.mark.parametrize("part", ["clusters", "collision_times"])
def test_all_intervals_halved(part, name, runs):
    one = runs[name]
    table = one.tables[part].copy()
    for stem in TIMES:
        for end in ("lo", "hi"):
            table[f"{stem}_{end}_s"] = (table[f"{stem}_{end}_s"] + table[f"{stem}_s"]) / 2
    is_same, text = said(one, {part: table})
    assert not is_same
    assert "_hi_s" in text
    # In the drive, half of the lower part of most tracks' intervals is within the tolerance.
    assert "_lo_s" in text or (part, name) == ("collision_times", "drive")


@pytest.mark.parametrize("name", RUNS)
def test_the_cluster_of_every_tenth_track_lost(name, runs):
    one = runs[name]
    tracks = one.tables["collision_times"]
    lost = np.where(tracks.track_id % 10 == 3, NO_CLUSTER, tracks.cluster_id)
    is_same, text = said(one, {"collision_times": tracks.assign(cluster_id=lost)})
    assert not is_same
    assert "DIFFERENT collision_times.cluster_id" in text


def small_objects(n: int, frames: range) -> pd.DataFrame:
    """``n`` objects of four tracks that go away, side by side."""
    rows = pd.DataFrame({"frame": np.repeat(np.arange(frames.start, frames.stop), n)})
    rows["cluster_id"] = np.tile(np.arange(n) + 10, len(frames))
    x_px = 30.0 * rows.cluster_id
    rows = rows.assign(t_s=0.1 * rows.frame, x0_px=x_px, x1_px=x_px + 10, y0_px=0.0, y1_px=10.0, n_tracks=4)
    return rows.assign(state="receding", motion_id=1, ttc_z_s=-1.0, ttc_z_lo_s=-2.0, ttc_z_hi_s=-0.5)


def test_small_objects_count_as_a_rate():
    many = small_objects(16, range(10))
    few = many[many.cluster_id >= 14]
    assert join_objects(many, few[:0], ObjectTolerance()).complaints == (
        "all 16 objects (160 object-frames) are missing",
    )
    assert join_objects(few, few[few.cluster_id >= 17], ObjectTolerance()).complaints == ()
    (complaint,) = join_objects(many, many[many.cluster_id >= 22], ObjectTolerance()).complaints
    assert complaint == (
        "small or uncertain objects: 160 object-frames became 40 (120 are gone, 0 are new), more than 3 standard "
        "deviations"
    )
