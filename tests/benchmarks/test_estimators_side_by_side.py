"""The page that shows the estimators side by side: what its rows and its picture make of results."""

import numpy as np
import pandas as pd
from accuracy import SCENES
from estimators_side_by_side import COLUMNS, SHOWN_SCENES, WAYS, lead_car_picture, rows_of

from ttcvid.config import CollisionTimesConfig
from ttcvid.studies.evaluation.metrics import METRICS


def joined(ttc_z_lo_s, ttc_z_hi_s):
    """Five frames, out of order as tables may be."""
    t_s = np.array([0.4, 0.1, 0.2, 0.3, 0.0])
    found = np.where(t_s == 0.2, np.nan, 5.0 - t_s)
    return pd.DataFrame(
        {"t_s": t_s, "ttc_z_s": 5.0 - t_s, "ttc_z_s_found": found}
        | {"ttc_z_lo_s_found": np.full(5, ttc_z_lo_s), "ttc_z_hi_s_found": np.full(5, ttc_z_hi_s)}
    )


def test_every_estimator_has_its_row_and_what_is_missing_a_dash():
    metrics = {way: dict.fromkeys(METRICS) for way in WAYS}
    metrics["two-frame"] |= {"ttc_z.median": 0.25, "events.true": 1.0, "events.expected": 2.0}
    rows = rows_of(metrics)
    assert [row[0] for row in rows] == list(WAYS)
    shown = dict(zip(COLUMNS, rows[0][1:], strict=True))
    assert (shown["ttc_z median"], shown["warned"], shown["p90"]) == ("25.0 %", "1 of 2", "-")
    assert set(rows[1][1:]) == {"-"}


def test_the_picture_has_a_panel_for_each_estimator_and_intervals_without_an_upper_end():
    figure = lead_car_picture(
        dict(zip(WAYS, [joined(4.0, 6.0), joined(4.0, -6.0), joined(4.0, 6.0), joined(3.0, 7.0)], strict=True))
    )
    assert [axes.get_title(loc="left") for axes in figure.axes] == list(WAYS)
    estimate, lidar = (line.get_xydata() for line in figure.axes[0].lines)
    np.testing.assert_allclose(lidar[:, 1], 5.0 - np.arange(5) / 10)
    assert np.isnan(estimate[2, 1])
    closed, opened = (axes.collections[0].get_datalim(axes.transData).ymax for axes in figure.axes[:2])
    assert closed == 6.0
    assert opened > 100.0


def test_every_way_and_scene_exists():
    estimators = [words[1] for words in WAYS.values() if words[:1] == ("--estimator",)]
    for estimator in estimators:
        CollisionTimesConfig(estimator=estimator)
    assert all((SCENES / f"{name}.yaml").is_file() for name in SHOWN_SCENES)
