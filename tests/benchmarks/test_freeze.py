"""A freeze finds what a change changed, and passes over rounding."""

import pandas as pd
import pytest
from freeze import difference_of


def table(**columns):
    rows = {
        "frame": [0, 0, 1],
        "track_id": [1, 2, 1],
        "ttc_z_s": [2.0, float("nan"), 4.0],
        "miss_s": [1e-9, 3.0, 5.0],
        "status": ["ok", "no_parallax", "ok"],
    }
    return pd.DataFrame(rows | columns)


@pytest.mark.parametrize(
    "columns",
    [{}, {"ttc_z_s": [2.0 + 1e-6, float("nan"), 4.0]}, {"miss_s": [-1e-9, 3.0, 5.0]}],
    ids=["same", "rounded", "rounded about zero"],
)
def test_tables_that_differ_by_rounding_are_equal(columns):
    assert difference_of("collision_times", table(), table(**columns)) == ""


@pytest.mark.parametrize(
    "columns",
    [
        {"ttc_z_s": [2.0 + 1e-5, float("nan"), 4.0]},
        {"ttc_z_s": [2.0, 3.0, 4.0]},
        {"ttc_z_s": [float("nan"), float("nan"), 4.0]},
        {"status": ["short_track", "no_parallax", "ok"]},
    ],
    ids=["another number", "no longer null", "now null", "another status"],
)
def test_a_changed_value_is_named_with_its_row(columns):
    said = difference_of("collision_times", table(), table(**columns))
    assert said.startswith(f"collision_times: 1 of 3 rows differ in {next(iter(columns))}; first frame 0, track_id ")


def test_a_missing_row_is_named():
    said = difference_of("collision_times", table(), table().iloc[:2])
    assert said == "collision_times: 3 rows became 2, the first other one ['frame', 'track_id'] = (1, 1)"
