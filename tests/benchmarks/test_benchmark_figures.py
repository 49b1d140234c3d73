"""What the benchmarks make of their measurements."""

import math

import numpy as np
import pandas as pd
import pytest
from clustering_error import NOWHERE, clustering_error, label_of_tracks
from epipole import angles_deg, median_and_p90
from equations import EQUATIONS, MOTIONS, Points, equation_3, largest_error
from memory import resident_at
from report import Bar, Report
from stage_times import GEOMETRY, PIPELINE_MODULES, PIPELINE_STAGES, STAGES


def test_a_bar_is_missed_by_a_figure_that_is_not_there():
    assert Bar(3.0).is_kept_by(3.0)
    assert not Bar(3.0).is_kept_by(3.1)
    assert Bar(1.5, at_least=True).is_kept_by(1.5)
    assert not Bar(1.5, at_least=True).is_kept_by(1.4)
    assert Bar(80.0, True, 97.0).is_kept_by(97.0)
    assert not Bar(80.0, True, 97.0).is_kept_by(98.0)
    assert not Bar(3.0).is_kept_by(math.nan)
    assert not Bar(3.0, at_least=True).is_kept_by(math.nan)


def test_a_missed_bar_is_exit_code_1_only_when_asked_for(capsys):
    report = Report()
    report.figure("epipole", 2.0, "px", Bar(3.0))
    assert report.exit_code(check=True) == 0
    report.figure("rotation", 2.0, "deg", Bar(1.0))
    assert (report.exit_code(check=True), report.exit_code(check=False)) == (1, 0)
    assert "MISSED" in capsys.readouterr().out


def test_frames_without_an_epipole_count_as_infinite_errors():
    errors = np.array([1.0, -2.0, 3.0, np.nan, np.nan, np.nan])
    assert median_and_p90(errors)[1] == math.inf
    assert median_and_p90(np.array([-1.0, 2.0, 3.0])) == (2.0, 3.0)


def test_small_angles_keep_their_digits():
    one = np.array([[0.0, 0.0, 1.0]])
    other = np.array([[np.sin(1e-9), 0.0, np.cos(1e-9)]])
    assert angles_deg(one, other) == pytest.approx(np.degrees(1e-9), rel=1e-12)


def test_clusters_are_matched_one_to_one_to_groups():
    truth = np.array([1, 1, 1, 1, 2, 2])
    assert clustering_error(truth, np.array([0, 0, 0, 0, 7, 7])) == 0.0
    assert clustering_error(truth, np.zeros(6, int)) == pytest.approx(2 / 6)
    assert clustering_error(truth, np.array([0, 0, 3, 3, 7, 7])) == pytest.approx(2 / 6)


def test_tracks_of_no_cluster_are_errors():
    truth = np.array([1, 1, 2, 2])
    assert clustering_error(truth, np.array([0, 0, NOWHERE, NOWHERE])) == 0.5
    assert clustering_error(truth, np.full(4, NOWHERE)) == 1.0


def test_the_label_of_a_track_is_its_most_frequent_cluster():
    rows = pd.DataFrame(
        {
            "track_id": [1, 1, 1, 2, 2, 3],
            "cluster_id": pd.array([0, 4, 4, 5, None, None], dtype="Int32"),
        }
    )
    assert label_of_tracks(rows).to_dict() == {1: 4, 2: 5, 3: NOWHERE}


def test_memory_at_a_frame_is_the_median_up_to_it():
    readings = [100.0] * 60 + [900.0] * 10
    assert resident_at(readings, 60) == 100.0
    assert resident_at([1.0, 2.0, 3.0], 3) == 2.0


@pytest.mark.parametrize("equation", EQUATIONS[1:7])  # the first and the last look at the present view alone
def test_an_equation_that_is_off_by_a_millionth_is_seen(equation, monkeypatch):
    points = MOTIONS["planar"](np.random.default_rng(5), 60)
    assert equation(points) < 1e-9
    rays = Points.rays
    monkeypatch.setattr(Points, "rays", lambda self, t_s: np.add(rays(self, t_s), (0.0, 1e-6 * (t_s < 0), 0.0)))
    assert equation(points) > 1e-9


def test_a_missing_value_is_an_infinite_error():
    assert largest_error(np.array([1.0, np.nan]), np.ones(2)) == math.inf


def test_the_planar_equation_is_not_asked_about_other_motion():
    points = MOTIONS["general"](np.random.default_rng(0), 50)
    assert equation_3(points) > 1e-3


def test_the_stages_that_are_timed_are_those_of_the_pipeline():
    for name in PIPELINE_STAGES:
        assert [callable(getattr(module, name, None)) for module in PIPELINE_MODULES].count(True) == 1, name
    assert set(PIPELINE_STAGES.values()) | set(GEOMETRY) <= set(STAGES)
