import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from frame_results import event, frame_result, no_tracks, object_cluster, scene_cluster, some_tracks, times_of

from ttcvid.errors import OutputError
from ttcvid.model import NO_CLUSTER, CollisionTimes, FrameStatus, MotionState, Status
from ttcvid.schema import TABLE_NAMES, Column, table_schema
from ttcvid.sinks import tables
from ttcvid.sinks.tables import TableSink

METADATA = {"causal": "true"}
DT_S = 0.1
TESTS = Path(__file__).parents[1]


def write_all(folder: Path, results):
    folder.mkdir(exist_ok=True)
    with TableSink(folder, METADATA, nominal_dt_s=DT_S) as sink:
        for result in results:
            sink.write(result)
    return {name: pq.read_table(folder / f"{name}.parquet") for name in TABLE_NAMES}


def nulls_where_not_finite(values):
    return [float(value) if np.isfinite(value) else None for value in values]


def test_track_rows_come_back_exactly_with_null_for_everything_missing(tmp_path):
    tracks = some_tracks(50, np.random.default_rng(1))
    table = write_all(tmp_path, [frame_result(4, tracks)])["collision_times"].to_pydict()
    assert table["frame"] == [4] * 50
    assert table["t_s"] == [0.4] * 50
    assert table["track_id"] == tracks.track_id.tolist()
    assert table["cluster_id"] == [None if c == NO_CLUSTER else c for c in tracks.cluster_id.tolist()]
    assert table["x_px"] == tracks.xy_px[:, 0].tolist()
    assert table["y_px"] == tracks.xy_px[:, 1].tolist()
    assert table["n_frames"] == tracks.n_frames.tolist()
    assert table["alpha_rad"] == nulls_where_not_finite(tracks.alpha_rad)
    assert table["k_frames"] == nulls_where_not_finite(tracks.times.tcpa_s / DT_S)
    for name in CollisionTimes.__dataclass_fields__:
        assert table[name] == nulls_where_not_finite(getattr(tracks.times, name)), name
    assert table["status"] == [Status(code).name for code in tracks.status]


def test_cluster_and_epipole_rows_come_back_exactly(tmp_path):
    cluster = object_cluster(cluster_id=3)
    written = write_all(tmp_path, [frame_result(2, clusters=[cluster])])
    (row,) = written["clusters"].to_pylist()
    assert (row["frame"], row["cluster_id"], row["role"], row["state"]) == (2, 3, "object", "approaching")
    assert (row["x0_px"], row["y0_px"], row["x1_px"], row["y1_px"]) == cluster.box_px
    assert (row["ref_x_px"], row["ref_y_px"]) == cluster.ref_px
    assert [row["a_hz"], row["b_hz"], row["c_hz"]] == cluster.state_abc_hz.tolist()
    assert [row[f"cov_{ij}"] for ij in ("aa", "ab", "ac", "bb", "bc", "cc")] == [0.0, 1.0, 2.0, 4.0, 5.0, 8.0]
    assert (row["ttc_z_s"], row["ttc_z_lo_s"], row["ttc_z_hi_s"], row["miss_lo_s"]) == (2.5, 2.1, 2.8, None)
    assert (row["urgency_rank"], row["status"], row["n_tracks"]) == (1, "ok", 12)
    (row,) = written["epipoles"].to_pylist()
    assert [row["dir_x"], row["dir_y"], row["dir_z"]] == cluster.direction.tolist()
    assert row["cov_xz"] == cluster.direction_cov[0, 2]
    assert (row["x_px"], row["y_px"], row["horizon_offset_px"]) == (120.0, 90.0, -1.5)
    assert (row["method"], row["status"]) == ("maximum_likelihood", "ok")


def test_scene_without_any_result_is_a_row_of_nulls_with_statuses(tmp_path):
    written = write_all(tmp_path, [frame_result(0, clusters=[scene_cluster(status=Status.no_parallax)])])
    (row,) = written["clusters"].to_pylist()
    assert (row["role"], row["status"], row["state"], row["motion_id"]) == ("scene", "no_parallax", "unknown", 0)
    for name in ("ref_x_px", "a_hz", "cov_cc", "expansion_hz", "tcpa_s", "ttc_z_hi_s", "urgency_rank"):
        assert row[name] is None, name
    (row,) = written["epipoles"].to_pylist()
    assert row["status"] == "no_epipole"
    for name in ("dir_x", "cov_zz", "x_px", "horizon_offset_px"):
        assert row[name] is None, name


def test_every_frame_has_a_row_also_without_tracks_and_clusters(tmp_path):
    results = [
        frame_result(0),
        frame_result(1, status=FrameStatus.duplicate, dt_s=0.0),
        frame_result(
            5, some_tracks(4, np.random.default_rng(0)), [scene_cluster()], rotation_rad=np.array([1e-3, 2e-3, 3e-3]),
            rotation_sigma_rad=1e-5, nearest=object_cluster(times=times_of(ttc_z_s=[2.0])),
        ),
        frame_result(6, clusters=[object_cluster()]),
    ]  # fmt: skip
    table = write_all(tmp_path, results)["frames"].to_pydict()
    assert table["frame"] == [0, 1, 5, 6]
    assert table["status"] == ["first", "duplicate", "ok", "ok"]
    assert table["dt_s"] == [None, 0.0, 0.1, 0.1]
    assert table["n_tracks"] == [0, 0, 4, 0]
    assert table["n_clusters"] == [0, 0, 1, 1]
    assert table["rot_y_rad"] == [None, None, 2e-3, None]
    assert table["min_ttc_z_s"] == [None, None, 2.0, None]


def test_files_have_the_schema_with_units_nullability_and_metadata(tmp_path):
    for results in ([], [frame_result(1, some_tracks(5, np.random.default_rng(0)), [object_cluster()])]):
        for name, table in write_all(tmp_path, results).items():
            assert table.schema.equals(table_schema(name, METADATA), check_metadata=True), name


def test_every_status_and_state_has_its_name(tmp_path):
    results = [frame_result(i, status=status) for i, status in enumerate(FrameStatus)]
    results += [
        frame_result(20 + i, clusters=[object_cluster(status=status, epipole_status=status)])
        for i, status in enumerate(Status)
    ]
    results += [
        frame_result(40 + i, clusters=[object_cluster(motion_state=state)]) for i, state in enumerate(MotionState)
    ]
    written = write_all(tmp_path, results)
    assert written["frames"]["status"].to_pylist()[: len(FrameStatus)] == [s.value for s in FrameStatus]
    assert written["clusters"]["status"].to_pylist()[: len(Status)] == [s.name for s in Status]
    assert written["epipoles"]["status"].to_pylist()[: len(Status)] == [s.name for s in Status]
    assert written["clusters"]["state"].to_pylist()[len(Status) :] == [s.value for s in MotionState]


def test_the_last_version_of_an_event_is_written_ordered_by_number(tmp_path):
    results = [
        frame_result(3, events=(event(2, end_frame=3),)),
        frame_result(4, events=(event(1, confidence=0.5), event(2, end_frame=4, min_ttc_z_s=None))),
        frame_result(5),
    ]
    rows = write_all(tmp_path, results)["events"].to_pylist()
    assert [row["event_id"] for row in rows] == [1, 2]
    assert rows[1] == {**vars(event(2, end_frame=4, min_ttc_z_s=None))}


def test_rows_are_sorted_by_frame_and_id_over_several_row_groups(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "TRACK_GROUP_ROWS", 25)
    monkeypatch.setattr(tables, "SMALL_GROUP_ROWS", 3)
    rng = np.random.default_rng(0)
    clusters = [object_cluster(2), scene_cluster(), object_cluster(1)]
    written = write_all(tmp_path, [frame_result(i, some_tracks(10, rng), clusters) for i in range(9)])
    assert pq.ParquetFile(tmp_path / "collision_times.parquet").num_row_groups == 3
    assert pq.ParquetFile(tmp_path / "frames.parquet").num_row_groups == 3
    tracks = written["collision_times"].to_pandas()[["frame", "track_id"]]
    assert len(tracks) == 90
    assert tracks.equals(tracks.sort_values(["frame", "track_id"]))
    for name in ("clusters", "epipoles"):
        assert written[name]["cluster_id"].to_pylist() == [0, 1, 2] * 9


def test_frames_that_do_not_ascend_and_unsorted_tracks_are_refused(tmp_path):
    tracks = some_tracks(3, np.random.default_rng(0))
    with TableSink(tmp_path, METADATA, nominal_dt_s=DT_S) as sink:
        sink.write(frame_result(1, no_tracks()))
        with pytest.raises(ValueError, match="frame 1 came after frame 1"):
            sink.write(frame_result(1))
        tracks.track_id[:] = 5
        with pytest.raises(ValueError, match="track_id"):
            sink.write(frame_result(2, tracks))


def test_equal_results_give_equal_bytes(tmp_path):
    def digest(folder):
        rng = np.random.default_rng(7)
        write_all(
            folder, [frame_result(i, some_tracks(30, rng), [object_cluster()], events=(event(),)) for i in range(5)]
        )
        return [hashlib.sha256((folder / f"{name}.parquet").read_bytes()).hexdigest() for name in TABLE_NAMES]

    assert digest(tmp_path / "a") == digest(tmp_path / "b")


def test_what_was_written_before_a_failure_of_the_run_is_readable(tmp_path):
    def interrupted():
        with TableSink(tmp_path, METADATA, nominal_dt_s=DT_S) as sink:
            sink.write(frame_result(0))
            sink.close()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert pq.read_table(tmp_path / "frames.parquet").num_rows == 1


def test_close_can_be_called_again(tmp_path):
    sink = TableSink(tmp_path, METADATA, nominal_dt_s=DT_S)
    sink.write(frame_result(0, events=(event(),)))
    sink.close()
    sink.close()
    assert pq.read_table(tmp_path / "events.parquet").num_rows == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("name", ["collision_times", "events"])
def test_full_disk_is_one_line_with_remedy(tmp_path, name):
    (tmp_path / f"{name}.parquet").symlink_to("/dev/full")
    with pytest.raises(OutputError, match=r"\.parquet: cannot be written, the disk is full: free some space") as caught:
        write_all(tmp_path, [frame_result(0, some_tracks(40000, np.random.default_rng(0)), events=(event(),))])
    assert "\n" not in str(caught.value)


def test_missing_folder_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="does not exist"):
        TableSink(tmp_path / "absent", METADATA, nominal_dt_s=DT_S)


def test_nominal_interval_has_to_be_positive(tmp_path):
    with pytest.raises(ValueError, match="nominal_dt_s"):
        TableSink(tmp_path, METADATA, nominal_dt_s=float("nan"))


def test_dictionary_columns_hold_names_of_the_schema_only(tmp_path):
    table = write_all(tmp_path, [frame_result(0, some_tracks(9, np.random.default_rng(0)))])["collision_times"]
    assert pa.types.is_dictionary(table.schema.field("status").type)
    assert set(table["status"].to_pylist()) == {"ok", "short_track"}


@pytest.mark.parametrize("n", [1, 7, 8, 9, 1000])
@pytest.mark.parametrize(
    ("type_", "nullable"),
    [
        (pa.bool_(), False),
        (pa.string(), True),
        (pa.int8(), True),
        (pa.int32(), False),
        (pa.int64(), True),
        (pa.float32(), True),
        (pa.float64(), True),
        (pa.float64(), False),
    ],
)
def test_a_column_of_any_type_comes_back(tmp_path, monkeypatch, type_, nullable, n):
    rng = np.random.default_rng(n)
    values, missing = rng.integers(0, 2 if type_ == pa.bool_() else 100, n).tolist(), rng.random(n) < 0.3
    if type_ == pa.string():
        written = read = [None if m else f"\u00e4 {v}" for v, m in zip(values, missing, strict=True)]
    elif not nullable:
        written = read = values
    else:
        nothing = np.nan if pa.types.is_floating(type_) else -1
        written = [nothing if m else v for v, m in zip(values, missing, strict=True)]
        read = [None if m else v for v, m in zip(values, missing, strict=True)]
    column = Column("one", type_, "", "a column", nullable=nullable)
    monkeypatch.setattr(tables, "columns_of", lambda name: (column,))
    monkeypatch.setattr(tables, "table_schema", lambda name, metadata: pa.schema([column.field()], metadata))
    tables.write_table(tmp_path / "any.parquet", "any", [(value,) for value in written], METADATA)
    assert pq.read_table(tmp_path / "any.parquet")["one"].to_pylist() == read


def test_tables_are_written_without_pandas(tmp_path):
    """Its import takes a quarter of a second of processor time: as much as ten frames."""
    script = f"""
import sys
sys.path.insert(0, {str(TESTS)!r})
from pathlib import Path
from frame_results import frame_result, object_cluster, scene_cluster, some_tracks
import numpy as np
from ttcvid.sinks.tables import TableSink
with TableSink(Path({str(tmp_path)!r}), {{}}, nominal_dt_s=0.1) as sink:
    sink.write(frame_result(0, some_tracks(5, np.random.default_rng(1)), [scene_cluster(), object_cluster()]))
print("pandas" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
