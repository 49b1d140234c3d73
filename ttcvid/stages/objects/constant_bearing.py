"""Tracks without a flow of their own: their times by the expansion around them (the paper's equation 8)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.geometry.paper.expansion import expansion_of_neighbourhood
from ttcvid.geometry.rotation import normalize
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Bools, Floats, Ints, Status
from ttcvid.stages.objects.motions import FrameMotions
from ttcvid.stages.objects.states import EXPANSION_NEIGHBOURS, TrackStates
from ttcvid.stages.tracking.history import TrackHistory
from ttcvid.stages.tracking.neighbours import nearest_neighbours

EXPANSION_FRAMES = 5
"""Expansions are measured over so many steps of the history, where there are as many."""
# An expansion is taken for one above so many of its standard deviations.
_EXPANSION_SIGMAS = 3.0


def with_expansions(states: TrackStates, history: TrackHistory, motions: FrameMotions) -> TrackStates:
    """Times by expansion for tracks of a cluster that have no flow of their own."""
    # The surroundings of a point of the scene lie at many depths: there only one on the epipole itself is asked.
    is_at_epipole = (states.status == int(Status.at_epipole)) & (motions.cluster_id != NO_CLUSTER)
    # What is within its noise as a whole does not expand, either.
    directed = [
        one.cluster_id for one in motions.clusters if one.cluster_id > SCENE_CLUSTER and one.direction is not None
    ]
    stays = (states.status == int(Status.no_parallax)) & np.isin(motions.cluster_id, directed)
    asks = is_at_epipole | stays
    itself = np.arange(history.n_tracks)[:, None]
    others = nearest_neighbours(history.xy_px, EXPANSION_NEIGHBOURS - 1, motions.link_px, asks, motions.cluster_id)
    neighbours = np.hstack([itself, np.where(others == itself, -1, others)])
    return with_constant_bearing(states, history, neighbours, min(EXPANSION_FRAMES, history.n_past), asks)


def with_constant_bearing(
    states: TrackStates, history: TrackHistory, neighbours: Ints, gap_frames: int, may_expand: Bools
) -> TrackStates:
    """Give tracks without a flow of their own the time of the expansion around them (the paper's section 2.1).

    The expansion gives c = V_z / Z, the point's own flow, however small, the sideways part of V.

    The expansion of ``neighbours (N, m)``, tracks of the same cluster around each track (negative: absent), is measured
    over ``gap_frames``; ``may_expand (N,)`` tracks are asked (at the epipole, or without parallax).
    """
    asked = np.flatnonzero(may_expand)
    if not len(asked) or gap_frames < 1:
        return states
    past_rays, gap_s = history.derotated(history.now - gap_frames), -history.since_s[history.now - gap_frames]
    neighbours = neighbours[asked]
    eta_hz, sigma_hz = expansion_of_neighbourhood(past_rays, history.rays[history.now], neighbours, gap_s)
    sigma_hz = np.maximum(sigma_hz, _expansion_noise_hz(states, neighbours, gap_s))
    past = past_rays[asked]
    is_sure = (eta_hz > _EXPANSION_SIGMAS * sigma_hz) & (past[:, 2] > 0.0)
    asked, eta_hz, sigma_hz, past = asked[is_sure], eta_hz[is_sure], sigma_hz[is_sure], past[is_sure]
    xy, stretch = states.xy[asked], 1.0 + eta_hz * gap_s
    # x_past = (x - a T) / (1 - c T) with c = -eta, solved for a; y and b likewise.
    w = np.column_stack([(xy - past[:, :2] / past[:, 2:] * stretch[:, None]) / gap_s, -eta_hz])
    # What the expansion errs by moves a point along its ray; across, its own noise does.
    ray = np.column_stack([xy, np.ones(len(xy))])
    across_hz2 = 2.0 * (states.sigma_norm[asked] / gap_s) ** 2
    abc_hz, cov = states.abc_hz.copy(), states.cov.copy()
    direction, status = states.direction.copy(), states.status.copy()
    abc_hz[asked], direction[asked], status[asked] = w, normalize(w), Status.ok
    cov[asked] = (sigma_hz**2)[:, None, None] * ray[:, :, None] * ray[:, None, :]
    cov[asked] += across_hz2[:, None, None] * np.diag([1.0, 1.0, 0.0])
    shared = states.shared
    if shared is not None:
        # On a path they are no longer.
        path_of = shared.path_of.copy()
        path_of[asked] = -1
        shared = replace(shared, path_of=path_of)
    return replace(states, abc_hz=abc_hz, cov=cov, direction=direction, status=status, shared=shared)


def _expansion_noise_hz(states: TrackStates, neighbours: Ints, gap_s: float) -> Floats:
    """What the noise of the tracks alone does to the expansion of each neighbourhood (Q, m): (Q,), else infinite.

    By the noisiest of each neighbourhood, over its size. The residuals of the similarity may be smaller by chance, or
    where pictures repeat exactly.
    """
    is_there = neighbours >= 0
    count = np.maximum(np.sum(is_there, axis=1), 1)
    xy = np.where(is_there[..., None], states.xy[neighbours], 0.0)
    off = np.where(is_there[..., None], xy - (np.sum(xy, axis=1) / count[:, None])[:, None], 0.0)
    sigma = np.max(np.where(is_there, states.sigma_norm[neighbours], 0.0), axis=1)
    size = np.sqrt(np.sum(off**2, axis=(1, 2)))
    unknown = np.full(len(size), np.inf)
    return np.asarray(np.divide(np.sqrt(2.0) * sigma, size * gap_s, out=unknown, where=size > 0.0))
