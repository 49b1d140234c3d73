"""What a `FrameResult` holds, in the order of the tables' columns."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from ttcvid.model import ClusterRow, CollisionTimes, Event, Floats, FrameResult

_TIMES = tuple(field.name for field in fields(CollisionTimes))
_NO_RANK = -1
_UPPER_TRIANGLE = np.triu_indices(3)


def track_columns(result: FrameResult, nominal_dt_s: float) -> tuple[np.ndarray, ...]:
    """The columns of ``collision_times`` for one frame, each ``(N,)``; names are given by their number."""
    tracks, n = result.tracks, len(result.tracks.track_id)
    return (
        np.full(n, result.frame),
        np.full(n, result.t_s),
        tracks.track_id,
        tracks.cluster_id,
        tracks.xy_px[:, 0],
        tracks.xy_px[:, 1],
        tracks.n_frames,
        tracks.alpha_rad,
        tracks.times.tcpa_s / nominal_dt_s,
        *(getattr(tracks.times, name) for name in _TIMES),
        tracks.status,
    )


def epipole_row(result: FrameResult, cluster: ClusterRow) -> tuple[Any, ...]:
    """The row of ``epipoles`` for one cluster."""
    return (
        result.frame,
        result.t_s,
        cluster.cluster_id,
        cluster.method,
        *_vector(cluster.direction, 3),
        *_symmetric(cluster.direction_cov),
        *_vector(cluster.epipole_px, 2),
        cluster.horizon_offset_px,
        cluster.n_tracks,
        cluster.epipole_status.name,
    )


def cluster_row(result: FrameResult, cluster: ClusterRow) -> tuple[Any, ...]:
    """The row of ``clusters`` for one cluster."""
    return (
        result.frame,
        result.t_s,
        cluster.cluster_id,
        cluster.role,
        cluster.motion_id,
        cluster.n_tracks,
        *cluster.box_px,
        *(cluster.ref_px if cluster.ref_px is not None else (None, None)),
        *_vector(cluster.state_abc_hz, 3),
        *_symmetric(cluster.state_cov),
        cluster.motion_state.value,
        cluster.expansion_hz,
        *(getattr(cluster.times, name)[0] for name in _TIMES),
        _NO_RANK if cluster.urgency_rank is None else cluster.urgency_rank,
        cluster.status.name,
    )


def frame_row(result: FrameResult) -> tuple[Any, ...]:
    """The row of ``frames``."""
    return (
        result.frame,
        result.t_s,
        result.dt_s,
        len(result.tracks.track_id),
        len(result.clusters),
        *_vector(result.rotation_rad, 3),
        result.rotation_sigma_rad,
        result.min_ttc_z_s,
        result.status.value,
    )


def event_row(event: Event) -> tuple[Any, ...]:
    """The row of ``events``; its columns are the fields of `Event`."""
    return tuple(getattr(event, field.name) for field in fields(Event))


def _vector(values: Floats | None, n: int) -> list[float | None]:
    return [None] * n if values is None else np.asarray(values, dtype=float).tolist()


def _symmetric(matrix: Floats | None) -> list[float | None]:
    """The upper triangle of a (3, 3) matrix: xx, xy, xz, yy, yz, zz."""
    return _vector(None if matrix is None else np.asarray(matrix)[_UPPER_TRIANGLE], 6)
