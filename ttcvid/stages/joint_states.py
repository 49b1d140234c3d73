"""The states of objects: each that of its nearest well-supported surface, what is hit first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.sets import TrackSets
from ttcvid.stages.slant import nearest_parts
from ttcvid.stages.surfaces import in_nearest_surface, tracks_needed
from ttcvid.stages.track_states import EXPANSION_NEIGHBOURS, TrackStates, has_value

# Variance of a mean over the tracks within 2 sigma of it, relative to their count: the search for them is not free.
_TRIMMED_VARIANCE = 1.35
# Tracks that tell when a thing is reached that is one surface.
_LEAST_OF_SURFACE = 3
# The parts of a car's front lie in depths that differ by this (standard deviation, as a part of the distance).
_RELIEF = 0.025
# An end of a line is so many times the variance of its points away from its middle, squared.
_END_VARIANCE = 3.0
# Least variance of a rate, 1/s^2.
_TINY = 1e-24


@dataclass(frozen=True)
class JointStates:
    """States of K surfaces at their centroids ``ref_px (K, 2)``; ``owner (K,)`` says whose each of them is.

    ``abc_hz (K, 3)`` = V / Z with ``cov (K, 3, 3)`` in 1/s^2, of which ``place_cov`` comes from not knowing the very
    place; ``speed_change (K,)`` by what part the speed may change.
    """

    owner: Ints
    ref_px: Floats
    abc_hz: Floats
    cov: Floats
    place_cov: Floats
    speed_change: Floats


def joint_states(
    members: TrackSets, direction: Floats, is_static: Bools, states: TrackStates, xy_px: Floats, link_px: float
) -> JointStates:
    """The state of the nearest surface of each object that has one.

    Parameters
    ----------
    members, direction, is_static
        Of N objects: their tracks, ``dir (N, 3)``, NaN where there is none, and (N,) which of them move with the scene.
    states, xy_px, link_px
        Of all tracks, as for `in_nearest_surface`.
    """
    surfaces, owner, above_hz, variance = _nearest_surfaces(members, direction, is_static, states, xy_px, link_px)
    index = surfaces.index
    along = states.along_paths(direction[owner[surfaces.set_of]], index)
    weight = 1.0 / np.maximum(states.cov[index, 2, 2], _TINY)
    weight /= surfaces.sums(weight)[surfaces.set_of]
    abc_hz = surfaces.sums(weight[:, None] * (states.abc_hz[index] + above_hz[:, None] * along))
    along = along[surfaces.first]
    cov, place_cov, speed_change = _joint_covariances(states, surfaces, weight, abc_hz, along, variance > 0.0)
    cov = cov + place_cov + _TRIMMED_VARIANCE * variance[:, None, None] * along[:, :, None] * along[:, None, :]
    return JointStates(owner, surfaces.sums(weight[:, None] * xy_px[index]), abc_hz, cov, place_cov, speed_change)


def _nearest_surfaces(
    members: TrackSets, direction: Floats, is_static: Bools, states: TrackStates, xy_px: Floats, link_px: float
) -> tuple[TrackSets, Ints, Floats, Floats]:
    """The tracks of the nearest surfaces: those with the largest rate speed / Z, whether it comes, goes or crosses.

    (Of a thing that approaches, the largest rate is also the largest 1 / ttc_z. Of one that recedes it is the smallest,
    and one that crosses has none: its tracks would make no surfaces.) What the tracks have in common moves all surfaces
    alike, and does not make one of two; but no surface is flat.

    Returns
    -------
    the surfaces, whose they are, and of `nearest_parts` by how much the rate of each track is too low, with variances.
    """
    is_usable = has_value(states.status[members.index]) & np.isfinite(direction[members.set_of, 0])
    usable, owner = members.where(is_usable)
    if not len(usable):
        return usable, owner, np.empty(0), np.empty(0)
    along = direction[owner[usable.set_of]]
    rate_hz, own_hz = states.rates_along(along, usable.index)
    sigma_hz = np.hypot(own_hz, _RELIEF * rate_hz)
    needed = tracks_needed(members.lengths[owner])
    is_in = in_nearest_surface(rate_hz, sigma_hz, xy_px[usable.index], usable, needed, link_px)
    is_in, above_hz, variance = nearest_parts(
        usable, rate_hz, own_hz, sigma_hz, *states.shared_rate_errors(usable), states.xy[usable.index], needed, is_in
    )
    # What stands in our way was found as one surface, and may have few tracks.
    has_none = usable.sums(is_in.astype(np.int64)) == 0
    is_whole = has_none & is_static[owner] & (usable.lengths >= _LEAST_OF_SURFACE)
    is_in |= is_whole[usable.set_of]
    surfaces, left = usable.where(is_in)
    return surfaces, owner[left], above_hz[is_in], variance[left]


def _joint_covariances(
    states: TrackStates, surfaces: TrackSets, weight: Floats, abc_hz: Floats, along: Floats, is_plane: Bools
) -> tuple[Floats, Floats, Floats]:
    """Covariances of weighted means of (a, b, c), by noise and by place, and by what part the speeds may change.

    Own noise averages out, errors of what they share do not. Tracks of a surface share one path, but for those timed by
    expansion: each of these is in the neighbourhoods of others, which err with it. Where each track has a direction of
    its own (three frames), nothing is common. What turns has another velocity at each of its places, and which of them
    is the nearest is not known: it may be any end of the surface. Where the rates along ``along`` (K, 3) are those of a
    plane, ``is_plane`` (K,), their noise is in its variance.
    """
    shared = states.shared
    place_cov = np.zeros((len(surfaces), 3, 3))
    if shared is None:
        return _averaged_out(states, surfaces, weight, along, is_plane), place_cov, np.zeros(len(surfaces))
    number = np.maximum.reduceat(shared.path_of[surfaces.index], surfaces.first)
    on_path = shared.path_of[surfaces.index] == number[surfaces.set_of]
    has_path = number >= 0
    on_path &= has_path[surfaces.set_of]
    own_factor = np.where(is_plane, 0.0, _TRIMMED_VARIANCE)
    cov = shared.covariances_of_means(surfaces, np.where(on_path, weight, 0.0), abc_hz, number, own_factor)
    cov = np.where(has_path[:, None, None], cov, 0.0) + _by_expansion(states, surfaces, np.where(on_path, 0.0, weight))
    if shared.turn_rad_s.any():
        by_place = shared.covariances_by_place(surfaces, weight, states.xy[surfaces.index], number)
        place_cov = np.where(has_path[:, None, None], _END_VARIANCE * by_place, 0.0)
    return cov, place_cov, np.where(has_path, shared.change[number], 0.0)


def _by_expansion(states: TrackStates, surfaces: TrackSets, weight: Floats) -> Floats:
    """Covariances (K, 3, 3) of what tracks timed by expansion add to means; ``weight (M,)`` is 0 for all others."""
    squares = surfaces.sums(weight**2)
    count = np.divide(surfaces.sums(weight) ** 2, squares, out=np.zeros(len(surfaces)), where=squares > 0.0)
    err_together = np.minimum(count, EXPANSION_NEIGHBOURS)
    return err_together[:, None, None] * surfaces.sums((weight**2)[:, None, None] * states.cov[surfaces.index])


def _averaged_out(states: TrackStates, surfaces: TrackSets, weight: Floats, along: Floats, is_plane: Bools) -> Floats:
    """Covariances (K, 3, 3) of means of tracks that have nothing in common; of a plane's, across ``along`` (K, 3)."""
    cov = _TRIMMED_VARIANCE * surfaces.sums((weight**2)[:, None, None] * states.cov[surfaces.index])
    across = np.eye(3) - np.where(is_plane[:, None, None], along[:, :, None] * along[:, None, :], 0.0)
    return np.asarray(across @ cov @ across)
