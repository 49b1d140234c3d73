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


@dataclass(frozen=True)
class OwnFit:
    """How each of N tracks fits the body that it belongs to.

    ``misfit (N,)`` in units of the scene's usual one; ``rate_hz, rate_sigma_hz (N,)`` on a mover's path, NaN on that
    of the scene.
    """

    misfit: Floats
    rate_hz: Floats
    rate_sigma_hz: Floats


def numbers_of(key: Ints, movers: Sequence[Mover]) -> Ints:
    """0 for a track of the scene, else 1 + place of its mover: (N,). Movers are in the order of their keys."""
    keys = np.array([SCENE_CLUSTER] + [mover.key for mover in movers])
    return np.asarray(np.searchsorted(keys, key))


def assigned(
    views: BodyViews, movers: Sequence[Mover], key: Ints, n_views: Ints, misfit: Floats, usual_misfit: float
) -> tuple[Ints, OwnFit]:
    """Each track to the body that explains it best, among the scene and those that it or a neighbour belonged to.

    Parameters
    ----------
    key, n_views : (N,) body of each track by now, and its views.
    misfit : (N,) of each track on the scene's path, in units of ``usual_misfit``.

    Returns
    -------
    Key of each track's body, (N,), and its fit there.
    """
    every, n_bodies = np.arange(len(key)), len(movers) + 1
    unknown = np.full(len(key), np.nan)
    if not movers:
        return key, OwnFit(misfit, unknown, unknown)
    number = numbers_of(key, movers)
    at = every[:, None] * n_bodies + number[views.neighbours]
    votes = np.bincount(at[views.has_neighbour], minlength=len(key) * n_bodies).reshape(len(key), n_bodies)
    is_asked = votes > 0
    is_asked[every, number] = True
    is_asked[:, 0] = False
    track, body = np.nonzero(is_asked)
    fit = fit_on_movers(views.points(track, body - 1), [mover.body for mover in movers])
    off = fit.misfit / usual_misfit
    score = np.full((len(key), n_bodies), np.inf)
    score[:, 0] = np.log1p(np.minimum(misfit, _WORST_MISFIT)) - _SCENE_WEIGHT * (n_views > _SCENE_VIEWS)
    score[track, body] = np.log1p(np.minimum(off, _WORST_MISFIT))
    score -= votes * (_NEIGHBOUR_WEIGHT / np.maximum(votes.sum(axis=1), 1))[:, None]
    score[every, number] -= _HABIT_WEIGHT * (n_views > _HABIT_VIEWS)
    best = np.argmin(score, axis=1)
    keys = np.array([SCENE_CLUSTER] + [mover.key for mover in movers])
    chosen = best[track] == body
    own = track[chosen]
    own_fit = OwnFit(misfit.copy(), unknown, unknown.copy())
    own_fit.misfit[own], own_fit.rate_hz[own] = off[chosen], fit.rate_hz[chosen]
    own_fit.rate_sigma_hz[own] = fit.rate_sigma_hz[chosen]
    return keys[best], own_fit


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
