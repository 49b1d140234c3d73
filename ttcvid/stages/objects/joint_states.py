"""The states of objects: each that of its nearest well-supported surface, what is hit first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.rotation import cross
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.objects.nearest_surface import in_nearest_of_path, tracks_needed
from ttcvid.stages.objects.states import EXPANSION_NEIGHBOURS, SharedErrors, TrackStates, nothing_shared
from ttcvid.stages.tracking.groups import TrackSets

# Variance of a mean over the tracks within 2 sigma of it, relative to their count: the search for them is not free.
_TRIMMED_VARIANCE = 1.35
# Minimum number of tracks of an object that was found as one surface.
_LEAST_OF_SURFACE = 3
# The parts of a car's front lie in depths that differ by this (standard deviation, as a part of the distance).
_RELIEF = 0.025
# An object that turns faster has another velocity at each place. Its turn tells depths well, so that less of what lies
# behind its nearest tracks is mixed in.
_TURNS_RAD_S, _TURNING_RELIEF = 0.05, 0.01
# An end of a line is so many times the variance of its points away from its middle, squared.
_END_VARIANCE = 3.0
# Least variance of a rate, 1/s^2.
_TINY = 1e-24


@dataclass(frozen=True)
class JointStates:
    """States of K surfaces at their centroids ``ref_px (K, 2)``; ``owner (K,)`` says whose each of them is.

    ``abc_hz (K, 3)`` = V / Z with ``cov (K, 3, 3)`` in 1/s^2, of which ``place_cov`` comes from not knowing the very
    place.
    """

    owner: Ints
    ref_px: Floats
    abc_hz: Floats
    cov: Floats
    place_cov: Floats


def joint_states(
    members: TrackSets, direction: Floats, is_one: Bools, states: TrackStates, xy_px: Floats, link_px: float
) -> JointStates:
    """The state of the nearest surface of each object that has one: the weighted mean over its tracks.

    The nearest is the one with the largest rate speed / Z, whether it comes, goes or crosses. (Of a thing that
    approaches, the largest rate is also the largest 1 / ttc_z. Of one that recedes it is the smallest, and one that
    crosses has none: its tracks would make no surfaces.) What the tracks have in common moves all surfaces alike, and
    does not make one of two (it may, where else nothing would have support: `in_nearest_of_path`); but no surface is
    flat.

    Parameters
    ----------
    members, direction, is_one
        Of N objects: their tracks, ``dir (N, 3)``, NaN where there is none, and (N,) which were found as one surface.
    states, xy_px, link_px
        Of all tracks, as for `in_nearest_of_path`.
    """
    shared = nothing_shared(len(states.xy)) if states.shared is None else states.shared
    has_direction = np.isfinite(direction[:, 0])
    sets, owner = members.where(states.has_value[members.index] & has_direction[members.set_of])
    path = _paths_of(sets, shared)
    rate_hz, variance, by_shared = _rates(sets, direction[owner], states, shared)
    turns = (path >= 0) & (np.linalg.norm(shared.turn_rad_s, axis=1) > _TURNS_RAD_S)[path]
    relief = np.where(turns, _TURNING_RELIEF, _RELIEF)[sets.set_of]
    sigma_hz = np.sqrt(variance + (relief * rate_hz) ** 2)
    needed = tracks_needed(members.lengths[owner])
    is_in = in_nearest_of_path(rate_hz, sigma_hz, by_shared, shared.cov[path], xy_px[sets.index], sets, needed, link_px)
    has_surface = np.bincount(sets.set_of[is_in], minlength=len(sets)) > 0
    # What was found as one surface may have few tracks.
    takes_all = ~has_surface & is_one[owner] & (sets.lengths >= _LEAST_OF_SURFACE)
    surfaces, left = sets.where(is_in | takes_all[sets.set_of])
    weight = 1.0 / np.maximum(states.cov[surfaces.index, 2, 2], _TINY)
    weight /= surfaces.sums(weight)[surfaces.set_of]
    abc_hz = surfaces.sums(weight[:, None] * states.abc_hz[surfaces.index])
    ref_px = surfaces.sums(weight[:, None] * xy_px[surfaces.index])
    cov, place_cov = _covariances(surfaces, weight, states)
    return JointStates(owner[left], ref_px, abc_hz, cov + place_cov, place_cov)


def _paths_of(sets: TrackSets, shared: SharedErrors) -> Ints:
    """The path (K,) of each set, -1 for none; tracks timed by expansion have none."""
    return np.asarray(np.maximum.reduceat(shared.path_of[sets.index], sets.first))


def _rates(
    sets: TrackSets, direction: Floats, states: TrackStates, shared: SharedErrors
) -> tuple[Floats, Floats, Floats]:
    """Speed over depth of M tracks (M,), 1/s, its variance by their own noise, and what shared errors do to it (M, 9).

    On a path the speed is one for all of its points: those of a turning thing have velocities of their own, and still
    the nearest has the largest rate. For other tracks it is the speed along the ``direction (K, 3)`` of the object.
    """
    index, along, has_path = sets.index, direction[sets.set_of], shared.path_of[sets.index] >= 0
    rate_hz = np.where(has_path, shared.rate_hz[index], np.einsum("mi,mi->m", along, states.abc_hz[index]))
    own = np.einsum("mi,mij,mj->m", along, states.cov[index], along)
    variance = np.where(has_path, shared.rate_variance[index], own)
    return rate_hz, variance, np.where(has_path[:, None], shared.rate_jacobian[index], 0.0)


def _covariances(surfaces: TrackSets, weight: Floats, states: TrackStates) -> tuple[Floats, Floats]:
    """Covariances (K, 3, 3) of weighted means of (a, b, c), by noise and by place.

    Own noise averages out, errors of what they share do not. Tracks of a surface share one path, but for those timed by
    expansion: each of these is in the neighbourhoods of others, which err with it. Where each track has a direction of
    its own (three frames), nothing is common. What turns has another velocity at each of its places, and which of them
    is the nearest is not known: it may be any end of the surface.
    """
    index, set_of, shared = surfaces.index, surfaces.set_of, states.shared
    squared_cov = (weight**2)[:, None, None] * states.cov[index]
    if shared is None:
        return _TRIMMED_VARIANCE * surfaces.sums(squared_cov), np.zeros((len(surfaces), 3, 3))
    path = _paths_of(surfaces, shared)
    has_path, is_off = path >= 0, shared.path_of[index] < 0
    own = surfaces.sums(np.where(is_off, 0.0, weight**2 * shared.rate_variance[index]))
    by_shared = surfaces.sums(np.where(is_off[:, None, None], 0.0, weight[:, None, None] * shared.jacobian[index]))
    along = shared.along[path]
    on_path = _TRIMMED_VARIANCE * own[:, None, None] * along[:, :, None] * along[:, None, :]
    on_path += by_shared @ shared.cov[path] @ np.swapaxes(by_shared, 1, 2)
    # No more than a neighbourhood of them errs together.
    off_weight = np.where(is_off, weight, 0.0)
    squares = surfaces.sums(off_weight**2)
    together = np.minimum(surfaces.sums(off_weight) ** 2 / np.maximum(squares, _TINY), EXPANSION_NEIGHBOURS)
    cov = together[:, None, None] * surfaces.sums(np.where(is_off[:, None, None], squared_cov, 0.0))
    cov += np.where(has_path[:, None, None], on_path, 0.0)
    xy = states.xy[index]
    offset = np.zeros((len(index), 3))
    offset[:, :2] = xy - surfaces.sums(weight[:, None] * xy)[set_of]
    by_place = cross(np.where(has_path[:, None], shared.turn_rad_s[path], 0.0)[set_of], offset)
    place = (_END_VARIANCE * weight)[:, None, None] * by_place[:, :, None] * by_place[:, None, :]
    return cov, surfaces.sums(place)
