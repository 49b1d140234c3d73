"""Objects found as one surface, from frame to frame: each keeps its number while it keeps its tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.model import Bools, Ints

# A surface that is missed stays an object for `forget_frames`, and can be re-identified for this many times as long.
_REMEMBERED = 4
# A mover is the surface with at least so many of its tracks, and most of the live ones.
_LEAST_TAKEN = 3


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
    before
        From the last frame.
    track_id
        Of all live tracks.
    surfaces
        Tracks ``(M,)`` of each surface found in this frame.
    is_free
        ``(N,)`` tracks that a surface which is not found in this frame may keep.
    next_cluster_id
        The next free number.
    config
        Frames until a surface becomes public.
    """
    left_over = list(surfaces)
    is_seen = np.zeros(len(track_id), dtype=bool)
    for surface in surfaces:
        is_seen[surface] = True
    obstacles: list[Obstacle] = []
    for obstacle in before:
        again = _again(obstacle, track_id, left_over)
        if again is not None:
            obstacles.append(
                replace(obstacle, track_id=track_id[left_over.pop(again)], n_found=obstacle.n_found + 1, n_missed=0)
            )
            continue
        # Those that a mover has taken, too: it may be the same thing (`number_of_taken`), or lose them again. What is
        # seen to be of another surface is no part of this one.
        left = track_id[~is_seen & np.isin(track_id, obstacle.track_id)]
        if obstacle.n_missed < _REMEMBERED * config.forget_frames and len(left):
            obstacles.append(replace(obstacle, track_id=left, n_missed=obstacle.n_missed + 1))
    obstacles += [Obstacle(None, track_id[surface]) for surface in left_over]
    public: dict[int, Ints] = {}
    for place, obstacle in enumerate(obstacles):
        if obstacle.cluster_id is None and obstacle.n_found >= config.confirm_frames:
            obstacles[place] = obstacle = replace(obstacle, cluster_id=next_cluster_id)
            next_cluster_id += 1
        if obstacle.cluster_id is not None and obstacle.n_missed <= config.forget_frames:
            own = np.isin(track_id, obstacle.track_id) & (is_free | (obstacle.n_missed == 0))
            if own.any():
                public[obstacle.cluster_id] = np.flatnonzero(own)
    return public, tuple(obstacles), next_cluster_id


def number_of_taken(surfaces: Sequence[Obstacle], track_id: Ints, members: Ints) -> int | None:
    """Number of the public surface most of whose live tracks are ``members (M,)`` of a mover; None without one.

    Of several, the one with most of them, at least three: a single one may be dragged along by what passes. An obstacle
    may start to move, or turns out to move: it is the same object, with the same number. So is what heads straight at
    us once it is near enough for its motion to show.

    Parameters
    ----------
    surfaces
        Of the last frame.
    track_id
        ``(N,)`` of all live tracks.
    members
        ``(M,)`` tracks of the mover.
    """
    is_member, number, most = np.zeros(len(track_id), dtype=bool), None, _LEAST_TAKEN - 1
    is_member[members] = True
    for surface in surfaces:
        is_own = np.isin(track_id, surface.track_id)
        n_taken = int(np.count_nonzero(is_own & is_member))
        if surface.cluster_id is not None and n_taken > most and 2 * n_taken > np.count_nonzero(is_own):
            number, most = surface.cluster_id, n_taken
    return number


def without_numbers(surfaces: Sequence[Obstacle], numbers: Ints) -> tuple[Obstacle, ...]:
    """The surfaces whose numbers are not among those ``numbers (K,)``."""
    return tuple(surface for surface in surfaces if surface.cluster_id not in numbers.tolist())


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
