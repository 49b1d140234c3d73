"""A result thinned to what a baseline keeps: some frames, their clusters, a few tracks of each, and all warnings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from ttcvid.model import SCENE_CLUSTER, Ints
from ttcvid.studies.compare.objects import objects_that_count
from ttcvid.studies.compare.results import Results
from ttcvid.studies.compare.tolerance import ObjectTolerance

N_FRAMES = 12
N_TRACKS = 8
"""Frames, and tracks of each frame, that a baseline keeps: enough to tell a median difference from chance."""
LEAST_OBJECT = 0.5
"""Objects are kept from this share on of what an object needs to count."""

COLUMNS: dict[str, tuple[str, ...]] = {
    "events": (
        "event_id", "kind", "cluster_id", "start_frame", "end_frame", "start_s", "end_s", "min_ttc_z_s", "min_tcpa_s",
        "miss_s",
    ),
    "frames": (
        "frame", "t_s", "n_tracks", "rot_x_rad", "rot_y_rad", "rot_z_rad", "rot_sigma_rad", "min_ttc_z_s", "status",
    ),
    "epipoles": (
        "frame", "cluster_id", "dir_x", "dir_y", "dir_z", "cov_xx", "cov_yy", "cov_zz", "x_px", "y_px",
        "horizon_offset_px", "n_tracks", "status",
    ),
    "clusters": (
        "frame", "cluster_id", "n_tracks", "x0_px", "y0_px", "x1_px", "y1_px", "ref_x_px", "ref_y_px", "a_hz", "b_hz",
        "c_hz", "cov_aa", "cov_bb", "cov_cc", "state", "tcpa_s", "tcpa_lo_s", "tcpa_hi_s", "miss_s", "miss_lo_s",
        "miss_hi_s", "ttc_z_s", "ttc_z_lo_s", "ttc_z_hi_s", "status",
    ),
    "collision_times": (
        "frame", "track_id", "cluster_id", "x_px", "y_px", "alpha_rad", "tcpa_s", "tcpa_lo_s", "tcpa_hi_s", "miss_s",
        "miss_lo_s", "miss_hi_s", "ttc_z_s", "ttc_z_lo_s", "ttc_z_hi_s", "status",
    ),
}  # fmt: skip
"""What a baseline keeps of each table."""


def thinned(results: Results, tolerance: ObjectTolerance) -> Results:
    """The same result with few rows and columns; frames are evenly spaced, tracks spread over those of their frame."""
    frames = results.clock.frame.to_numpy()
    kept = frames[np.unique(np.linspace(0, len(frames) - 1, min(len(frames), N_FRAMES)).astype(int))]
    tables = {name: _in_frames(table, kept) for name, table in results.tables.items()}
    tables["collision_times"] = _some_tracks(tables["collision_times"])
    # A track is re-identified by its object: that of a kept track is kept, however small.
    number = [*_objects_kept(results.tables, tolerance), *tables["collision_times"].cluster_id.unique()]
    for name in ("clusters", "epipoles"):
        tables[name] = tables[name][tables[name].cluster_id.isin([SCENE_CLUSTER, *number])].reset_index(drop=True)
    tables["clusters"] = tables["clusters"][tables["clusters"].cluster_id != SCENE_CLUSTER].reset_index(drop=True)
    tables = {name: table[list(COLUMNS[name])] for name, table in tables.items()}
    return replace(results, tables=tables, clock=results.clock[["frame", "t_s"]], is_thinned=True)


def _in_frames(table: pd.DataFrame, frames: Ints) -> pd.DataFrame:
    return table[table.frame.isin(frames)].reset_index(drop=True) if "frame" in table else table


def _some_tracks(tracks: pd.DataFrame) -> pd.DataFrame:
    """A few tracks of each frame that have a time, taken evenly from left to right."""
    with_time = tracks[tracks.tcpa_s.notna()].sort_values(["frame", "x_px"], kind="stable")
    rows = [
        of_frame.iloc[np.unique(np.linspace(0, len(of_frame) - 1, min(len(of_frame), N_TRACKS)).astype(int))]
        for _, of_frame in with_time.groupby("frame")
    ]
    return pd.concat(rows).sort_index().reset_index(drop=True) if rows else with_time


def _objects_kept(tables: Mapping[str, pd.DataFrame], tolerance: ObjectTolerance) -> list[int]:
    """Those that count by themselves, and those that nearly do: they may in the run."""
    clusters, warned = tables["clusters"], set(tables["events"].cluster_id)
    objects = clusters[clusters.cluster_id != SCENE_CLUSTER].reset_index(drop=True)
    least_tracks = max(1, round(LEAST_OBJECT * tolerance.min_tracks))
    nearly = tolerance.model_copy(update={"min_tracks": least_tracks, "warn_s": tolerance.warn_s / LEAST_OBJECT})
    return objects_that_count(objects, LEAST_OBJECT * tolerance.min_frames, warned, nearly)
