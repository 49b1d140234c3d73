"""Baselines in files: what they keep, and how they are read again."""

import numpy as np
import pandas as pd
import pytest
from made_results import FACTS, different, filled, whole_result

from ttcvid.errors import NotComparableError
from ttcvid.jobs.compare.baseline import baseline_text, read_baseline, write_baseline
from ttcvid.schema import TABLES
from ttcvid.studies.compare.results import Results
from ttcvid.studies.compare.thinned import N_FRAMES as N_KEPT
from ttcvid.studies.compare.thinned import N_TRACKS as N_TRACKS_KEPT
from ttcvid.studies.compare.thinned import thinned
from ttcvid.studies.compare.tolerance import (
    ObjectTolerance,
)


def test_a_baseline_keeps_few_rows_and_is_read_as_it_was_written(tmp_path):
    result = whole_result()
    kept = thinned(result, ObjectTolerance())
    assert len(kept.tables["frames"]) == N_KEPT
    assert kept.tables["collision_times"].groupby("frame").size().max() == N_TRACKS_KEPT
    path = tmp_path / "baseline.yaml"
    write_baseline(path, baseline_text(kept))
    read = read_baseline(path)
    assert read.facts == FACTS
    np.testing.assert_allclose(read.clock.t_s, result.clock.t_s, atol=1e-6)
    assert read.clock.frame.tolist() == result.clock.frame.tolist()
    assert baseline_text(read) == path.read_text()
    assert different(read, result) == ([], [])


def test_a_track_of_an_object_that_is_too_small_to_count_is_known_again(tmp_path):
    result = whole_result()
    clusters, tracks = result.tables["clusters"], result.tables["collision_times"]
    small = clusters.n_tracks.where(clusters.cluster_id != 3, 2)
    result.tables["clusters"]["n_tracks"], result.tables["epipoles"]["n_tracks"] = small, small
    tracks["cluster_id"] = np.where(tracks.cluster_id == 0, 3, 0)
    kept = thinned(result, ObjectTolerance())
    assert set(kept.tables["clusters"].cluster_id) == {3, 7}
    path = tmp_path / "baseline.yaml"
    write_baseline(path, baseline_text(kept))
    assert different(read_baseline(path), result) == ([], [])


def test_a_baseline_that_is_cut_off_anywhere_is_refused(tmp_path):
    text = baseline_text(thinned(whole_result(), ObjectTolerance()))
    ends_of_rows = [place + 1 for place, letter in enumerate(text) if letter == "\n"]
    path = tmp_path / "baseline.yaml"
    reasons = r"is not whole|cannot be read as a baseline|is no baseline|schema"
    for length in [0, *range(1, len(text), len(text) // 25), *ends_of_rows[5:-1:12], ends_of_rows[-2], len(text) - 1]:
        path.write_text(text[:length])
        with pytest.raises(NotComparableError, match=reasons):
            read_baseline(path)


@pytest.mark.parametrize(
    "times", [np.arange(40) / 30, np.round(np.arange(40) / 30, 3), np.arange(40) ** 1.2 / 30 + 5, np.zeros(1)]
)
def test_a_baseline_keeps_the_times_of_all_frames(tmp_path, times):
    numbers = np.arange(len(times)) * 2 + 5
    frames = filled("frames", pd.DataFrame({"frame": numbers, "t_s": times}), np.random.default_rng(0))
    tables = {name: filled(name, pd.DataFrame(index=[]), np.random.default_rng(0)) for name in TABLES}
    path = tmp_path / "baseline.yaml"
    kept = thinned(Results("one", {**tables, "frames": frames}, {}, frames), ObjectTolerance())
    write_baseline(path, baseline_text(kept))
    read = read_baseline(path).clock
    assert read.frame.tolist() == numbers.tolist()
    step_s = np.median(np.diff(times)) if len(times) > 1 else 1.0
    assert np.abs(read.t_s - times).max() < 0.06 * step_s
