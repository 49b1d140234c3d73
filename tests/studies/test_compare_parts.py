"""The parts of a comparison: joining frames, tracks, objects and warnings; judging columns."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_results import DT_S, FACTS, N_FRAMES, N_TRACKS, different, whole_result, with_table

from ttcvid.schema import TABLES
from ttcvid.studies.compare.columns import JoinedRows, explanation, is_judged, judge_columns, reported_sigma
from ttcvid.studies.compare.frames import join_frames
from ttcvid.studies.compare.objects import OTHER_OBJECT, baseline_numbers, join_events, join_objects
from ttcvid.studies.compare.results import Results, changes, compare_results
from ttcvid.studies.compare.tolerance import (
    NOT_JUDGED,
    EventTolerance,
    FrameTolerance,
    ObjectTolerance,
    Tolerance,
    markdown_of_tolerances,
    tolerance_from,
)
from ttcvid.studies.compare.tracks import join_tracks, positions_by_frame


def test_facts_that_differ_by_rounding_alone_are_no_change():
    one = Results("one", {}, {"input.nominal_dt_s": 0.05, "camera.fx_px": 700.0}, pd.DataFrame())
    other = Results("other", {}, {"input.nominal_dt_s": 0.05 - 2.8e-17, "camera.fx_px": 700.0001}, pd.DataFrame())
    assert [change.name for change in changes(one, other)] == ["camera.fx_px"]


def test_a_result_is_the_same_as_itself():
    assert different(whole_result(), whole_result()) == ([], [])


JOINED_BY = {"x_px", "y_px", "x0_px", "y0_px", "x1_px", "y1_px", "t_s", "start_s", "end_s"}
"""Columns that rows are joined by, and that are judged then."""


@pytest.mark.parametrize("table", TABLES)
def test_every_column_is_judged(table):
    """Every number a quarter more, and a bit, and every name another one: each column is different, and no other."""
    one = whole_result()
    changed, judged = one.tables[table].copy(), set()
    for column in TABLES[table]:
        if not is_judged(table, column.name) or (column.name in JOINED_BY and table != "epipoles"):
            continue
        if column.name == "cluster_id" or column.name == "method":
            continue
        judged.add(column.name)
        if column.values:
            changed[column.name] = pd.Categorical([column.values[-1]] * len(changed), list(column.values))
        else:
            is_real = str(changed[column.name].dtype).startswith("float")
            changed[column.name] = changed[column.name] * (1.25 if is_real else 2) + (
                0.05 if column.name == "dt_s" else 2
            )
    columns, complaints = different(one, with_table(one, table, changed))
    assert {name.split(".")[-1] for name in columns} == judged
    assert complaints == []


@pytest.mark.parametrize(
    ("table", "column", "shift"),
    [
        ("frames", "t_s", 0.02),
        ("collision_times", "x_px", 0.7),
        ("collision_times", "y_px", -0.7),
        *(("clusters", f"{axis}{end}_px", 8.0) for axis in "xy" for end in "01"),
        ("events", "start_s", 0.5),
        ("events", "end_s", 0.5),
    ],
)
def test_columns_that_rows_are_joined_by_are_judged(table, column, shift):
    one = whole_result()
    changed = one.tables[table].assign(**{column: one.tables[table][column] + shift})
    columns, complaints = different(one, with_table(one, table, changed))
    assert {name.split(".")[-1] for name in columns} == {column}
    assert complaints == []


def test_tracks_of_another_cluster_and_another_method_are_named():
    one = whole_result()
    tracks = one.tables["collision_times"]
    assert different(one, with_table(one, "collision_times", tracks.assign(cluster_id=0)))[0] == [
        "collision_times.cluster_id"
    ]
    columns, _ = different(one, with_table(one, "epipoles", one.tables["epipoles"].assign(method="other")))
    assert columns == ["epipoles.scene.method", "epipoles.objects.method"]


def test_columns_of_no_unit_that_are_not_judged_name_rows():
    assert set(NOT_JUDGED) == {
        "frame", "t_s", "track_id", "cluster_id", "motion_id", "event_id", "role", "start_frame", "end_frame",
    }  # fmt: skip


def test_numbers_of_objects_and_tracks_do_not_matter():
    one = whole_result()
    number = {0: 0, 3: 11, 7: 2}
    tables = {
        name: table.assign(cluster_id=table.cluster_id.map(number)) if "cluster_id" in table else table
        for name, table in one.tables.items()
    }
    tables["collision_times"] = tables["collision_times"].assign(track_id=10_000 - tables["collision_times"].track_id)
    assert different(one, Results("renumbered", tables, FACTS, one.clock)) == ([], [])


def test_a_time_of_which_only_the_interval_is_told_is_judged_by_its_middle():
    one = whole_result()
    eta_hz = 1.0 / one.tables["clusters"].ttc_z_s
    clusters = one.tables["clusters"].assign(ttc_z_lo_s=1.0 / (eta_hz + 0.4), ttc_z_hi_s=1.0 / (eta_hz - 0.4))
    assert (clusters.ttc_z_lo_s > clusters.ttc_z_hi_s).all()
    one, untold = with_table(one, "clusters", clusters), clusters.assign(ttc_z_s=np.nan)
    assert different(one, with_table(one, "clusters", untold)) == ([], [])
    longer = untold.assign(**{f"ttc_z_{end}_s": 2.0 * clusters[f"ttc_z_{end}_s"] for end in ("lo", "hi")})
    assert any(name.endswith(".ttc_z_s") for name in different(one, with_table(one, "clusters", longer))[0])
    nothing = untold.assign(ttc_z_lo_s=np.nan, ttc_z_hi_s=np.nan)
    assert any(name.endswith(".ttc_z_s") for name in different(one, with_table(one, "clusters", nothing))[0])


def test_a_value_on_one_side_only_is_outside_of_every_tolerance():
    one = whole_result()
    changed = one.tables["frames"].copy()
    changed.loc[:9, "rot_x_rad"] = np.nan
    comparison = compare_results(one, with_table(one, "frames", changed), Tolerance())
    (column,) = (column for column in comparison.columns if not column.is_same)
    assert (column.name, column.n_outside) == ("frames.rot_x_rad", 10)
    assert column.worst[0].run == "null"
    assert column.worst[0].ratio == np.inf


def test_differences_are_judged_in_the_reported_sigmas():
    """A third of a sigma in some rows is nothing, in every row of a column a difference; two sigmas always are."""
    one = whole_result()
    limits = tolerance_from({"columns": {"clusters.c_hz": {"sigmas": 1}}}, "")
    clusters = one.tables["clusters"]
    sigma = np.sqrt(clusters.cov_cc.to_numpy())
    few = np.arange(len(sigma)) < 9
    assert (
        different(one, with_table(one, "clusters", clusters.assign(c_hz=clusters.c_hz + 0.3 * sigma * few)), limits)[0]
        == []
    )
    for shift in (0.3 * sigma * clusters.cluster_id.eq(0), 2 * sigma * few):
        columns, _ = different(one, with_table(one, "clusters", clusters.assign(c_hz=clusters.c_hz + shift)), limits)
        assert columns == ["clusters.scene.c_hz"]


def test_sigmas_come_from_what_stands_beside_the_value():
    rows = pd.DataFrame({"ttc_z_s": [2.0], "ttc_z_lo_s": [1.0], "ttc_z_hi_s": [4.0], "dir_x": [0.0], "cov_xx": [4e-6]})
    assert reported_sigma(rows, "ttc_z_s", None) == pytest.approx((1 - 0.25) / 2 / 1.645, rel=1e-3)
    assert reported_sigma(rows, "dir_x", None) == pytest.approx(2e-3)
    assert np.isnan(reported_sigma(rows, "alpha_rad", None)).all()
    # A 90 % interval of one value ends at 1.645 sigmas; those of tcpa and miss are the borders of a region of both.
    both = pd.DataFrame(
        {"tcpa_s": [2.0], "tcpa_lo_s": [1.0], "tcpa_hi_s": [3.0], "k_frames": [20.0]}
        | {"miss_s": [0.2], "miss_lo_s": [0.1], "miss_hi_s": [0.4]}
    )
    assert reported_sigma(both, "tcpa_s", None) == pytest.approx(1.0 / 2.146, rel=1e-3)
    assert reported_sigma(both, "k_frames", None) == pytest.approx(10.0 / 2.146, rel=1e-3)
    assert reported_sigma(both, "miss_s", None) == pytest.approx(0.15 / 2.146, rel=1e-3)
    epipole = pd.DataFrame(
        {"dir_x": [0.0], "dir_y": [0.0], "dir_z": [-1.0], "cov_xx": [4e-6], "cov_yy": [1e-6], "cov_zz": [0.0]}
    )
    assert reported_sigma(epipole, "x_px", (500.0, 600.0)) == pytest.approx(1.0)
    assert reported_sigma(epipole, "y_px", (500.0, 600.0)) == pytest.approx(0.6)


@pytest.mark.parametrize("off_axis_deg", [0.0, 20.0, 45.0])
def test_the_sigma_of_an_epipole_pixel_is_that_of_draws(off_axis_deg):
    rng, off = np.random.default_rng(3), np.radians(off_axis_deg)
    mean = np.array([0.8 * np.sin(off), 0.6 * np.sin(off), np.cos(off)])
    root = 1e-3 * (np.eye(3) - np.outer(mean, mean)) @ np.diag([1.0, 2.0, 3.0])
    cov = root @ root.T
    drawn = mean + rng.normal(size=(40000, 3)) @ root.T
    epipole = pd.DataFrame(
        {f"dir_{axis}": [mean[k]] for k, axis in enumerate("xyz")}
        | {f"cov_{axis * 2}": [cov[k, k]] for k, axis in enumerate("xyz")}
    )
    for k, axis in enumerate("xy"):
        drawn_px = (500.0, 600.0)[k] * drawn[:, k] / drawn[:, 2]
        assert reported_sigma(epipole, f"{axis}_px", (500.0, 600.0)) == pytest.approx(drawn_px.std(), rel=0.02)


def test_an_interval_without_an_end_gives_no_sigma():
    rows = pd.DataFrame({"tcpa_s": [2.0], "tcpa_lo_s": [1.0], "tcpa_hi_s": [np.nan]})
    assert np.isnan(reported_sigma(rows, "tcpa_s", None)).all()


def test_simple_changes_are_named():
    rng = np.random.default_rng(1)
    before = rng.uniform(1.0, 2.0, 50)
    allowed = np.full(50, 0.01)
    noise = rng.uniform(-0.004, 0.004, 50)
    assert explanation(before, -before + noise, allowed, "") == "the sign is swapped"
    assert explanation(before, before + 3 + noise, allowed, "px").startswith("offset +3")
    assert explanation(before, 1.02 * before + noise, allowed, "").startswith("factor 1.0")
    assert explanation(before, rng.uniform(1.0, 2.0, 50), allowed, "") == ""
    assert explanation(before[:3], -before[:3], allowed[:3], "") == ""


def test_too_many_rows_or_too_large_a_typical_difference_make_a_column_different():
    frame = np.arange(100)
    before = pd.DataFrame({"frame": frame, "n_tracks": 1000.0})
    limits = tolerance_from(
        {"columns": {"frames.n_tracks": {"abs": 10}}, "parts": {"frames": {"max_share": 0.05, "typical": 0.5}}}, ""
    )

    def is_same(now: np.ndarray) -> bool:
        run = before.assign(n_tracks=now)
        rows = JoinedRows("frames", frame, frame * 0.1, np.full(100, ""), before, run)
        (verdict,) = judge_columns(rows, limits, None)
        return verdict.is_same

    few, many = np.full(100, 1000.0), np.full(100, 1000.0)
    few[:5] += 11
    many[:6] += 11
    assert is_same(few)
    assert not is_same(many)
    assert is_same(before.n_tracks.to_numpy() + 5)
    assert not is_same(before.n_tracks.to_numpy() + 6)


def clock(times: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame({"frame": np.arange(len(times)), "t_s": times})


def test_frames_are_joined_by_time_and_the_rest_is_missing_or_additional():
    times = np.arange(10) * DT_S
    joined = join_frames(clock(times), clock(np.delete(times, 4) + 0.001), ({}, {}), FrameTolerance())
    assert joined.missing.tolist() == [4]
    assert joined.additional.tolist() == []
    assert joined.run.tolist() == list(range(9))
    joined = join_frames(clock(times[:5]), clock(times), ({}, {}), FrameTolerance())
    assert joined.additional.tolist() == [5, 6, 7, 8, 9]
    assert join_frames(clock(times[:0]), clock(times), ({}, {}), FrameTolerance()).additional.tolist() == list(
        range(10)
    )
    assert join_frames(clock(times), clock(times[:0]), ({}, {}), FrameTolerance()).missing.tolist() == list(range(10))


@pytest.mark.parametrize("lost", [[0], [1], [25], [58], [59], [20, 40], [20, 21]])
def test_frames_lost_from_a_clip_without_times_are_found_by_their_pictures(lost):
    result = whole_result()
    places = positions_by_frame(result.tables["collision_times"])
    kept = np.delete(np.arange(N_FRAMES), lost)
    now = {k: places[int(frame)] for k, frame in enumerate(kept)}
    joined = join_frames(result.clock, clock(np.arange(len(kept)) * DT_S), (places, now), FrameTolerance())
    assert joined.missing.tolist() == lost
    back = join_frames(clock(np.arange(len(kept)) * DT_S), result.clock, (now, places), FrameTolerance())
    assert back.additional.tolist() == lost


@pytest.mark.parametrize("share_kept", [0.2, 0.5])
def test_a_lost_frame_is_found_where_most_corners_are_others(share_kept):
    """As in a clip that was encoded anew: a part of the corners is there again, to a tenth of a px."""
    rng = np.random.default_rng(3)
    result = whole_result()
    places = positions_by_frame(result.tables["collision_times"])
    kept = np.delete(np.arange(N_FRAMES), 25)
    n_kept = int(share_kept * N_TRACKS)
    now = {
        k: np.concatenate([places[frame][:n_kept] + rng.normal(0, 0.05, (n_kept, 2)), rng.uniform(0, 600, (30, 2))])
        for k, frame in enumerate(kept.tolist())
    }
    joined = join_frames(result.clock, clock(np.arange(len(kept)) * DT_S), (places, now), FrameTolerance())
    assert joined.missing.tolist() == [25]


def test_pictures_that_are_all_alike_are_joined_by_time():
    rng = np.random.default_rng(4)
    place = rng.uniform(0, 600, (30, 2))
    places, now = ({k: place + rng.normal(0, 0.15, place.shape) for k in range(n)} for n in (40, 39))
    joined = join_frames(clock(np.arange(40) * DT_S), clock(np.arange(39) * DT_S), (places, now), FrameTolerance())
    assert (joined.missing.tolist(), joined.is_by_picture) == ([39], False)


def test_tracks_are_joined_by_place_one_to_one():
    before = pd.DataFrame({"frame": [0, 0, 1], "track_id": [1, 2, 1], "x_px": [10.0, 20.0, 10.0], "y_px": 0.0})
    now = pd.DataFrame({"frame": [0, 0, 0, 1], "track_id": [7, 8, 9, 1], "x_px": [20.3, 10.4, 10.2, 30.0], "y_px": 0.0})
    rows, others = join_tracks(before, now, 1.0)
    assert sorted(zip(rows.tolist(), others.tolist(), strict=True)) == [(0, 2), (1, 0)]


def test_a_missing_an_additional_and_a_renamed_object_are_named():
    result = whole_result()
    objects = result.tables["clusters"][result.tables["clusters"].cluster_id > 0].reset_index(drop=True)
    first = objects[objects.cluster_id == 3].reset_index(drop=True)
    joined = join_objects(objects, first, ObjectTolerance())
    (complaint,) = joined.complaints
    assert complaint.startswith("object 7 (frames 40-59, ")
    assert complaint.endswith("is missing")
    (complaint,) = join_objects(first, objects, ObjectTolerance()).complaints
    assert complaint.startswith("object 7 ")
    assert complaint.endswith("is additional")
    renamed = first.assign(cluster_id=np.where(first.frame < 30, 3, 4))
    (complaint,) = join_objects(first, renamed, ObjectTolerance()).complaints
    assert complaint == "object 3 does not keep one number in the run: it is 3 in frames 0-29, 4 in frames 30-59"
    far = objects.assign(ttc_z_s=9.0, ttc_z_lo_s=8.0, ttc_z_hi_s=10.0)
    assert join_objects(far, first, ObjectTolerance(min_tracks=21)).complaints == ()
    assert join_objects(far, first, ObjectTolerance(min_frames=21)).complaints == ()


def test_clusters_of_tracks_are_compared_by_what_their_object_is_in_the_baseline():
    tracks = pd.DataFrame({"frame": [0, 0, 0, 1], "cluster_id": [-1, 0, 5, 5]})
    pairs = pd.DataFrame({"frame": [0], "run_id": [5], "baseline_id": [2]})
    assert baseline_numbers(tracks, pairs).tolist() == [-1, 0, 2, 5 + OTHER_OBJECT]


def events(*rows: tuple[int, float, float]) -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=["cluster_id", "start_s", "end_s"])
    return table.assign(event_id=range(len(rows)), kind="collision_course", start_frame=0, end_frame=1)


def test_warnings_are_joined_by_object_and_time_and_the_rest_is_named():
    pairs = pd.DataFrame({"baseline_id": [1, 2], "run_id": [8, 9]})
    before, now = events((1, 1.0, 3.0), (2, 1.0, 3.0)), events((9, 1.1, 3.0), (8, 1.1, 3.0), (4, 7.0, 8.0))
    first, second, complaints = join_events(before, now, pairs, EventTolerance())
    assert dict(zip(first.tolist(), second.tolist(), strict=True)) == {0: 1, 1: 0}
    (complaint,) = complaints
    assert complaint == "warning collision_course of object 4 (frames 0-1, 7.000-8.000 s) is additional"
    assert join_events(events((1, 1.0, 3.0)), events(), pairs, EventTolerance())[2][0].endswith("is missing")
    assert join_events(events((1, 1.0, 1.1)), events(), pairs, EventTolerance())[2] == ()
    assert join_events(events((1, 1.0, 1.1)), events(), pairs, EventTolerance(min_duration_s=0.05))[2] != ()


def test_the_manual_lists_the_tolerances_as_they_are():
    manual = Path(__file__).parents[2] / "docs/regression.md"
    assert manual.read_text(encoding="utf-8").endswith(f"\n\n{markdown_of_tolerances()}")
