"""Movers that turn out to be one, and parts of one that turn out to be several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.medians import medians
from ttcvid.model import Ints
from ttcvid.stages.belonging import Mover, OwnFit, numbers_of
from ttcvid.stages.bodies import Body, refined_movers
from ttcvid.stages.body_views import BodyViews, fit_on_movers
from ttcvid.stages.connected import connected_parts, linked_pairs

# Two bodies, or two parts of one, are one where their rates differ by less than this factor.
_ONE_RATE = 1.5
# Two movers are one where one motion explains both at most this much worse than two, misfits below 1 being 1; before
# that is tried, the motion of the larger has to explain the smaller within this factor, at rates within the other.
_MERGED_MISFIT, _WORTH_TRYING, _PERHAPS_ONE_RATE = 2.0, 8.0, 3.0
_LEAST_MISFIT = 1.0
# Steps of refinement of two taken as one; so many tracks of each tell whether they are.
_JOINT_STEPS, _ENOUGH_TRACKS = 4, 40
# What was two in one frame is seldom one in the next: of those found in more frames than this that is asked now and
# then.
_YOUNG_FRAMES, _MERGE_FRAMES = 5, 4
_LEAST_TRACKS = 3
_TINY_HZ = 1e-9


def merged(
    views: BodyViews, scene: Body, key: Ints, movers: Sequence[Mover], own_fit: OwnFit, usual_misfit: float
) -> tuple[Ints, list[Mover], OwnFit]:
    """Movers side by side that one motion explains are one; the older one's number stays.

    The rates of their tracks are not known any more.

    Parameters
    ----------
    own_fit : of each track on its body, in units of ``usual_misfit``.
    """
    key, rate_hz = key.copy(), own_fit.rate_hz.copy()
    alive = {mover.key: mover for mover in movers}
    for large, small, limit in _worth_trying(views, key, movers, own_fit, usual_misfit):
        if large.key not in alive or small.key not in alive:
            continue
        joint = _joint(views, scene, key, alive[large.key], small, limit * usual_misfit)
        if joint is not None:
            older = max(alive[large.key], alive[small.key], key=lambda m: (m.n_found, -m.key))
            younger = small.key if older.key == large.key else large.key
            key[key == younger] = older.key
            rate_hz[key == older.key] = np.nan
            alive[older.key] = replace(older, body=joint)
            del alive[younger]
    return key, list(alive.values()), replace(own_fit, rate_hz=rate_hz)


def _worth_trying(
    views: BodyViews, key: Ints, movers: Sequence[Mover], own_fit: OwnFit, usual_misfit: float
) -> list[tuple[Mover, Mover, float]]:
    """Neighbours that may be one: the larger, the smaller, and the misfit that is usual in both."""
    number = numbers_of(key, movers)
    counts = np.bincount(number, minlength=len(movers) + 1)
    codes = number[:, None] * len(counts) + number[views.neighbours]
    touch = np.bincount(codes.ravel(), minlength=len(counts) ** 2).reshape(len(counts), len(counts))
    pairs = []
    for one, other in (np.argwhere(np.triu(touch[1:, 1:], 1)) + 1).tolist():
        age = min(movers[one - 1].n_found, movers[other - 1].n_found)
        is_asked = age <= _YOUNG_FRAMES or age % _MERGE_FRAMES == 0
        if is_asked and min(counts[one], counts[other]) >= _LEAST_TRACKS:
            pairs.append((one, other) if counts[one] >= counts[other] else (other, one))
    if not pairs:
        return []
    own = [np.flatnonzero(number == place) for place in range(len(counts))]
    few = np.repeat(np.arange(len(pairs)), [counts[small] for _, small in pairs])
    track = np.concatenate([own[small] for _, small in pairs])
    body = np.array([large - 1 for large, _ in pairs])
    fit = fit_on_movers(views.points(track, body[few]), [mover.body for mover in movers])
    misfit = medians(fit.misfit, few, len(pairs)) / usual_misfit
    known = np.isfinite(fit.rate_hz)
    rate_hz = medians(fit.rate_hz[known], few[known], len(pairs))
    chosen = []
    for place, (large, small) in enumerate(pairs):
        limit = max(float(np.median(own_fit.misfit[np.concatenate([own[large], own[small]])])), _LEAST_MISFIT)
        usual_hz = movers[large - 1].body.rate_hz
        is_one_rate = usual_hz < _PERHAPS_ONE_RATE * rate_hz[place] < _PERHAPS_ONE_RATE**2 * usual_hz
        if is_one_rate and misfit[place] <= _WORTH_TRYING * limit:
            chosen.append((movers[large - 1], movers[small - 1], limit))
    return chosen


def _joint(views: BodyViews, scene: Body, key: Ints, large: Mover, small: Mover, limit: float) -> Body | None:
    """The motion of two movers taken as one, None where they are two by the misfit that is usual in both."""
    own = [np.flatnonzero(key == mover.key) for mover in (large, small)]
    both = np.concatenate([tracks[:: -(-len(tracks) // _ENOUGH_TRACKS)] for tracks in own])
    points, is_large = views.points(both), key[both] == large.key
    (joint,) = refined_movers([large.body], scene, points, np.array([_JOINT_STEPS]))
    fit = points.fit([joint], None)
    # A track that has just been born has no rate yet.
    known = np.isfinite(fit.rate_hz)
    one, other = medians(fit.rate_hz[known], is_large[known].astype(np.int64), 2)
    is_one_rate = max(one, other) < _ONE_RATE * min(one, other)
    return joint if is_one_rate and np.median(fit.misfit) < _MERGED_MISFIT * limit else None


def split(
    views: BodyViews, key: Ints, movers: Sequence[Mover], own_fit: OwnFit, next_key: int, config: BodiesConfig
) -> tuple[Ints, list[Mover], int]:
    """Parts of a mover that do not hang together in the picture, or lie at other depths, are movers of their own.

    The largest part keeps the number. Tracks without a rate in ``own_fit`` may lie anywhere.
    """
    number = numbers_of(key, movers)
    own = np.flatnonzero(np.bincount(number, minlength=len(movers) + 1)[number] * (number > 0) >= 2 * config.min_tracks)
    if not len(own):
        return key, list(movers), next_key
    body, key, all_movers = number[own] - 1, key.copy(), list(movers)
    rate_hz = np.maximum(np.nan_to_num(own_fit.rate_hz[own]), _TINY_HZ)
    log_rate, unsure = np.log(rate_hz), np.nan_to_num(own_fit.rate_sigma_hz[own] / rate_hz, nan=np.inf)
    one, other = linked_pairs(views.xy_px[own], views.link_px).T
    apart = np.abs(log_rate[one] - log_rate[other])
    is_one = (body[one] == body[other]) & (apart < np.log(_ONE_RATE) + 2.0 * (unsure[one] + unsure[other]))
    label = connected_parts(np.ones(len(own), dtype=bool), np.column_stack([one, other])[is_one])
    counts = np.bincount(label)
    first = np.unique(label, return_index=True)[1]
    mover_of, last = body[first], -1
    for part in np.lexsort((-counts, mover_of)).tolist():
        if mover_of[part] != last:
            # The largest of this mover's parts.
            last = mover_of[part]
        elif counts[part] >= config.min_tracks:
            key[own[label == part]] = next_key
            all_movers.append(Mover(next_key, None, 1, 0, movers[last].body))
            next_key += 1
    return key, all_movers, next_key
