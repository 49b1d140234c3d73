"""Which body each track belongs to: the one whose path explains its views best, with a say for its neighbours."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.rigid_path import RigidPaths
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Bools, Floats, Ints
from ttcvid.stages.body_views import BodyViews, fit_on_movers

# Belonging is decided by ln(1 + misfit), misfits beyond this being equally bad; all neighbours together weigh this
# much, where a track was before this much, and that most of the world stands still this much.
_WORST_MISFIT, _NEIGHBOUR_WEIGHT, _HABIT_WEIGHT, _SCENE_WEIGHT = 50.0, 1.0, 0.3, 0.4
# The habit and the scene's bonus count for tracks with more views than these.
_HABIT_VIEWS, _SCENE_VIEWS = 3, 2


@dataclass(frozen=True)
class Movers:
    """K movers as remembered, ascending in their internal ``key (K,)``.

    ``cluster_id (K,)`` is public, `NO_CLUSTER` until a mover has been confirmed; ``n_found, n_missed (K,)`` frames in
    which it was found, and was not since; ``paths`` the motions, with the median rate ``rate_hz (K,)`` of their points.
    """

    key: Ints
    cluster_id: Ints
    n_found: Ints
    n_missed: Ints
    rate_hz: Floats
    paths: RigidPaths

    def __len__(self) -> int:
        return len(self.key)

    def take(self, index: Ints | Bools) -> Movers:
        """The movers that an index array or a mask picks."""
        return Movers(
            self.key[index],
            self.cluster_id[index],
            self.n_found[index],
            self.n_missed[index],
            self.rate_hz[index],
            self.paths.take(index),
        )

    def with_new(self, next_key: int, paths: RigidPaths, rate_hz: Floats) -> Movers:
        """These and J new ones, whose keys count up from ``next_key``."""
        count = len(paths)
        return Movers(
            np.append(self.key, next_key + np.arange(count)),
            np.append(self.cluster_id, np.full(count, NO_CLUSTER)),
            np.append(self.n_found, np.ones(count, dtype=np.int64)),
            np.append(self.n_missed, np.zeros(count, dtype=np.int64)),
            np.append(self.rate_hz, rate_hz),
            self.paths.joined(paths),
        )


def no_movers(n_views: int) -> Movers:
    """None at all, over so many views."""
    none, paths = np.empty(0, dtype=np.int64), RigidPaths(np.empty((0, n_views, 3, 3)), np.empty((0, n_views, 3)))
    return Movers(none, none, none, none, np.empty(0), paths)


def numbers_of(key: Ints, movers: Movers) -> Ints:
    """0 for a track of the scene, else 1 + place of its mover: (N,)."""
    return np.asarray(np.searchsorted(movers.key, key, side="right"))


def assigned(
    views: BodyViews, movers: Movers, key: Ints, n_views: Ints, misfit: Floats, usual_misfit: float
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
    if not len(movers):
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
    fit = fit_on_movers(views.points(track, mover), movers.paths, movers.rate_hz)
    off[track, mover + 1] = fit.misfit / usual_misfit
    score = np.full((len(key), n_bodies), np.inf)
    score[:, 0] = np.log1p(np.minimum(misfit, _WORST_MISFIT)) - _SCENE_WEIGHT * (n_views > _SCENE_VIEWS)
    score[track, mover + 1] = np.log1p(np.minimum(off[track, mover + 1], _WORST_MISFIT))
    score -= votes * (_NEIGHBOUR_WEIGHT / np.maximum(votes.sum(axis=1), 1))[:, None]
    score[every, number] -= _HABIT_WEIGHT * (n_views > _HABIT_VIEWS)
    best = np.argmin(score, axis=1)
    return np.append(SCENE_CLUSTER, movers.key)[best], off[every, best]


def kept(key: Ints, movers: Movers, config: BodiesConfig) -> tuple[Ints, Movers]:
    """Movers that still have tracks; those with a last one or two wait for a while, then these go to the scene."""
    counts = np.bincount(numbers_of(key, movers), minlength=len(movers) + 1)[1:]
    is_found = counts >= min(3, config.min_tracks)
    is_kept = is_found | ((counts > 0) & (movers.n_missed < config.forget_frames))
    movers = replace(
        movers,
        n_found=movers.n_found + is_found,
        n_missed=np.where(is_found, 0, movers.n_missed + 1),
    )
    return np.where(np.isin(key, movers.key[~is_kept]), SCENE_CLUSTER, key), movers.take(is_kept)
