"""Frame results with every kind of content, for the tests of tables and drawing."""

import numpy as np

from ttcvid.model import (
    NO_CLUSTER,
    ClusterRow,
    CollisionTimes,
    Event,
    FrameResult,
    FrameStatus,
    MotionState,
    Status,
    TrackRows,
)


def times_of(**columns):
    """Times of as many rows as the given columns have; all others missing."""
    n = len(next(iter(columns.values())))
    names = CollisionTimes.__dataclass_fields__
    return CollisionTimes(**{name: np.asarray(columns.get(name, np.full(n, np.nan)), dtype=float) for name in names})


def no_tracks():
    empty = np.zeros(0, dtype=np.int64)
    return TrackRows(empty, empty, np.zeros((0, 2)), empty, np.zeros(0), CollisionTimes.missing(0), empty)


def some_tracks(n, rng):
    """N tracks, of which the first is complete and every third has nothing."""
    times = CollisionTimes(*(rng.normal(size=n) for _ in CollisionTimes.__dataclass_fields__))
    for name in CollisionTimes.__dataclass_fields__:
        getattr(times, name)[2::3] = np.nan
    times.ttc_z_hi_s[1::3] = np.inf
    status = np.full(n, Status.ok.value)
    status[2::3] = Status.short_track.value
    cluster_id = np.arange(n) % 4
    cluster_id[2::3] = NO_CLUSTER
    return TrackRows(
        track_id=np.arange(n, dtype=np.int64) * 7 + 3,
        cluster_id=cluster_id.astype(np.int64),
        xy_px=rng.uniform(0, 300, (n, 2)),
        n_frames=np.arange(n, dtype=np.int64) + 1,
        alpha_rad=np.where(status == 0, rng.uniform(0, np.pi, n), np.nan),
        times=times,
        status=status.astype(np.int64),
    )


def scene_cluster(**changes):
    return ClusterRow(
        **{
            "cluster_id": 0,
            "motion_id": 0,
            "n_tracks": 40,
            "box_px": (0.0, 0.0, 300.0, 200.0),
            "status": Status.ok,
            "epipole_status": Status.no_epipole,
            "method": "none",
            **changes,
        }
    )


def object_cluster(cluster_id=1, **changes):
    direction = np.array([0.1, 0.02, -1.0]) / np.linalg.norm([0.1, 0.02, -1.0])
    return ClusterRow(
        **{
            "cluster_id": cluster_id,
            "motion_id": cluster_id,
            "n_tracks": 12,
            "box_px": (100.5, 80.25, 160.0, 130.0),
            "status": Status.ok,
            "epipole_status": Status.ok,
            "method": "maximum_likelihood",
            "motion_state": MotionState.approaching,
            "direction": direction,
            "direction_cov": (np.eye(3) - np.outer(direction, direction)) * 1e-3,
            "epipole_px": np.array([120.0, 90.0]),
            "horizon_offset_px": -1.5,
            "ref_px": (130.0, 100.0),
            "state_abc_hz": np.array([0.01, 0.0, -0.4]),
            "state_cov": np.arange(9.0).reshape(3, 3),
            "expansion_hz": 0.4,
            "urgency_rank": 1,
            "times": times_of(ttc_z_s=[2.5], ttc_z_lo_s=[2.1], ttc_z_hi_s=[2.8], tcpa_s=[2.4], miss_s=[0.1]),
            **changes,
        }
    )


def event(event_id=1, **changes):
    return Event(
        **{
            "event_id": event_id,
            "kind": "collision_course",
            "cluster_id": 1,
            "start_frame": 3,
            "end_frame": 5,
            "start_s": 0.3,
            "end_s": 0.5,
            "min_ttc_z_s": 2.5,
            "min_tcpa_s": None,
            "miss_s": 0.1,
            "confidence": 0.99,
            **changes,
        }
    )


def frame_result(frame=0, tracks=None, clusters=(), **changes):
    return FrameResult(
        **{
            "frame": frame,
            "t_s": frame / 10,
            "dt_s": 0.1 if frame else None,
            "status": FrameStatus.ok if frame else FrameStatus.first,
            "tracks": no_tracks() if tracks is None else tracks,
            "clusters": tuple(clusters),
            **changes,
        }
    )
