"""Movers that turn out to be one, and parts of one that turn out to be several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import BodiesConfig
from ttcvid.geometry.medians import medians
from ttcvid.model import Floats, Ints
from ttcvid.stages.belonging import Mover, numbers_of
from ttcvid.stages.bodies import Body, refined_movers
from ttcvid.stages.body_views import BodyViews, fit_on_movers
from ttcvid.stages.connected import linked_parts

# Two bodies, or two parts of one, are one where their rates differ by less than this factor.
_ONE_RATE = 1.5
# Two movers are one where one motion explains both at most this much worse than two, misfits below 1 being 1; before
# that is tried, the motion of the larger has to explain the smaller within this factor, at rates within the other.
_MERGED_MISFIT, _WORTH_TRYING, _PERHAPS_ONE_RATE = 2.0, 8.0, 3.0
_LEAST_MISFIT = 1.0
# Steps of refinement of two taken as one; so many tracks of each tell whether they are.
_JOINT_STEPS, _ENOUGH_TRACKS = 4, 60
# What was two in one frame is seldom one in the next: that is asked in the first frames, then ever more seldom, but
# every so many frames.
_YOUNG_FRAMES, _MERGE_FRAMES = 5, 4
_LEAST_TRACKS = 3
_TINY_HZ = 1e-9


@dataclass(frozen=True)
class _Pair:
    """Two neighbouring movers, their tracks, and the misfit that is usual in both, in units of the scene's."""

    large: Mover
    small: Mover
    of_large: Ints
    of_small: Ints
    limit: float = _LEAST_MISFIT


def merged(
    views: BodyViews, scene: Body, key: Ints, movers: Sequence[Mover], own_misfit: Floats, usual_misfit: float
) -> tuple[Ints, list[Mover]]:
    """Movers side by side that one motion explains are one; the older one's number stays.

    Parameters
    ----------
    own_misfit : (N,) of each track on its body, in units of ``usual_misfit``.
    """
    key = key.copy()
    alive = {mover.key: mover for mover in movers}
    pairs = _worth_trying(views, key, movers, own_misfit, usual_misfit)
    for pair, joint in zip(pairs, _joint(views, scene, pairs, usual_misfit), strict=True):
        large, small = alive.get(pair.large.key), alive.get(pair.small.key)
        if large is None or small is None:
            continue
        if large is not pair.large or small is not pair.small:
            # One of the two has just become one with another.
            of_large, of_small = np.flatnonzero(key == large.key), np.flatnonzero(key == small.key)
            (joint,) = _joint(views, scene, [_Pair(large, small, of_large, of_small, pair.limit)], usual_misfit)
        if joint is None:
            continue
        younger, older = sorted((large, small), key=lambda m: (m.n_found, -m.key))
        key[key == younger.key] = older.key
        alive[older.key] = replace(older, body=joint)
        del alive[younger.key]
    return key, list(alive.values())


def _worth_trying(
    views: BodyViews, key: Ints, movers: Sequence[Mover], own_misfit: Floats, usual_misfit: float
) -> list[_Pair]:
    """Neighbours that may be one."""
    number = numbers_of(key, movers)
    counts = np.bincount(number, minlength=len(movers) + 1)
    codes = number[:, None] * len(counts) + number[views.neighbours]
    touch = np.bincount(codes.ravel(), minlength=len(counts) ** 2).reshape(len(counts), len(counts))
    tracks_of = [np.flatnonzero(number == place + 1) for place in range(len(movers))]
    pairs = []
    for places in np.argwhere(np.triu(touch[1:, 1:], 1)).tolist():
        small, large = sorted(places, key=lambda place: (len(tracks_of[place]), -place))
        if len(tracks_of[small]) >= _LEAST_TRACKS and _is_asked(min(movers[large].n_found, movers[small].n_found)):
            pairs.append(_Pair(movers[large], movers[small], tracks_of[large], tracks_of[small]))
    if not pairs:
        return []
    few = np.repeat(np.arange(len(pairs)), [len(pair.of_small) for pair in pairs])
    points = views.points(np.concatenate([pair.of_small for pair in pairs]), few)
    fit = fit_on_movers(points, [pair.large.body for pair in pairs])
    known = np.isfinite(fit.rate_hz)
    rate_hz = medians(fit.rate_hz[known], few[known], len(pairs))
    usual_hz = np.array([pair.large.body.rate_hz for pair in pairs])
    is_one_rate = (rate_hz < _PERHAPS_ONE_RATE * usual_hz) & (rate_hz * _PERHAPS_ONE_RATE > usual_hz)
    off = medians(fit.misfit, few, len(pairs)) / usual_misfit
    both = np.repeat(np.arange(len(pairs)), [len(pair.of_large) + len(pair.of_small) for pair in pairs])
    own = np.concatenate([tracks for pair in pairs for tracks in (pair.of_large, pair.of_small)])
    limit = np.maximum(medians(own_misfit[own], both, len(pairs)), _LEAST_MISFIT)
    is_worth = is_one_rate & (off <= _WORTH_TRYING * limit)
    return [replace(pairs[place], limit=float(limit[place])) for place in np.flatnonzero(is_worth)]


def _is_asked(age: int) -> bool:
    """Whether two movers that have been found in so many frames may be taken as one."""
    is_power_of_two = age & (age - 1) == 0
    return age <= _YOUNG_FRAMES or is_power_of_two or age % _MERGE_FRAMES == 0


def _joint(views: BodyViews, scene: Body, pairs: Sequence[_Pair], usual_misfit: float) -> list[Body | None]:
    """The motion of each pair taken as one, None where they are two."""
    if not pairs:
        return []
    parts = [tracks[:: -(-len(tracks) // _ENOUGH_TRACKS)] for p in pairs for tracks in (p.of_large, p.of_small)]
    part = np.repeat(np.arange(len(parts)), [len(tracks) for tracks in parts])
    points = views.points(np.concatenate(parts), part // 2)
    joint = refined_movers([p.large.body for p in pairs], scene, points, np.full(len(pairs), _JOINT_STEPS))
    fit = points.fit(joint, None)
    # A track that has just been born has no rate yet.
    known = np.isfinite(fit.rate_hz)
    one, other = medians(fit.rate_hz[known], part[known], len(parts)).reshape(-1, 2).T
    is_one = np.maximum(one, other) < _ONE_RATE * np.minimum(one, other)
    limit = _MERGED_MISFIT * usual_misfit * np.array([p.limit for p in pairs])
    is_one &= medians(fit.misfit, points.body, len(pairs)) < limit
    return [body if fits else None for body, fits in zip(joint, is_one, strict=True)]


def split(
    views: BodyViews, key: Ints, movers: Sequence[Mover], next_key: int, config: BodiesConfig
) -> tuple[Ints, list[Mover], int]:
    """Parts of a mover that do not hang together in the picture, or lie at other depths, are movers of their own.

    The largest part keeps the number.
    """
    number = numbers_of(key, movers)
    own = np.flatnonzero(np.bincount(number, minlength=len(movers) + 1)[number] * (number > 0) >= 2 * config.min_tracks)
    if not len(own):
        return key, list(movers), next_key
    body, key, all_movers = number[own] - 1, key.copy(), list(movers)
    usual_hz = np.array([mover.body.rate_hz for mover in movers])[body]
    fit = views.points(own, body).fit([mover.body for mover in movers], usual_hz)
    rate_hz = np.maximum(np.nan_to_num(fit.rate_hz), _TINY_HZ)
    unsure = np.nan_to_num(fit.rate_sigma_hz / rate_hz, nan=np.inf)
    tolerance = 0.5 * np.log(_ONE_RATE) + 2.0 * unsure
    label = linked_parts(views.xy_px[own], views.link_px, body, np.log(rate_hz), tolerance)
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
