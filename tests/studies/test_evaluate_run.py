"""A perfect run is perfect, and each kind of mistake is seen where it belongs."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from perfect_runs import N_FRAMES, perfect_run, two_object_truth

from ttcvid.model import NO_CLUSTER
from ttcvid.studies.evaluation.evaluate import Evaluation, judge_run
from ttcvid.studies.evaluation.metrics import METRICS
from ttcvid.studies.evaluation.truth import RunTables
from ttcvid.studies.evaluation.wording import describe_object

TRUTH = two_object_truth()
RUN = perfect_run(TRUTH)


def metrics_of(run: RunTables, **changes: object) -> dict[str, float | None]:
    return judge_run(run, replace(TRUTH, **changes)).metrics


def with_clusters(clusters: pd.DataFrame) -> RunTables:
    return replace(RUN, clusters=clusters.reset_index(drop=True))


def test_a_perfect_run_has_no_error_and_full_coverage() -> None:
    result: Evaluation = judge_run(RUN, TRUTH)
    metrics = result.metrics
    assert set(metrics) == set(METRICS)
    for name in ("ttc_z", "tcpa", "miss"):
        assert metrics[f"{name}.n"] == 2 * N_FRAMES
        assert [metrics[f"{name}.{key}"] for key in ("median", "p90", "bias")] == [0, 0, 0]
        assert [metrics[f"{name}.{key}"] for key in ("share", "coverage")] == [1, 1]
        assert metrics[f"{name}.half_width"] == pytest.approx(0.01, rel=1e-3)
    for name in ("epipole_scene", "epipole_objects", "rotation"):
        assert metrics[f"{name}.share"] == 1
        assert metrics[f"{name}.p90"] == pytest.approx(0, abs=1e-9)
    assert [metrics[f"objects.{key}"] for key in ("total", "found", "missed", "share")] == [2, 2, 0, 1]
    assert [metrics[f"objects.{key}"] for key in ("one_id", "false", "doubles_per_frame")] == [1, 0, 0]
    assert [metrics[f"tracks.{key}"] for key in ("right", "objects_right", "objects_pure")] == [1, 1, 1]
    assert [metrics[f"events.{key}"] for key in ("expected", "true", "late", "missed", "false")] == [1, 1, 0, 0, 0]
    assert metrics["events.lead_s"] == pytest.approx(2.8)
    assert metrics["events.true_per_10min"] == pytest.approx(300)
    assert metrics["clip.duration_s"] == pytest.approx(2.0)
    assert [judged.warning for judged in result.objects] == ["in_time", "no_collision"]


def test_a_time_of_the_wrong_sign_is_seen() -> None:
    clusters = RUN.clusters.copy()
    clusters[["ttc_z_s", "ttc_z_lo_s", "ttc_z_hi_s"]] *= -1
    metrics = metrics_of(with_clusters(clusters))
    assert (metrics["ttc_z.median"], metrics["ttc_z.bias"]) == (2, -2)
    assert (metrics["ttc_z.wrong_sign"], metrics["ttc_z.coverage"]) == (1, 0)
    assert metrics["tcpa.median"] == 0


def test_a_direction_of_the_wrong_sign_is_seen() -> None:
    epipoles = RUN.epipoles.copy()
    epipoles.loc[epipoles.cluster_id == 0, ["dir_x", "dir_y", "dir_z"]] *= -1
    metrics = metrics_of(replace(RUN, epipoles=epipoles))
    assert metrics["epipole_scene.median"] == pytest.approx(180)
    assert metrics["epipole_objects.median"] == 0


def test_an_object_that_is_not_found_is_missed_and_its_times_count_as_no_value() -> None:
    result = judge_run(with_clusters(RUN.clusters[RUN.clusters.cluster_id != 2]), TRUTH)
    assert [result.metrics[f"objects.{key}"] for key in ("found", "missed", "share")] == [1, 1, 0.5]
    assert result.metrics["ttc_z.share"] == 0.5
    assert result.metrics["ttc_z.median"] == 0
    assert [judged.found_share for judged in result.objects] == [1, 0]


def test_an_object_that_is_never_found_is_said_to_stay_unseen_and_why() -> None:
    tracks = RUN.collision_times.assign(cluster_id=RUN.collision_times.cluster_id.replace(2, 0))
    gone = replace(with_clusters(RUN.clusters[RUN.clusters.cluster_id != 2]), collision_times=tracks)
    found, unseen = judge_run(gone, TRUTH).objects
    assert (
        describe_object(found)
        == "object 1 (object 1): found in 100 % of 20 frames, ttc_z off by 0.0 % (median), warned in time"
    )
    assert describe_object(unseen) == (
        "object 2 (object 2): stayed unseen in all of 20 frames: at most 20 px long, at most 4 tracks on it (6 make an "
        "object), 100 % of their rows taken for the static scene, does not collide"
    )


def test_an_object_without_times_has_no_error_of_them() -> None:
    times = [f"ttc_z{end}_s" for end in ("", "_lo", "_hi")]
    clusters = RUN.clusters.copy()
    clusters.loc[clusters.cluster_id == 2, times] = np.nan
    _, without = judge_run(with_clusters(clusters), TRUTH).objects
    assert (
        describe_object(without) == "object 2 (object 2): found in 100 % of 20 frames, without ttc_z, does not collide"
    )


def test_an_object_found_in_less_than_half_of_its_frames_is_missed() -> None:
    metrics = metrics_of(with_clusters(RUN.clusters[(RUN.clusters.cluster_id == 1) | (RUN.clusters.frame < 9)]))
    assert (metrics["objects.found"], metrics["objects.share"]) == (1, 29 / 40)


def test_an_object_over_nothing_is_false_unless_it_is_said_to_rest() -> None:
    ghost = RUN.clusters[RUN.clusters.cluster_id == 1].assign(cluster_id=9, x0_px=200, x1_px=210)
    moving, at_rest = (pd.concat([RUN.clusters, ghost.assign(motion_id=motion)]) for motion in (9, 0))
    metrics = metrics_of(with_clusters(moving))
    assert (metrics["objects.false"], metrics["objects.false_per_frame"]) == (1, 1)
    assert metrics_of(with_clusters(at_rest))["objects.false"] == 0
    assert metrics_of(with_clusters(moving), has_all_objects=False)["objects.false"] is None


def test_a_second_piece_of_an_object_is_a_double_and_not_false() -> None:
    piece = RUN.clusters[RUN.clusters.cluster_id == 2].assign(cluster_id=9, x1_px=54.0)
    metrics = metrics_of(with_clusters(pd.concat([RUN.clusters, piece])))
    assert (metrics["objects.doubles_per_frame"], metrics["objects.false"], metrics["objects.found"]) == (1, 0, 2)


def test_what_is_hardly_seen_is_neither_missed_nor_false() -> None:
    assert TRUTH.objects is not None
    objects = TRUTH.objects.assign(is_counted=TRUTH.objects.object_id == 1)
    found, lost = metrics_of(RUN, objects=objects), metrics_of(with_clusters(RUN.clusters[:N_FRAMES]), objects=objects)
    for metrics in (found, lost):
        assert [metrics[f"objects.{key}"] for key in ("total", "missed", "false")] == [1, 0, 0]
        assert metrics["ttc_z.n"] == N_FRAMES


def test_a_number_that_changes_on_the_way_is_seen() -> None:
    clusters = RUN.clusters.copy()
    clusters.loc[(clusters.cluster_id == 2) & (clusters.frame >= 15), "cluster_id"] = 3
    metrics = metrics_of(with_clusters(clusters))
    assert (metrics["objects.one_id"], metrics["objects.found"]) == (35 / 40, 2)


def test_two_objects_that_swap_their_numbers_half_way_agree_with_the_first_half_only() -> None:
    clusters = RUN.clusters.copy()
    late = clusters.frame >= 12
    clusters.loc[late, "cluster_id"] = 3 - clusters.loc[late, "cluster_id"]
    assert metrics_of(with_clusters(clusters))["objects.one_id"] == 0.6


@pytest.mark.parametrize(
    ("start_s", "verdict", "counts"),
    [(0.2, "in_time", [1, 0, 0]), (1.9, "in_time", [1, 0, 0]), (2.1, "late", [0, 1, 0]), (None, "missed", [0, 0, 1])],
)
def test_a_warning_is_in_time_late_or_missed(start_s: float | None, verdict: str, counts: list[int]) -> None:
    events = RUN.events[:0] if start_s is None else RUN.events.assign(start_s=start_s)
    result = judge_run(replace(RUN, events=events), TRUTH)
    assert [result.metrics[f"events.{key}"] for key in ("true", "late", "missed")] == counts
    assert result.objects[0].warning == verdict
    assert result.metrics["events.false"] == 0


@pytest.mark.parametrize(
    ("start_s", "n_ahead", "lead_s"), [(0.9, 1, 2.1), (1.1, 0, 1.9), (2.5, 0, 0.5), (None, 0, None)]
)
def test_the_time_from_the_warning_to_the_contact_is_told_of_each_object(start_s, n_ahead, lead_s) -> None:
    events = RUN.events[:0] if start_s is None else RUN.events.assign(start_s=start_s)
    result = judge_run(replace(RUN, events=events), TRUTH)
    assert result.metrics["events.ahead"] == n_ahead
    expected = None if lead_s is None else pytest.approx(lead_s)
    assert [judged.lead_s for judged in result.objects] == [expected, None]
    assert result.metrics["events.lead_p10_s"] == expected


def test_errors_of_own_motion_and_false_rows_are_told_frame_by_frame() -> None:
    ghost = RUN.clusters[RUN.clusters.frame == 7].assign(cluster_id=9, x0_px=200, x1_px=210)[:1]
    epipoles = RUN.epipoles.copy()
    epipoles.loc[(epipoles.cluster_id == 0) & (epipoles.frame == 3), ["dir_x", "dir_y", "dir_z"]] *= -1
    clusters = pd.concat([RUN.clusters, ghost]).reset_index(drop=True)
    by_frame = judge_run(replace(RUN, clusters=clusters, epipoles=epipoles), TRUTH).by_frame.set_index("frame")
    assert by_frame.n_false.to_dict() == {frame: int(frame == 7) for frame in range(N_FRAMES)}
    assert by_frame.epipole_deg[3] == pytest.approx(180)
    assert by_frame.epipole_deg.drop(3)[1:].max() == pytest.approx(0, abs=1e-9)
    assert by_frame.is_epipole_judged.tolist() == [False] + [True] * (N_FRAMES - 1)
    assert by_frame.rotation_deg[1:].max() == pytest.approx(0, abs=1e-9)


def test_displaced_observations_that_a_body_takes_in_are_counted() -> None:
    rows = RUN.collision_times[["frame", "track_id"]].copy()
    # Of track 2, on object 1, every second observation is displaced, and of these the first five are in no body.
    rows["is_outlier"] = (rows.track_id == 2) & (rows.frame % 2 == 0)
    no_times = {f"{name}{end}_s": np.nan for name in ("ttc_z", "tcpa", "miss") for end in ("", "_lo", "_hi")}
    points = rows.assign(**no_times)
    is_free = rows.is_outlier & (rows.frame < 10)
    tracks = RUN.collision_times.assign(
        **no_times, cluster_id=RUN.collision_times.cluster_id.where(~is_free, NO_CLUSTER)
    )
    metrics = metrics_of(replace(RUN, collision_times=tracks), track_points=points)
    assert metrics["tracks.outliers_in"] == pytest.approx(0.5)
    # They lie on nothing: whether such a row is in a cluster is told by this figure alone.
    assert metrics["tracks.right"] == 1


def test_a_warning_of_what_does_not_collide_is_false() -> None:
    metrics = metrics_of(replace(RUN, events=RUN.events.assign(cluster_id=2)))
    assert [metrics[f"events.{key}"] for key in ("true", "missed", "false")] == [0, 1, 1]
    assert metrics["events.false_per_10min"] == pytest.approx(300)


def test_a_warning_of_something_over_nothing_is_false() -> None:
    ghost = RUN.clusters[RUN.clusters.cluster_id == 1].assign(cluster_id=9, x0_px=200, x1_px=210)
    events = RUN.events.assign(cluster_id=9)
    metrics = metrics_of(replace(with_clusters(pd.concat([RUN.clusters, ghost])), events=events))
    assert [metrics[f"events.{key}"] for key in ("missed", "false")] == [1, 1]


def test_a_collision_long_after_the_clip_is_not_expected_and_its_warning_not_false() -> None:
    assert TRUTH.encounters is not None
    encounters = TRUTH.encounters.assign(t_contact_s=[4.5, np.nan])
    result = judge_run(RUN, replace(TRUTH, encounters=encounters))
    assert [result.metrics[f"events.{key}"] for key in ("expected", "missed", "false")] == [0, 0, 0]
    assert result.objects[0].warning == "not_expected"


def test_frames_that_were_not_analysed_do_not_count() -> None:
    names = ("frames", "clusters", "epipoles")
    tables = {name: getattr(RUN, name)[getattr(RUN, name).frame % 2 == 1].reset_index(drop=True) for name in names}
    tables["frames"] = tables["frames"].assign(rot_y_rad=0.02)
    tables["epipoles"] = tables["epipoles"][tables["epipoles"].frame > 1]
    metrics = metrics_of(replace(RUN, **tables), track_object=None)
    assert metrics["objects.share"] == 1
    assert metrics["rotation.p90"] == pytest.approx(0, abs=1e-9)
    assert metrics["rotation.n"] == metrics["epipole_scene.n"] == 9
    assert metrics["epipole_scene.share"] == 1


def test_what_the_truth_does_not_tell_is_null() -> None:
    metrics = metrics_of(RUN, frames=None, encounters=None, track_object=None)
    assert metrics["ttc_z.median"] == 0
    for name in ("rotation.median", "epipole_scene.median", "events.true", "tracks.right"):
        assert metrics[name] is None


def test_a_run_without_objects_and_a_truth_without_objects_can_be_evaluated() -> None:
    assert TRUTH.objects is not None
    nothing_found = metrics_of(with_clusters(RUN.clusters[:0]))
    assert (nothing_found["objects.missed"], nothing_found["ttc_z.median"], nothing_found["ttc_z.share"]) == (
        2,
        None,
        0,
    )
    nothing_there = metrics_of(RUN, objects=TRUTH.objects[:0])
    assert (nothing_there["objects.total"], nothing_there["objects.false"]) == (0, 2)
    assert nothing_there["events.false"] == 1
