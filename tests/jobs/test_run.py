"""A finished run in Python: its tables as data frames, and what is asked of them most."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from frame_results import event, frame_result, object_cluster, scene_cluster, some_tracks, times_of
from perfect_runs import manifest_of_run

import ttcvid
from ttcvid.model import FrameResult, MotionState
from ttcvid.schema import EVENT_KINDS, TABLE_NAMES, TABLES
from ttcvid.sinks.manifest import write_manifest
from ttcvid.sinks.tables import TableSink


def written(folder: Path, results: list[FrameResult]) -> ttcvid.Run:
    folder.mkdir()
    with TableSink(folder, {}, nominal_dt_s=0.1) as sink:
        for result in results:
            sink.write(result)
    write_manifest(folder / "manifest.json", manifest_of_run())
    return ttcvid.Run.open(folder)


@pytest.fixture
def run(tmp_path: Path) -> ttcvid.Run:
    objects = (
        scene_cluster(),
        object_cluster(1),
        object_cluster(2, motion_state=MotionState.constant_bearing, times=times_of(ttc_z_s=[6.0])),
        object_cluster(3, motion_state=MotionState.receding, times=times_of(ttc_z_s=[-1.0])),
        object_cluster(4, urgency_rank=None, times=times_of(ttc_z_s=[np.nan])),
    )
    tracks = some_tracks(9, np.random.default_rng(1))
    return written(tmp_path / "run", [frame_result(i, tracks, objects, events=(event(),)) for i in range(2)])


def test_objects_are_the_clusters_without_the_scene(run: ttcvid.Run) -> None:
    assert run.objects.cluster_id.tolist() == [1, 2, 3, 4] * 2
    assert run.objects.index.tolist() == list(range(8))


def test_what_approaches_is_told_by_its_state_and_within_a_time(run: ttcvid.Run) -> None:
    assert run.approaching().cluster_id.tolist() == [1, 2, 4] * 2
    assert run.approaching(within_s=4.0).cluster_id.tolist() == [1, 1]


@pytest.mark.parametrize("name", TABLE_NAMES)
def test_types_and_attributes_are_those_of_pandas_read_parquet(name: str, run: ttcvid.Run) -> None:
    table = getattr(run, name)
    assert len(table) > 0
    read = pd.read_parquet(run.folder / f"{name}.parquet")
    pd.testing.assert_frame_equal(table, read)
    assert table.attrs == read.attrs


def test_null_is_na_and_whole_numbers_stay_whole(run: ttcvid.Run) -> None:
    assert run.collision_times.cluster_id.dtype == pd.Int32Dtype()
    assert run.collision_times.cluster_id.isna().any()
    assert run.objects.urgency_rank.tolist()[:4] == [1, 1, 1, pd.NA]
    assert run.events.min_tcpa_s.tolist() == [pd.NA]


@pytest.mark.parametrize("name", TABLE_NAMES)
def test_attributes_say_unit_and_meaning_of_every_column(name: str, run: ttcvid.Run) -> None:
    attrs = getattr(run, name).attrs
    assert attrs["units"] == {column.name: column.unit for column in TABLES[name] if column.unit}
    assert attrs["descriptions"] == {column.name: column.description for column in TABLES[name]}


def test_attributes_outlive_a_selection(run: ttcvid.Run) -> None:
    assert run.approaching().attrs["units"]["ttc_z_s"] == "s"


def test_the_kinds_of_events_are_known_where_there_is_none(run: ttcvid.Run, tmp_path: Path) -> None:
    quiet = written(tmp_path / "quiet", [frame_result(0)])
    for events in (run.events, quiet.events):
        assert events.kind.cat.categories.tolist() == list(EVENT_KINDS)
    assert quiet.events.empty
