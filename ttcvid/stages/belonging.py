"""Which body each track belongs to: the one whose path explains its views best, with a say for its neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.model import SCENE_CLUSTER, Floats, Ints
from ttcvid.stages.bodies import Body
from ttcvid.stages.body_views import BodyViews, fit_on_movers

# Belonging is decided by ln(1 + misfit), misfits beyond this being equally bad; all neighbours together weigh this
# much, where a track was before this much, and that most of the world stands still this much.
_WORST_MISFIT, _NEIGHBOUR_WEIGHT, _HABIT_WEIGHT, _SCENE_WEIGHT = 50.0, 1.0, 0.3, 0.4
# The habit and the scene's bonus count for tracks with more views than these.
_HABIT_VIEWS, _SCENE_VIEWS = 3, 2


@dataclass(frozen=True)
class Mover:
    """A mover as remembered: ``key`` is internal, ``cluster_id`` public (None until it has been confirmed)."""

    key: int
    cluster_id: int | None
    n_found: int
    n_missed: int
    body: Body


def numbers_of(key: Ints, movers: Sequence[Mover]) -> Ints:
    """0 for a track of the scene, else 1 + place of its mover: (N,). Movers are in the order of their keys."""
    keys = np.array([SCENE_CLUSTER] + [mover.key for mover in movers])
    return np.asarray(np.searchsorted(keys, key))


def assigned(
    views: BodyViews, movers: Sequence[Mover], key: Ints, n_views: Ints, misfit: Floats, usual_misfit: float
) -> tuple[Ints, Floats]:
    """Each track to the body that explains it best, among the scene and those that it or a neighbour belonged to.

    Parameters
    ----------
    key, n_views : (N,) body of each track by now, and its views.
    misfit : (N,) of each track on the scene's path, in units of ``usual_misfit``.

    Returns
    -------
    Key of each track's body, and its misfit there in units of ``usual_misfit``: (N,) each.
    """
    if not movers:
        return key, misfit
    every, n_bodies = np.arange(len(key)), len(movers) + 1
    number = numbers_of(key, movers)
    at = every[:, None] * n_bodies + number[views.neighbours]
    votes = np.bincount(at[views.has_neighbour], minlength=len(key) * n_bodies).reshape(len(key), n_bodies)
    is_asked = votes > 0
    is_asked[every, number] = True
    track, mover = np.nonzero(is_asked[:, 1:])
    off = np.full((len(key), n_bodies), np.inf)
    off[:, 0] = misfit
    off[track, mover + 1] = fit_on_movers(views.points(track, mover), [m.body for m in movers]).misfit / usual_misfit
    score = np.full((len(key), n_bodies), np.inf)
    score[:, 0] = np.log1p(np.minimum(misfit, _WORST_MISFIT)) - _SCENE_WEIGHT * (n_views > _SCENE_VIEWS)
    score[track, mover + 1] = np.log1p(np.minimum(off[track, mover + 1], _WORST_MISFIT))
    score -= votes * (_NEIGHBOUR_WEIGHT / np.maximum(votes.sum(axis=1), 1))[:, None]
    score[every, number] -= _HABIT_WEIGHT * (n_views > _HABIT_VIEWS)
    best = np.argmin(score, axis=1)
    keys = np.array([SCENE_CLUSTER] + [m.key for m in movers])
    return keys[best], off[every, best]


def kept(key: Ints, movers: Sequence[Mover], config: BodiesConfig) -> tuple[Ints, list[Mover]]:
    """Movers that still have tracks; those with a last one or two wait for a while, then these go to the scene."""
    key, still = key.copy(), []
    counts = np.bincount(numbers_of(key, movers), minlength=len(movers) + 1)[1:]
    for mover, count in zip(movers, counts.tolist(), strict=True):
        if count >= min(3, config.min_tracks):
            still.append(replace(mover, n_found=mover.n_found + 1, n_missed=0))
        elif count and mover.n_missed < config.forget_frames:
            still.append(replace(mover, n_missed=mover.n_missed + 1))
        else:
            key[key == mover.key] = SCENE_CLUSTER
    return key, still
