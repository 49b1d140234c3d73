"""What a result is held against, and the result itself, as plain tables (NaN for null)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from ttcvid.geometry.paper.collision import times_from_position_velocity
from ttcvid.geometry.rotation import normalize
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Floats, Ints

BOX = ["x0_px", "y0_px", "x1_px", "y1_px"]
DIRECTION = ["dir_x", "dir_y", "dir_z"]
ROTATION = ["rot_x_rad", "rot_y_rad", "rot_z_rad"]
POINT = ["x_true_px", "y_true_px"]
POSITION = ["x_m", "y_m", "z_m"]
VELOCITY = ["vx_m_s", "vy_m_s", "vz_m_s"]
OBSERVATION = ["frame", "track_id"]

MIN_VISIBLE_PX2 = 100.0
MIN_VISIBLE_FRACTION = 0.25
MIN_POINTS = 3
"""An object counts in a frame if at least 100 px^2 and a quarter of it are seen, or three of its tracks. What is
seen less may be found or not: it is neither missed nor false."""

UNKNOWN_OBJECT = -1
SKY_LABEL = 65535

NEAREST_SHARE = 0.1
SURFACE_DEPTH = 0.01
"""The nearest surface of an object, as in pictures: what lies at most 1 % behind its nearest tenth."""


@dataclass(frozen=True)
class RunTables:
    """The tables of a finished run, with the columns of ``ttcvid.schema``."""

    frames: pd.DataFrame
    clusters: pd.DataFrame
    epipoles: pd.DataFrame
    collision_times: pd.DataFrame
    events: pd.DataFrame


@dataclass(frozen=True)
class Truth:
    """The truth of a clip; None stands for what it does not tell.

    ``objects`` has a row per frame and object with the columns of ``truth_objects`` and ``is_counted``; ``frames`` and
    ``encounters`` are the tables of those names; ``track_points`` is ``truth_tracks``. ``track_object`` gives the true
    object of each row of the run's ``collision_times`` (0 the static scene, ``UNKNOWN_OBJECT`` where it is open).
    ``has_all_objects`` is False where objects that move may be missing from the truth: then none found is false.
    """

    objects: pd.DataFrame | None = None
    frames: pd.DataFrame | None = None
    encounters: pd.DataFrame | None = None
    track_points: pd.DataFrame | None = None
    track_object: Ints | None = None
    has_all_objects: bool = True


def plain(table: pa.Table) -> pd.DataFrame:
    """A table in ordinary types: null is NaN in floats and ``NO_CLUSTER`` in ``cluster_id``, names are strings."""
    columns: dict[str, Any] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name == "cluster_id":
            columns[name] = column.fill_null(pa.scalar(NO_CLUSTER, column.type)).to_numpy().astype(np.int64)
        elif pa.types.is_boolean(column.type):
            columns[name] = column.to_numpy().astype(bool)
        elif pa.types.is_integer(column.type) and not column.null_count:
            columns[name] = column.to_numpy().astype(np.int64)
        elif pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
            columns[name] = column.to_numpy().astype(float)
        else:
            columns[name] = column.cast(pa.string()).to_numpy()
    return pd.DataFrame(columns)


def columns_of(table: pd.DataFrame, names: Sequence[str]) -> Floats:
    """Columns of numbers ``(N, len(names))``, one by one: pandas takes several times as long to pick several."""
    return np.column_stack([table[name].to_numpy(float) for name in names])


def row_codes(numbers: Ints) -> Ints:
    """One whole number ``(N,)`` for each row of ``numbers (N, K)``, in their order; equal for equal rows."""
    if not len(numbers):
        return np.empty(0, np.int64)
    if math.prod(int(column.max()) - int(column.min()) + 1 for column in numbers.T) >= 2**62:
        # Numbers as large as hashes: by their ranks.
        numbers = np.column_stack([np.unique(column, return_inverse=True)[1] for column in numbers.T])
    lowest = numbers.min(axis=0)
    span = numbers.max(axis=0) - lowest + 1
    return np.asarray((numbers - lowest) @ np.append(np.cumprod(span[:0:-1])[::-1], 1))


def rows_of(keys: pd.DataFrame, table: pd.DataFrame, names: Sequence[str]) -> Ints:
    """The row of a table whose whole numbers ``names`` are those of each of N keys: ``(N,)``, -1 where there is none.

    No two rows of the table have the same.
    """
    own, wanted = (np.column_stack([one[name].to_numpy(np.int64) for name in names]) for one in (table, keys))
    code = row_codes(np.vstack([own, wanted]))
    order = np.argsort(code[: len(own)], kind="stable")
    place = np.searchsorted(code[: len(own)], code[len(own) :], sorter=order)
    row = np.append(order, -1)[place]
    return np.where(code[row] == code[len(own) :], row, -1) if len(own) else row


def with_counted(objects: pd.DataFrame) -> pd.DataFrame:
    """``truth_objects`` with the column ``is_counted``; a table without visible areas counts whole."""
    is_counted = np.ones(len(objects), bool)
    for name, least in (("visible_px", MIN_VISIBLE_PX2), ("visible_fraction", MIN_VISIBLE_FRACTION)):
        if name in objects:
            is_counted &= objects[name].fillna(np.inf).to_numpy() >= least
    return objects.assign(is_counted=is_counted)


def object_at(labels: np.ndarray, xy_px: Floats) -> Ints:
    """The object that each pixel position ``(N, 2)`` shows in a picture of labels ``(H, W)``; sky is static scene.

    ``UNKNOWN_OBJECT`` outside the picture and where the eight pixels around do not all agree: a corner on an outline
    belongs to either side.
    """
    known = np.where(labels == SKY_LABEL, SCENE_CLUSTER, labels).astype(np.int64)
    padded = np.pad(known, 1, mode="edge")
    column, row = np.rint(xy_px).astype(int).T
    inside = (row >= 0) & (row < labels.shape[0]) & (column >= 0) & (column < labels.shape[1])
    result = np.full(len(xy_px), UNKNOWN_OBJECT)
    row, column = row[inside], column[inside]
    around = np.stack([padded[row + i, column + j] for i in range(3) for j in range(3)])
    result[inside] = np.where((around == around[0]).all(axis=0), around[4], UNKNOWN_OBJECT)
    return result


def objects_from_tracks(track_points: pd.DataFrame, frames: pd.DataFrame, names: dict[int, str]) -> pd.DataFrame:
    """``truth_objects`` of a simulation of tracks: the box around each object's points, the times of the nearest.

    ``track_points`` has the columns of ``truth_tracks``, ``frames`` those of ``truth_frames``.
    """
    t_s = dict(zip(frames.frame, frames.t_s, strict=True))
    frame, object_id = track_points.frame.to_numpy(np.int64), track_points.object_id.to_numpy(np.int64)
    order = np.lexsort((object_id, frame))
    on_objects = track_points.take(order[object_id[order] != SCENE_CLUSTER])
    keys = np.column_stack([on_objects.frame, on_objects.object_id])
    places, position, velocity = (columns_of(on_objects, names) for names in (POINT, POSITION, VELOCITY))
    # Slices of arrays: a data frame per object and picture would take most of the time of an evaluation.
    first = np.flatnonzero(np.r_[True, np.any(np.diff(keys, axis=0), axis=1)]) if len(keys) else np.empty(0, np.int64)
    ends = np.append(first, len(keys))[1:]
    nearest = [_nearest_of(position[a:b], velocity[a:b]) for a, b in zip(first, ends, strict=True)]
    centre, mean_velocity = (np.array([pair[k] for pair in nearest]).reshape(-1, 3) for k in (0, 1))
    if len(first):
        box = np.hstack([np.minimum.reduceat(places, first), np.maximum.reduceat(places, first)])
    else:
        box = np.empty((0, 4))
    times = times_from_position_velocity(centre, mean_velocity)
    frame, object_id = keys[first].T
    columns: dict[str, object] = {
        "frame": frame,
        "t_s": [t_s[number] for number in frame.tolist()],
        "object_id": object_id,
        "name": [names.get(number, f"object {number}") for number in object_id.tolist()],
        **dict(zip(BOX, box.T, strict=True)),
        "is_counted": ends - first >= MIN_POINTS,
        **dict(zip(DIRECTION, normalize(mean_velocity).T, strict=True)),
        "tcpa_s": times.tcpa_s,
        "miss_s": times.miss_s,
        "ttc_z_s": times.ttc_z_s,
        **dict(zip(POSITION, centre.T, strict=True)),
        **dict(zip(VELOCITY, mean_velocity.T, strict=True)),
    }
    return pd.DataFrame(columns)


def _nearest_of(position_m: Floats, velocity_m_s: Floats) -> tuple[Floats, Floats]:
    """Centre and mean velocity ``(3,)`` of the nearest surface of an object with points ``(N, 3)``."""
    inverse_depth = 1 / position_m[:, 2]
    near = inverse_depth >= np.quantile(inverse_depth, 1 - NEAREST_SHARE) * (1 - SURFACE_DEPTH)
    rays = position_m[near] / position_m[near, 2:]
    return rays.mean(axis=0) / inverse_depth[near].mean(), velocity_m_s[near].mean(axis=0)
