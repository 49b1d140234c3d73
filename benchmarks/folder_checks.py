"""Whether an output folder holds everything that was promised, as the schema says it."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ttcvid import Run
from ttcvid.schema import SCHEMA_VERSION, TABLE_NAMES, VERSION_KEY, table_schema

SORTED_BY = {
    "collision_times": ["frame", "track_id"],
    "epipoles": ["frame", "cluster_id"],
    "clusters": ["frame", "cluster_id"],
    "frames": ["frame"],
    "events": ["event_id"],
}
_UNIT_LENGTH_ERROR = 1e-9


def problems_of(run: Run) -> list[str]:
    """What is wrong with the files of a finished analysis; empty where nothing is."""
    missing = [name for name in TABLE_NAMES if not (run.folder / f"{name}.parquet").is_file()]
    lacks_overlay = run.overlay is None and run.manifest["configuration"]["analyze"]["overlay"]["value"]
    if missing or lacks_overlay:
        return [f"{name}.parquet is missing" for name in missing] + ["overlay.mp4 is missing"] * lacks_overlay
    found = [problem for name in TABLE_NAMES for problem in _problems_of_table(run, name)]
    n_frames = run.manifest["counts"]["frames"]
    n_pictures = _n_decoded(run.overlay) if run.overlay is not None else None
    if n_pictures not in (None, n_frames):
        found.append(f"overlay.mp4 holds {n_pictures} of {n_frames} frames")
    if len(run.frames) != n_frames:
        found.append(f"frames has {len(run.frames)} of {n_frames} rows")
    return found + problems_of_times(run.collision_times) + problems_of_times(run.clusters) + _problems_of_counts(run)


def _n_decoded(video: Path) -> int:
    """Number of pictures that decode; every one is, where the analysis itself looks at the key frames only."""
    with av.open(str(video)) as container:
        return sum(1 for _ in container.decode(video=0))


def _problems_of_table(run: Run, name: str) -> list[str]:
    table = pq.read_table(run.folder / f"{name}.parquet")
    found = []
    if not table.schema.equals(table_schema(name)):
        found.append(f"{name}: its columns are not those of the schema")
    if (table.schema.metadata or {}).get(VERSION_KEY.encode()) != SCHEMA_VERSION.encode():
        found.append(f"{name}: says nothing of schema version {SCHEMA_VERSION}")
    order = [(column, "ascending") for column in SORTED_BY[name]]
    if not np.array_equal(pc.sort_indices(table, sort_keys=order).to_numpy(), np.arange(len(table))):
        found.append(f"{name}: is not sorted by {SORTED_BY[name]}")
    for field in table.schema:
        column = table[field.name]
        if pa.types.is_floating(field.type) and pc.all(pc.is_finite(column.drop_null())).as_py() not in (True, None):
            found.append(f"{name}.{field.name}: holds NaN or infinity")
        if not field.nullable and column.null_count:
            found.append(f"{name}.{field.name}: holds null")
    return found


def problems_of_times(table: pd.DataFrame) -> list[str]:
    """Contradictions among the three times, their intervals and the status of tracks or clusters."""
    name = "collision_times" if "track_id" in table else "clusters"
    found = []
    for time in ("tcpa_s", "miss_s"):
        mid, lo, hi = (table[column].astype(float) for column in (time, _end(time, "lo"), _end(time, "hi")))
        n_wrong = int((lo > hi).sum())
        n_outside = int(((mid < lo) | (mid > hi)).sum())
        if n_wrong or n_outside:
            found.append(f"{name}.{time}: {n_wrong} intervals with lo > hi, {n_outside} values outside theirs")
    has_value = table.tcpa_s.notna()
    is_ok = table.status.isin(["ok", "epipole_at_infinity"])
    if name == "collision_times" and (has_value != is_ok).any():
        found.append(
            f"{name}: {int((has_value & ~is_ok).sum())} values without status ok, "
            f"{int((~has_value & is_ok).sum())} rows ok without a value"
        )
    if (table.miss_s.astype(float) < 0).any():
        found.append(f"{name}.miss_s: negative")
    return found


def _end(time: str, end: str) -> str:
    return f"{time.removesuffix('_s')}_{end}_s"


def _problems_of_counts(run: Run) -> list[str]:
    """Rows that other tables promise."""
    found = []
    n_tracks = run.collision_times.groupby("frame").size().reindex(run.frames.frame, fill_value=0)
    if not np.array_equal(n_tracks.to_numpy(), run.frames.n_tracks.to_numpy(dtype=int)):
        found.append("frames.n_tracks is not the number of rows in collision_times")
    for column in ("epipoles", "clusters"):
        rows = getattr(run, column).groupby("frame").size().reindex(run.frames.frame, fill_value=0)
        if not np.array_equal(rows.to_numpy(), run.frames.n_clusters.to_numpy(dtype=int)):
            found.append(f"frames.n_clusters is not the number of rows in {column}")
    length = np.linalg.norm(run.epipoles[["dir_x", "dir_y", "dir_z"]].astype(float), axis=1)
    if np.nanmax(np.abs(length - 1.0), initial=0.0) > _UNIT_LENGTH_ERROR:
        found.append("epipoles: dir is no unit vector")
    known = set(zip(run.clusters.frame, run.clusters.cluster_id, strict=True))
    used = run.collision_times[["frame", "cluster_id"]].dropna().drop_duplicates()
    if not set(zip(used.frame, used.cluster_id, strict=True)) <= known:
        found.append("collision_times names clusters that the frame does not have")
    return found
