"""What drawn scenes have shown to be wrong, with scenes of the suite."""

import numpy as np
import pandas as pd
import pytest
from scenario_suite.drawing import read_json
from scenario_suite.nuisances import baselines
from scenario_suite.running import Task, do
from scenario_suite.scoring import score


def test_vehicles_that_cross_side_by_side_are_told_apart(tmp_path):
    # Two cars that cross the way of a third begin beside it: all three were one for good, and a fourth joined them.
    task = Task("mast-along", 304, "tracks", tmp_path / "runs", tmp_path / "drawn", baselines("tracks"))
    rows = score(do(task).folder).object_frames.query("is_due")
    assert len(rows) > 20
    assert rows.is_found.mean() > 0.6


@pytest.mark.parametrize("family", ["mast-junction", "mast-walkers"])
def test_what_stands_still_has_tracks_beside_many_objects(tmp_path, family):
    assert share_of_what_stands_still(family, tmp_path) > 0.25


@pytest.mark.data
@pytest.mark.usefixtures("data_dir")
def test_what_stands_still_has_tracks_beside_recorded_objects(tmp_path):
    assert share_of_what_stands_still("KITTI-labels", tmp_path) > 0.25


def share_of_what_stands_still(family, folder):
    """Share of the observations of a drawn table that are on nothing that moves; it is analysed without an error."""
    done = do(Task(family, 0, "tracks", folder / "runs", folder / "drawn", baselines("tracks"))).folder
    assert read_json(done / "run.json")["exit_code"] == 0
    tracks = pd.read_parquet(done / "truth" / "truth_tracks.parquet")
    return np.mean(tracks.object_id == 0)
