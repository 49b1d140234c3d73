"""Numbers of the motion groups: the same group keeps its number from frame to frame, by its tracks."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ttcvid.model import NO_CLUSTER, Floats, Ints
from ttcvid.stages.motion_groups import FormerGroup, MotionGroup

# A group gets its number when it has been found in so many frames; chance groups seldom last.
_CONFIRM_FRAMES = 3
# A group that is not found for more frames than this is gone.
_FORGET_FRAMES = 8
# A group is the former one when at least this part of its remembered tracks comes from there.
_INHERITED_PART = 0.4


@dataclass(frozen=True)
class KnownGroup:
    """A group as remembered: ``key`` is internal, ``cluster_id`` its public number (None until it is confirmed)."""

    key: int
    cluster_id: int | None
    n_found: int
    n_missed: int
    direction: Floats


@dataclass(frozen=True)
class GroupMemory:
    """The known groups, and the group that each track ``track_id (N,)`` was last in: ``track_key (N,)``."""

    groups: tuple[KnownGroup, ...] = ()
    track_id: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    track_key: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    next_key: int = 0
    next_cluster_id: int = 1


def former_keys(memory: GroupMemory, track_id: Ints) -> Ints:
    """Key of the group that each of the tracks (N,) was last in, NO_CLUSTER where none."""
    keys = np.full(len(track_id), NO_CLUSTER, dtype=np.int64)
    if len(memory.track_id):
        place = np.minimum(np.searchsorted(memory.track_id, track_id), len(memory.track_id) - 1)
        is_known = memory.track_id[place] == track_id
        keys[is_known] = memory.track_key[place[is_known]]
    return keys


def former_groups(memory: GroupMemory, track_id: Ints, cam_R_prev: Floats) -> list[FormerGroup]:
    """The remembered groups as starts of the next search, their directions turned into the present camera."""
    keys = former_keys(memory, track_id)
    return [FormerGroup(np.flatnonzero(keys == g.key), cam_R_prev @ g.direction) for g in memory.groups]


def named(
    groups: list[MotionGroup], track_id: Ints, memory: GroupMemory, cam_R_prev: Floats
) -> tuple[list[int | None], GroupMemory]:
    """Public number of each group (None: not confirmed yet), and the memory for the next frame.

    A group takes over the key that most of its remembered tracks had; the larger group chooses first. The direction of
    a group that is missed is turned along with the camera, by ``cam_R_prev (3, 3)``.
    """
    keys = former_keys(memory, track_id)
    known = {g.key: g for g in memory.groups}
    key_of: dict[int, int] = {}
    next_key = memory.next_key
    for number in sorted(range(len(groups)), key=lambda i: -len(groups[i].members)):
        key = _inherited_key(keys[groups[number].members], set(known) - set(key_of.values()))
        if key is None:
            key, next_key = next_key, next_key + 1
        key_of[number] = key
    next_cluster_id = memory.next_cluster_id
    seen: dict[int, KnownGroup] = {}
    for number, group in enumerate(groups):
        key = key_of[number]
        before = known.get(key, KnownGroup(key, None, 0, 0, group.direction))
        cluster_id = before.cluster_id
        if cluster_id is None and before.n_found + 1 >= _CONFIRM_FRAMES:
            cluster_id, next_cluster_id = next_cluster_id, next_cluster_id + 1
        seen[key] = KnownGroup(key, cluster_id, before.n_found + 1, 0, group.direction)
    missed = [
        replace(g, n_missed=g.n_missed + 1, direction=cam_R_prev @ g.direction)
        for g in memory.groups
        if g.key not in seen and g.n_missed < _FORGET_FRAMES
    ]
    kept = tuple(sorted([*seen.values(), *missed], key=lambda g: g.key))
    keys = np.where(np.isin(keys, [g.key for g in missed]), keys, NO_CLUSTER)
    for number, group in enumerate(groups):
        keys[group.members] = key_of[number]
    names = [seen[key_of[number]].cluster_id for number in range(len(groups))]
    return names, GroupMemory(kept, track_id, keys, next_key, next_cluster_id)


def restarted(memory: GroupMemory) -> GroupMemory:
    """Nothing known any more, but no number given out twice."""
    return GroupMemory(next_key=memory.next_key, next_cluster_id=memory.next_cluster_id)


def _inherited_key(keys: Ints, free: set[int]) -> int | None:
    """The free key that enough of the remembered tracks bring along, or None."""
    remembered = keys[keys != NO_CLUSTER]
    values, counts = np.unique(remembered, return_counts=True)
    for place in np.argsort(-counts, kind="stable"):
        if int(values[place]) in free and counts[place] >= _INHERITED_PART * len(remembered):
            return int(values[place])
    return None
