"""The line that an analysis ends with, and what of it stands in the tables."""

from pathlib import Path

import pytest

import ttcvid


@pytest.fixture(scope="module")
def run(small_run: Path) -> ttcvid.Run:
    return ttcvid.Run.open(small_run)


def test_the_summary_names_the_object_the_interval_and_the_frame_of_the_smallest_time(run):
    nearest = run.manifest["nearest"]
    words = (
        f"smallest time to collision {nearest['ttc_z_s']:.2f} s ({nearest['ttc_z_lo_s']:.2f} to "
        f"{nearest['ttc_z_hi_s']:.2f} s) of object {nearest['cluster_id']} at frame {nearest['frame']}"
    )
    assert words in run.summary()
    clusters = run.clusters
    row = clusters[(clusters.frame == nearest["frame"]) & (clusters.cluster_id == nearest["cluster_id"])].iloc[0]
    assert (row.ttc_z_s, row.ttc_z_lo_s, row.ttc_z_hi_s) == tuple(
        nearest[name] for name in ("ttc_z_s", "ttc_z_lo_s", "ttc_z_hi_s")
    )


def test_the_smallest_time_of_a_frame_is_that_of_an_object_of_some_age_and_size(run):
    told = run.frames.dropna(subset="min_ttc_z_s")
    objects = run.clusters[run.clusters.cluster_id > 0]
    first_s = objects.groupby("cluster_id").t_s.min()
    assert len(told) > 0
    assert run.manifest["nearest"]["ttc_z_s"] == told.min_ttc_z_s.min()
    for frame in told.itertuples():
        (row,) = objects[(objects.frame == frame.frame) & (objects.ttc_z_s == frame.min_ttc_z_s)].itertuples()
        assert row.n_tracks >= 6
        assert row.ttc_z_lo_s > 0
        assert frame.t_s - first_s[row.cluster_id] >= 0.25 - 1e-9


def test_the_summary_names_the_limits_that_the_clip_runs_into(run):
    limits = run.manifest["limits"]
    assert limits
    assert f"limits of this clip: {', '.join(limit['name'] for limit in limits)}" in run.summary()
