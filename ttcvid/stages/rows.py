"""The rows of a frame: times of every track and of every cluster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ttcvid.config import CollisionTimesConfig
from ttcvid.geometry.estimation.intervals import with_focal_interval
from ttcvid.geometry.paper.expansion import expansion_of_neighbourhood
from ttcvid.model import SCENE_CLUSTER, Camera, ClusterRow, CollisionTimes, Floats, Ints, TrackRows
from ttcvid.stages.egomotion.flows import select_flows
from ttcvid.stages.horizon.planar_motion import HorizonPlane
from ttcvid.stages.objects.clusters import ranked, rows_of, surfaces_of, with_epipole_pixels, with_times
from ttcvid.stages.objects.consistency import PastStates, with_consistent_covariances
from ttcvid.stages.objects.constant_bearing import EXPANSION_FRAMES, with_expansions
from ttcvid.stages.objects.motions import FrameMotions
from ttcvid.stages.objects.paper_track_states import three_frame_states, track_directions, two_frame_states
from ttcvid.stages.objects.states import TrackStates
from ttcvid.stages.objects.track_states import multi_frame_states
from ttcvid.stages.segmentation.common_errors import common_covariances, common_growth_hz
from ttcvid.stages.tracking.groups import TrackSets
from ttcvid.stages.tracking.history import TrackHistory


def track_rows(
    history: TrackHistory, motions: FrameMotions, config: CollisionTimesConfig, plane: HorizonPlane | None = None
) -> tuple[TrackStates, TrackRows]:
    """States and rows of all live tracks; ``plane`` is that of planar motion."""
    if config.estimator == "multi-frame":
        states = multi_frame_states(history, motions, plane, config)
    elif config.estimator == "three-frame":
        states = three_frame_states(history, select_flows(history, config.max_gap_frames, config.target_flow_px))
    else:
        flows, direction, covariance, why = track_directions(history, motions, plane, config)
        states = two_frame_states(flows, direction, covariance)
        asks = flows.has_flow & ~np.isfinite(direction[:, 0])
        states = replace(states, status=np.where(asks, why, states.status))
    states = states.without(~motions.is_free, motions.no_direction_status)
    states = with_expansions(states, history, motions)
    x, y = states.xy.T
    rows = TrackRows(
        track_id=history.track_id,
        cluster_id=motions.cluster_id,
        xy_px=history.xy_px,
        n_frames=history.n_frames,
        alpha_rad=states.alpha_rad,
        times=with_focal_interval(states.times(), x, y, states.abc_hz, history.camera),
        status=states.status,
    )
    return states, rows


def cluster_rows(
    history: TrackHistory, motions: FrameMotions, states: TrackStates, camera: Camera, past: PastStates
) -> tuple[tuple[ClusterRow, ...], PastStates]:
    """Rows of the scene and of all objects, ascending in ``cluster_id``, and the states of objects up to now.

    ``past`` are those up to the frame before.
    """
    members = TrackSets.of([motion.members for motion in motions.clusters])
    view = history.now - min(EXPANSION_FRAMES, history.n_past)
    gap_s = -float(history.since_s[view])
    # The scene's picture expands differently at each depth.
    objects = [one.members[: 0 if one.cluster_id == SCENE_CLUSTER else None] for one in motions.clusters]
    expansion_hz = _expansions(history, objects, view, gap_s)
    # Without a ray, outside of the lens model, a point has no part in the size.
    xy_px = np.where(np.isfinite(history.rays[history.now, :, :1]), history.xy_px, np.nan)
    joint = surfaces_of(motions.clusters, members, states, history.xy_px, motions.link_px)
    owners = TrackSets.of([motions.clusters[place].members for place in joint.owner])
    # For how long each track is seen, as far as the history goes.
    is_seen = np.isfinite(history.rays[:, owners.index, 0])
    first, last = is_seen.argmax(axis=0), len(is_seen) - 1 - is_seen[::-1].argmax(axis=0)
    age_s = owners.medians(np.where(is_seen.any(axis=0), history.t_s[last] - history.t_s[first], 0.0))
    drift_hz = common_growth_hz(owners.radii(xy_px), age_s, gap_s, history.common_error_px)
    of_states = common_covariances(joint.ref_px, drift_hz, camera)
    numbers = [motions.clusters[place].cluster_id for place in joint.owner]
    joint, past = with_consistent_covariances(joint, numbers, history, past)
    # A common drift of the tracks is the same in all states: it is no contradiction, and is not multiplied.
    joint = replace(joint, cov=joint.cov + of_states)
    rows = rows_of(motions.clusters, members, joint, states, history.xy_px, expansion_hz)
    return tuple(ranked(with_times(with_epipole_pixels(rows, camera), camera))), past


def no_tracks() -> TrackRows:
    """The rows of a frame without tracks."""
    nothing = np.empty(0, dtype=np.int64)
    return TrackRows(nothing, nothing, np.empty((0, 2)), nothing, np.empty(0), CollisionTimes.missing(0), nothing)


def _expansions(history: TrackHistory, members: Sequence[Ints], past: int, gap_s: float) -> Floats:
    """Expansion of each of K sets of tracks since the view ``past``, ``gap_s`` ago, ``(K,)`` in 1/s; NaN: unknown."""
    padded = np.full((len(members), max((len(index) for index in members), default=0)), -1, dtype=np.int64)
    for row, index in zip(padded, members, strict=True):
        row[: len(index)] = index
    return expansion_of_neighbourhood(history.derotated(past), history.rays[history.now], padded, gap_s)[0]
