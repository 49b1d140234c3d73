"""Objects found as one surface, from frame to frame: each keeps its number while it keeps its tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.model import Bools, Ints

# A surface that is missed stays an object for `forget_frames`, and can be re-identified for this many times as long.
_REMEMBERED = 4


@dataclass(frozen=True)
class Obstacle:
    """A surface as remembered: its tracks, and ``cluster_id`` once it is public (None before)."""

    cluster_id: int | None
    track_id: Ints
    n_found: int = 1
    n_missed: int = 0


def remembered(
    before: tuple[Obstacle, ...],
    track_id: Ints,
    surfaces: Sequence[Ints],
    is_free: Bools,
    next_cluster_id: int,
    config: BodiesConfig,
) -> tuple[dict[int, Ints], tuple[Obstacle, ...], int]:
    """Tracks ``(M,)`` of every public surface by its number; what to remember; the next number.

    Parameters
    ----------
    before : what the last frame remembered.
    track_id : ``(N,)`` of all live tracks.
    surfaces : tracks ``(M,)`` of each surface found in this frame.
    is_free : ``(N,)`` tracks that a surface which is not found in this frame may keep.
    """
    left_over = list(surfaces)
    is_seen = np.zeros(len(track_id), dtype=bool)
    for surface in surfaces:
        is_seen[surface] = True
    obstacles: list[Obstacle] = []
    for obstacle in before:
        again = _again(obstacle, track_id, left_over)
        if again is not None:
            found = track_id[left_over.pop(again)]
            obstacles.append(replace(obstacle, track_id=found, n_found=obstacle.n_found + 1, n_missed=0))
            continue
        # Those that a mover has taken, too: it may lose them again. What is of another surface is no part of this one.
        left = track_id[~is_seen & np.isin(track_id, obstacle.track_id)]
        if obstacle.n_missed < _REMEMBERED * config.forget_frames and len(left):
            obstacles.append(replace(obstacle, track_id=left, n_missed=obstacle.n_missed + 1))
    obstacles += [Obstacle(None, track_id[surface]) for surface in left_over]
    public: dict[int, Ints] = {}
    for place, obstacle in enumerate(obstacles):
        # A single frame may join tracks of different things to one surface.
        is_sure = obstacle.n_found > 1 and are_confirmed(obstacle.n_found, len(obstacle.track_id), config)
        if obstacle.cluster_id is None and is_sure:
            obstacles[place] = obstacle = replace(obstacle, cluster_id=next_cluster_id)
            next_cluster_id += 1
        if obstacle.cluster_id is not None and obstacle.n_missed <= config.forget_frames:
            own = np.isin(track_id, obstacle.track_id) & (is_free | (obstacle.n_missed == 0))
            if own.any():
                public[obstacle.cluster_id] = np.flatnonzero(own)
    return public, tuple(obstacles), next_cluster_id


def are_confirmed(n_found: Ints | int, n_tracks: Ints | int, config: BodiesConfig) -> Bools:
    """Whether objects found in ``n_found (K,)`` frames get a number, by how many tracks they have: ``n_tracks (K,)``.

    What many tracks agree on is sooner sure than what few do: the product of both has to reach that of
    ``confirm_frames`` and ``min_tracks``.
    """
    return np.asarray(n_found * n_tracks >= config.confirm_frames * config.min_tracks)


def tracks_of(obstacles: Sequence[Obstacle]) -> Ints:
    """The tracks of them all."""
    return np.concatenate([np.empty(0, dtype=np.int64), *(o.track_id for o in obstacles)])


def _again(obstacle: Obstacle, track_id: Ints, surfaces: list[Ints]) -> int | None:
    """Which of the surfaces has most of an obstacle's tracks."""
    if not surfaces:
        return None
    shared = [np.count_nonzero(np.isin(track_id[surface], obstacle.track_id)) for surface in surfaces]
    best = int(np.argmax(shared))
    return best if 2 * shared[best] >= min(len(obstacle.track_id), len(surfaces[best])) else None
