"""What a suite can expect of a result, and what is said when it is not so."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from ttcvid.errors import UsageError
from ttcvid.studies.regression.expectations import Observed, expectation_from_text

CLUSTERS = pd.DataFrame(
    {
        "frame": [30, 30, 30, 31],
        "cluster_id": [0, 1, 2, 1],
        "role": ["scene", "object", "object", "object"],
        "x0_px": [0.0, 100.0, 90.0, 100.0],
        "y0_px": [0.0, 100.0, 90.0, 100.0],
        "x1_px": [639.0, 150.0, 300.0, 150.0],
        "y1_px": [359.0, 140.0, 300.0, 140.0],
        "ref_x_px": [np.nan, 125.0, 200.0, 125.0],
        "ref_y_px": [np.nan, 120.0, 200.0, 120.0],
        "ttc_z_s": [np.nan, 7.0, 3.0, np.nan],
        "tcpa_s": [np.nan, 6.5, -2.0, 1.0],
        "miss_s": [np.nan, 0.1, 0.5, 0.1],
    }
)
EVENT = pd.DataFrame({"kind": ["collision_course"], "cluster_id": [1], "start_s": [1.0], "end_s": [2.0]})
OBSERVED = Observed(
    tables={"clusters": CLUSTERS, "events": EVENT},
    horizon_y_px=104.0,
    horizon_reason="",
    max_rss_mb=300.0,
    fps_ratio=1.5,
    metrics={"ttc_z.median": 0.04, "events.false": 0.0, "miss.median": None},
)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("events: none", "1 warning, expected none: collision_course of object 1 at 1.00-2.00 s"),
        ("events: 1", ""),
        ("events: 0", "1 warning, expected 0"),
        ("events: at least 1", ""),
        ("events: at least 2", "1 warning, expected at least 2"),
        ("events: at most 1", ""),
        ("events: at most 0", "1 warning, expected at most 0"),
        ("ttc_z of object at (125, 120) in frame 30: 7.7 s +- 10 %", ""),
        ("ttc_z of object at (125, 120) in frame 30: 7.8 s +- 10 %", "is 7 s, expected 7.8 s +- 10 %"),
        ("ttc_z of object at (200, 200) in frame 30: 3 s +- 0.1 s", ""),
        ("tcpa of object at (200.5,200) in frame 30: -2.1 s +- 10 %", ""),
        ("miss of object at (125, 120) in frame 30: 0.3 s +- 0.1 s", "miss_s of object 1 in frame 30 is 0.1 s"),
        ("ttc_z of object at (125, 120) in frame 31: 1 s +- 10 %", "is null"),
        ("ttc_z of object at (160, 120) in frame 31: 1 s +- 10 %", "is null"),
        ("ttc_z of object at (171, 120) in frame 31: 1 s +- 10 %", "no object at (171, 120) in frame 31; there"),
        ("ttc_z of object at (125, 120) in frame 99: 1 s +- 10 %", "frame 99 has no result"),
        ("horizon y centre 108 +- 15", ""),
        ("horizon y centre: 108 +- 3", "horizon y centre is 104.0 px, expected 108 +- 3"),
        ("max_rss_mb: 300", ""),
        ("max_rss_mb: 299", "300 MB of memory, expected at most 299"),
        ("min_fps_ratio: 1.5", ""),
        ("min_fps_ratio: 2", "1.5 times as fast as the clip was recorded, expected at least 2"),
        ("ttc_z.median <= 0.05", ""),
        ("ttc_z.median<0.04", "ttc_z.median is 0.04, expected < 0.04"),
        ("events.false == 0", ""),
        ("miss.median <= 1", "miss.median is without a value, expected <= 1"),
    ],
)  # fmt: skip
def test_expectations(text, complaint):
    found = expectation_from_text(text, "suite").complaint(OBSERVED)
    assert found.startswith(complaint) if complaint.startswith(("1 w", "miss_s")) else complaint in found
    assert bool(found) == bool(complaint)


def test_an_undetermined_horizon_says_why():
    without = dataclasses.replace(OBSERVED, horizon_y_px=None, horizon_reason="two motions are too few")
    complaint = expectation_from_text("horizon y centre: 108 +- 15", "suite").complaint(without)
    assert complaint == "no horizon: two motions are too few"


@pytest.mark.parametrize(
    "text",
    [
        "events: some",
        "ttc_z of object at (1, 2) in frame 3: 7 +- 10 %",
        "ttc of object at (1, 2) in frame 3: 7 s +- 10 %",
        "max_rss_mb: much",
        "ttc_z.nothing <= 1",
        "ttc_z.median <= nan",
        "",
    ],
)
def test_what_is_no_expectation_is_refused_with_its_place(text):
    with pytest.raises(UsageError, match="suite"):
        expectation_from_text(text, "suite")
