"""The parts of an evaluation, each on a case worked out by hand."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ttcvid.errors import UsageError
from ttcvid.geometry.rotation import rotation_from_vector
from ttcvid.studies.evaluation.directions import (
    angle_deg,
    judge_directions,
    rotation_errors_deg,
    summary_of,
    true_scene_directions,
)
from ttcvid.studies.evaluation.grouping import judge_grouping
from ttcvid.studies.evaluation.matching import best_one_to_one, count_tracks, intersection_over_union, match_objects
from ttcvid.studies.evaluation.metrics import METRICS, check_from_text, markdown_of_metrics
from ttcvid.studies.evaluation.times import is_within, judge_times, relative_half_width
from ttcvid.studies.evaluation.truth import (
    SKY_LABEL,
    UNKNOWN_OBJECT,
    object_at,
    objects_from_tracks,
    plain,
    with_counted,
)
from ttcvid.studies.evaluation.wording import describe_value

NAN = np.nan


def times(name: str, value: list[float], lo: list[float] | None = None, hi: list[float] | None = None) -> pd.DataFrame:
    return pd.DataFrame({f"{name}_s": value, f"{name}_lo_s": lo or value, f"{name}_hi_s": hi or value})


def judged(name: str, truth: list[float], found: pd.DataFrame) -> dict[str, float]:
    return judge_times(name, np.array(truth), found, np.ones(len(truth), bool))


def test_errors_of_times_are_errors_of_one_over_time() -> None:
    numbers = judged("ttc_z", [2.0, 2.0, 2.0, 2.0], times("ttc_z", [1.6, 2.5, 2.0, NAN]))
    assert (numbers["n"], numbers["share"]) == (3, 0.75)
    assert numbers["median"] == pytest.approx(0.2)
    assert numbers["p90"] == pytest.approx(0.25)
    assert numbers["bias"] == 0


def test_true_times_that_are_over_or_far_away_are_not_judged() -> None:
    numbers = judged("tcpa", [0.05, 25.0, -5.0, NAN], times("tcpa", [1.0, 1.0, -4.0, 1.0]))
    assert (numbers["n"], numbers["share"], numbers["bias"], numbers["wrong_sign"]) == (1, 1, 0.25, 0)


def test_the_miss_distance_of_a_hit_has_an_absolute_error_only() -> None:
    numbers = judged("miss", [0.0, 1.0], times("miss", [0.3, 1.1]))
    assert numbers["n"] == 1
    assert numbers["abs_median_s"] == pytest.approx(0.2)
    assert "wrong_sign" not in numbers


def test_an_interval_of_ttc_z_with_lo_over_hi_runs_through_infinity() -> None:
    lo, hi = np.array([4.0] * 4), np.array([-10.0] * 4)
    assert is_within("ttc_z", np.array([5.0, 3.9, -20.0, -9.0]), lo, hi).tolist() == [True, False, True, False]
    assert relative_half_width("ttc_z", np.array([8.0]), lo[:1], hi[:1])[0] == pytest.approx(8 * (0.25 + 0.1) / 2)


def test_an_interval_counts_whether_or_not_its_value_is_told() -> None:
    numbers = judged(
        "ttc_z",
        [5.0, 3.9, 2.0, 2.0],
        times("ttc_z", [NAN, NAN, 2.0, NAN], [4.0, 4.0, 1.9, NAN], [-10.0, -10.0, 2.1, NAN]),
    )
    assert (numbers["n"], numbers["share"]) == (1, 0.25)
    assert numbers["coverage"] == pytest.approx(2 / 3)


def test_an_end_that_is_null_is_unbounded() -> None:
    lo, hi = np.array([2.0, NAN]), np.array([NAN, 3.0])
    assert is_within("miss", np.array([99.0, 3.1]), lo, hi).tolist() == [True, False]
    assert relative_half_width("miss", np.array([2.0, 2.0]), lo, hi).tolist() == [np.inf, np.inf]


def test_a_miss_distance_of_zero_is_a_value_without_relative_numbers() -> None:
    numbers = judged("miss", [1.0], times("miss", [0.0], [0.0], [2.0]))
    assert (numbers["n"], numbers["abs_median_s"], numbers["coverage"]) == (1, 1, 1)
    assert numbers["median"] == numbers["half_width"] == np.inf
    assert describe_value("miss.median", 10.1) == "over 1000 %"


def test_coverage_is_the_share_of_intervals_that_hold_the_truth() -> None:
    numbers = judged("tcpa", [2.0, 2.0, 2.0, 2.0], times("tcpa", [2.0] * 4, [1.9, 2.1, 1.0, 1.5], [2.1, 2.2, 1.9, 2.0]))
    assert numbers["coverage"] == 0.5


@given(st.floats(0.2, 19), st.floats(0.2, 19), st.floats(0.5, 1.0))
def test_scaling_all_times_changes_no_relative_number(true_s: float, value_s: float, scale: float) -> None:
    found = times("ttc_z", [value_s], [value_s * 0.9], [value_s * 1.1])
    one, other = judged("ttc_z", [true_s], found), judged("ttc_z", [true_s * scale], found * scale)
    assert one == pytest.approx(other)


def test_angles_between_directions() -> None:
    x, z = np.array([[1.0, 0, 0]]), np.array([[0.0, 0, 1]])
    tilted = np.array([[np.sin(1e-6), 0, np.cos(1e-6)]])
    assert angle_deg(z, tilted)[0] == pytest.approx(np.degrees(1e-6), rel=1e-6)
    numbers = judge_directions(np.vstack([x, x, NAN * x]), np.vstack([z, NAN * z, z]), np.ones(3, bool))
    assert (numbers["n"], numbers["share"], numbers["median"]) == (1, 0.5, 90)


def rotations(*vectors: list[float]) -> pd.DataFrame:
    table = pd.DataFrame(vectors, columns=["rot_x_rad", "rot_y_rad", "rot_z_rad"])
    return table.assign(frame=range(len(table)))


def test_the_error_of_a_rotation_is_the_angle_of_the_difference() -> None:
    truth = rotations([NAN] * 3, [0.0, 0.1, 0.0], [0.0, 0.1, 0.0])
    found = rotations([NAN] * 3, [0.0, 0.1, 0.02], [NAN] * 3)
    numbers = summary_of(rotation_errors_deg(truth, found).rotation_deg.to_numpy(float))
    left_over = rotation_from_vector(np.array([0.0, 0.1, 0.02])) @ rotation_from_vector(np.array([0.0, -0.1, 0.0]))
    assert numbers["median"] == pytest.approx(np.degrees(np.arccos((np.trace(left_over) - 1) / 2)), rel=1e-6)
    assert numbers["share"] == 0.5


def ways(*rows: tuple[float, float, float]) -> pd.DataFrame:
    """A camera that yaws by ``yaw`` and moves by ``right, ahead`` from picture to picture, 0.1 s apart."""
    yaw, right, ahead = np.array(rows).T
    table = rotations(*np.column_stack([0 * yaw, yaw, 0 * yaw]).tolist()).assign(t_s=0.1 * np.arange(len(yaw)))
    way = np.column_stack([right, 0 * right, ahead])
    table[["vx_m_s", "vy_m_s", "vz_m_s"]] = way / 0.1
    with np.errstate(invalid="ignore"):
        table[["dir_x", "dir_y", "dir_z"]] = -way / np.linalg.norm(way, axis=1)[:, None]
    table.loc[0, table.columns.difference(["frame", "t_s"])] = NAN
    return table


def test_where_pictures_are_left_out_the_true_direction_is_that_of_the_way_between_those_that_are_not() -> None:
    truth = ways((0, 0, 0), (0, 0, 1), (0, 3, 0), (0, 0, 0), (0, 0, 0), (np.pi / 2, 0, 1), (0, 0, 1))
    every = true_scene_directions(truth, truth.frame.to_numpy())
    assert every.frame.tolist() == [1, 2, 3, 4, 5, 6]
    np.testing.assert_allclose(every[["dir_x", "dir_y", "dir_z"]], truth.loc[1:, ["dir_x", "dir_y", "dir_z"]])
    second = true_scene_directions(truth, np.array([0, 2, 4, 6]))
    assert second.frame.tolist() == [2, 4, 6]
    # 1 ahead and 3 to the right; a rest; 1 ahead, seen as it is after the turn, and 1 ahead
    np.testing.assert_allclose(second.loc[0, ["dir_x", "dir_z"]].to_numpy(float), np.array([-3, -1]) / np.sqrt(10))
    assert second.loc[1, ["dir_x", "dir_y", "dir_z"]].isna().all()
    np.testing.assert_allclose(second.loc[2, ["dir_x", "dir_y", "dir_z"]].to_numpy(float), [0, 0, -1], atol=1e-12)
    turned = true_scene_directions(truth, np.array([0, 2, 5]))
    np.testing.assert_allclose(turned.loc[1, ["dir_x", "dir_y", "dir_z"]].to_numpy(float), [0, 0, -1], atol=1e-12)
    whole = true_scene_directions(truth, np.array([1, 5]))
    # before the turn by 90 deg: 3 to the right; a camera that turns the scene from x to -z then goes 1 ahead
    np.testing.assert_allclose(whole.loc[0, ["dir_x", "dir_z"]].to_numpy(float), np.array([0, 3 - 1]) / 2, atol=1e-12)


def test_without_own_velocity_the_pictures_left_out_count_by_their_time() -> None:
    truth = ways((0, 0, 0), (0, 0, 1), (0, 1, 0)).drop(columns=["vx_m_s", "vy_m_s", "vz_m_s"])
    true = true_scene_directions(truth, np.array([0, 2]))
    np.testing.assert_allclose(true.loc[0, ["dir_x", "dir_z"]].to_numpy(float), -np.sqrt([0.5, 0.5]))


def test_where_the_truth_leaves_pictures_out_what_lies_on_the_way_is_not_judged() -> None:
    full = ways((0, 0, 0), (0.1, 0, 1), (0.1, 0, 1), (0.1, 3, 0), (0.1, 3, 0), (0.1, 0, 1), (0.1, 0, 1))
    run = rotations(*[[0.0, 0.2, 0.0]] * 4).assign(frame=[0, 2, 4, 6])
    for missing in (3, 4):
        truth = full[full.frame != missing].reset_index(drop=True)
        true = true_scene_directions(truth, run.frame.to_numpy())
        every = true_scene_directions(full, run.frame.to_numpy())
        assert every.frame.tolist() == [2, 4, 6]
        pd.testing.assert_frame_equal(true, every.drop(index=1).reset_index(drop=True))
        numbers = summary_of(rotation_errors_deg(truth, run).rotation_deg.to_numpy(float))
        assert (numbers["n"], numbers["share"]) == (2, 1.0)
        assert numbers["p90"] == pytest.approx(0.0, abs=1e-6)


def test_a_truth_without_rows_judges_no_motion_of_the_camera() -> None:
    truth, run = ways((0, 0, 0)).iloc[:0], rotations(*[[0.0, 0.2, 0.0]] * 3)
    assert summary_of(rotation_errors_deg(truth, run).rotation_deg.to_numpy(float))["n"] == 0
    assert true_scene_directions(truth, run.frame.to_numpy()).empty


BOX = {"x0_px": 0.0, "y0_px": 0.0, "x1_px": 10.0, "y1_px": 10.0}


def boxes(name: str, *x: tuple[int, float, float]) -> pd.DataFrame:
    rows = [{**BOX, "frame": 0, name: number, "x0_px": x0, "x1_px": x1, "motion_id": 1} for number, x0, x1 in x]
    return pd.DataFrame(rows)


def test_matching_is_one_to_one_and_takes_the_largest_sum_of_overlaps() -> None:
    truth = boxes("object_id", (1, 0, 10), (2, 5, 15))
    found = boxes("cluster_id", (7, 4, 14), (8, 6, 16))
    pairs = match_objects(truth, found).pairs
    # 7 overlaps 2 most (9/11), but 1 with 7 (6/14) and 2 with 8 (9/11) is more than 2 with 7 and 1 with 8 (4/16 < 0.3).
    assert list(zip(pairs.object_id, pairs.cluster_id, strict=True)) == [(1, 7), (2, 8)]


def test_an_overlap_of_less_than_three_tenths_is_no_match() -> None:
    matches = match_objects(boxes("object_id", (1, 0, 10)), boxes("cluster_id", (7, 6, 16)))
    assert matches.pairs.empty
    assert list(matches.verdict) == ["false"]


def test_a_cluster_whose_tracks_lie_on_the_object_matches_it_whatever_its_box() -> None:
    truth, found = boxes("object_id", (1, 0, 10)), boxes("cluster_id", (7, 0, 2))
    assert match_objects(truth, found).pairs.empty
    cluster_id, track_object = np.array([7, 7, 7, 0, 7]), np.array([1, 1, 1, 1, UNKNOWN_OBJECT])
    on_tracks = count_tracks(np.zeros(5, int), cluster_id, track_object)
    assert list(match_objects(truth, found, on_tracks).pairs.cluster_id) == [7]


def test_the_box_of_a_single_track_is_the_same_as_itself_and_as_no_other() -> None:
    point = np.array([[3.0, 4.0, 3.0, 4.0]])
    assert intersection_over_union(point, point) == 1.0
    assert intersection_over_union(point, point + 1.0) == 0.0


@given(st.lists(st.floats(-50, 50), min_size=8, max_size=8))
def test_intersection_over_union_is_symmetric_and_at_most_one(sides: list[float]) -> None:
    corners = np.split(np.array(sides), 2)
    first, second = (np.array([np.r_[np.minimum(v[:2], v[2:]), np.maximum(v[:2], v[2:])]]) for v in corners)
    overlap = intersection_over_union(first, second)
    assert overlap == intersection_over_union(second, first)
    assert 0 <= overlap[0] <= 1 + 1e-12


def test_assignment_follows_the_rows_and_leaves_out_what_never_met() -> None:
    assert best_one_to_one(np.array([1, 1, 2]), np.array([5, 5, 5])) == {1: 5}
    assert best_one_to_one(np.array([]), np.array([])) == {}


def test_tracks_are_right_in_the_group_of_their_object() -> None:
    #                      scene      object 1      object 2   unknown
    objects = np.array([0, 0, 0, 0, 1, 1, 1, 1, 2, 2, UNKNOWN_OBJECT])
    clusters = np.array([0, 0, 5, -1, 5, 5, 5, 0, 6, 5, 3])
    numbers = judge_grouping(objects, clusters)
    assert numbers["n"] == 10
    assert numbers["right"] == pytest.approx(6 / 10)
    assert numbers["objects_right"] == pytest.approx(4 / 6)
    assert numbers["objects_pure"] == pytest.approx(4 / 6)
    assert numbers["unassigned"] == pytest.approx(1 / 10)


def test_labels_tell_the_object_at_a_pixel_but_not_on_outlines() -> None:
    labels = np.zeros((6, 9), np.uint16)
    labels[:3], labels[:, 5:] = SKY_LABEL, 4
    places = np.array([[1.2, 4.4], [1.0, 2.0], [7.0, 3.0], [4.6, 3.0], [9.0, 1.0], [-1.0, 1.0], [8.0, 5.0]])
    assert object_at(labels, places).tolist() == [0, 0, 4, UNKNOWN_OBJECT, UNKNOWN_OBJECT, UNKNOWN_OBJECT, 4]


def test_an_object_counts_where_enough_of_it_is_seen() -> None:
    objects = pd.DataFrame({"visible_px": [99.0, 100.0, 5000.0], "visible_fraction": [1.0, 0.25, 0.2]})
    assert with_counted(objects).is_counted.tolist() == [False, True, False]
    assert with_counted(objects[[]]).is_counted.all()


def test_an_object_of_tracks_has_the_times_of_its_nearest_points() -> None:
    # Ten points 10 m away and one 20 m away, coming at 2 m/s.
    depth = np.array([10.0] * 10 + [20.0])
    x = np.linspace(-1, 1, 11)
    points = pd.DataFrame({"frame": 0, "track_id": range(11), "object_id": 3, "x_true_px": 100 + x, "y_true_px": 50.0})
    points = points.assign(x_m=0.0, y_m=0.0, z_m=depth, vx_m_s=0.0, vy_m_s=0.0, vz_m_s=-2.0)
    frames = pd.DataFrame({"frame": [0], "t_s": [0.5]})
    row = objects_from_tracks(points, frames, {3: "van"}).iloc[0]
    assert (row.object_id, row["name"], row.t_s, row.is_counted) == (3, "van", 0.5, True)
    assert (row.x0_px, row.x1_px) == (99, 101)
    assert row.ttc_z_s == pytest.approx(5.0, rel=0.02)
    assert (row.miss_s, row.dir_z) == (0, -1)
    assert (row.x_m, row.y_m, row.z_m) == (0, 0, pytest.approx(10.0))
    assert (row.vx_m_s, row.vy_m_s, row.vz_m_s) == (0, 0, -2)
    assert not objects_from_tracks(points[:2], frames, {}).is_counted.any()


def test_tables_of_a_run_become_plain() -> None:
    table = pa.table(
        {
            "cluster_id": pa.array([1, None], pa.int32()),
            "t_s": pa.array([0.5, None]),
            "status": pa.array(["ok", "cut"]).dictionary_encode(),
            "urgency_rank": pa.array([1, None], pa.int32()),
            "frame": pa.array([1, 2], pa.int32()),
        }
    )
    result = plain(table)
    assert result.cluster_id.tolist() == [1, -1]
    assert result.frame.dtype == np.int64
    assert np.isnan(result.t_s[1])
    assert np.isnan(result.urgency_rank[1])
    assert (result.status == "ok").tolist() == [True, False]


@pytest.mark.parametrize(
    ("text", "value", "fails"),
    [
        ("ttc_z.median>0.05", 0.06, True),
        ("ttc_z.median>0.05", 0.05, False),
        ("ttc_z.coverage < .8", 0.79, True),
        ("objects.false>=1", 1, True),
        ("objects.false != 0", 0, False),
        ("ttc_z.bias<-1e-2", -0.02, True),
        ("ttc_z.median>0.05", None, True),
    ],
)
def test_a_check_says_what_is_wrong(text: str, value: float | None, fails: bool) -> None:
    check = check_from_text(text)
    complaint = check.complaint(dict.fromkeys(METRICS) | {check.metric: value})
    assert (complaint is not None) == fails
    if complaint:
        assert complaint.startswith(check.metric)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("ttc_z.median", "expected a metric, a sign"),
        ("ttcz.median>0.05", "did you mean 'ttc_z.median'?"),
        ("ttc_z.median>abc", "'abc' is no finite number"),
        ("ttc_z.median>nan", "'nan' is no finite number"),
        ("", "expected a metric"),
    ],
)
def test_a_condition_that_cannot_be_read_is_refused_in_one_line(text: str, says: str) -> None:
    with pytest.raises(UsageError, match=r"^--fail-on") as refused:
        check_from_text(text)
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_manual_lists_every_metric_as_it_is_defined() -> None:
    manual = Path(__file__).parents[2] / "docs/evaluation.md"
    assert manual.read_text(encoding="utf-8").endswith(f"\n{markdown_of_metrics()}")
