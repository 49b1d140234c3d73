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


@pytest.mark.parametrize("family", ["mast-junction", "mast-walkers", "KITTI-labels"])
def test_what_stands_still_has_tracks_beside_many_objects(tmp_path, family):
    folder = do(Task(family, 0, "tracks", tmp_path / "runs", tmp_path / "drawn", baselines("tracks"))).folder
    assert read_json(folder / "run.json")["exit_code"] == 0
    tracks = pd.read_parquet(folder / "truth" / "truth_tracks.parquet")
    assert np.mean(tracks.object_id == 0) > 0.25
