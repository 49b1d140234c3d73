"""The check of an output folder finds what is wrong with it."""

import shutil

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from folder_checks import problems_of

import ttcvid


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run over a few frames of points that come nearer."""
    folder = tmp_path_factory.mktemp("checked")
    rng = np.random.default_rng(2)
    place = np.column_stack([rng.uniform(-8, 8, 80), rng.uniform(-2, 2, 80), rng.uniform(10, 40, 80)])
    rows = []
    for frame in range(6):
        x, y, z = (place - (0.0, 0.0, 0.8 * frame)).T
        t_s = np.full(80, 0.1 * frame)
        rows.append(np.column_stack([np.full(80, frame), t_s, np.arange(80), 500 * x / z + 319.5, 500 * y / z + 239.5]))
    columns = np.concatenate(rows).T
    names = ["frame", "t_s", "track_id", "x_px", "y_px"]
    types = [pa.int32(), pa.float64(), pa.int64(), pa.float64(), pa.float64()]
    table = pa.table({n: pa.array(c).cast(t) for n, c, t in zip(names, columns, types, strict=True)})
    path = folder / "points.parquet"
    pq.write_table(table, path)
    return ttcvid.analyze(path, folder / "run", image_size="640x480", focal_px=500.0)


@pytest.fixture
def run(finished, tmp_path):
    """A copy of the run that may be spoiled."""
    return ttcvid.Run.open(shutil.copytree(finished.folder, tmp_path / "run"))


def rewrite(run, name, change):
    path = run.folder / f"{name}.parquet"
    table = pq.read_table(path)
    pq.write_table(change(table).replace_schema_metadata(table.schema.metadata), path)


def replaced(table, name, values):
    return table.set_column(table.schema.get_field_index(name), table.schema.field(name), values)


def test_a_finished_run_has_no_problems(run):
    assert problems_of(run) == []


def test_a_missing_table_is_found(run):
    (run.folder / "events.parquet").unlink()
    assert problems_of(run) == ["events.parquet is missing"]


def test_infinity_is_found(run):
    rewrite(run, "collision_times", lambda t: replaced(t, "miss_hi_s", pa.array(np.full(len(t), np.inf))))
    assert "collision_times.miss_hi_s: holds NaN or infinity" in problems_of(run)


def test_rows_out_of_order_are_found(run):
    rewrite(run, "frames", lambda t: t.take(pa.array(np.arange(len(t))[::-1])))
    assert "frames: is not sorted by ['frame']" in problems_of(run)


def test_another_type_is_found(run):
    rewrite(run, "frames", lambda t: t.set_column(0, "frame", t["frame"].cast(pa.int64())))
    assert "frames: its columns are not those of the schema" in problems_of(run)


def test_lost_rows_are_found(run):
    rewrite(run, "collision_times", lambda t: t.filter(pc.greater(t["track_id"], 3)))
    assert "frames.n_tracks is not the number of rows in collision_times" in problems_of(run)


def test_a_shortened_direction_is_found(run):
    rewrite(run, "epipoles", lambda t: replaced(t, "dir_z", pc.multiply(t["dir_z"], 0.9)))
    assert "epipoles: dir is no unit vector" in problems_of(run)


def test_an_interval_beside_its_value_is_found(run):
    rewrite(run, "collision_times", lambda t: replaced(t, "miss_lo_s", pc.add(t["miss_hi_s"], 1.0)))
    assert any("intervals with lo > hi" in problem for problem in problems_of(run))
