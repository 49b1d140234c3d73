"""The states of objects: each that of its nearest well-supported surface, what is hit first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.sets import TrackSets
from ttcvid.stages.surfaces import in_nearest_surface
from ttcvid.stages.track_states import TrackStates, has_value

# Variance of a mean over the tracks within 2 sigma of it, relative to their count: the search for them is not free.
_TRIMMED_VARIANCE = 1.35
# Tracks that tell when a thing is reached that is one surface.
_LEAST_OF_SURFACE = 3
# The parts of a car's front lie in depths that differ by this (standard deviation, as a part of the distance).
_RELIEF = 0.025
# Least variance of a rate, 1/s^2.
_TINY = 1e-24


@dataclass(frozen=True)
class JointStates:
    """States of K surfaces at their centroids ``ref_px (K, 2)``; ``owner (K,)`` says whose each of them is.

    ``abc_hz (K, 3)`` = V / Z with ``cov (K, 3, 3)`` in 1/s^2, ``speed_change (K,)`` by what part the speed may change.
    """

    owner: Ints
    ref_px: Floats
    abc_hz: Floats
    cov: Floats
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
    surfaces, owner = _nearest_surfaces(members, direction, is_static, states, xy_px, link_px)
    index = surfaces.index
    weight = 1.0 / np.maximum(states.cov[index, 2, 2], _TINY)
    weight /= surfaces.sums(weight)[surfaces.set_of]
    abc_hz = surfaces.sums(weight[:, None] * states.abc_hz[index])
    cov, speed_change = _joint_covariances(states, surfaces, weight, abc_hz)
    return JointStates(owner, surfaces.sums(weight[:, None] * xy_px[index]), abc_hz, cov, speed_change)


def _nearest_surfaces(
    members: TrackSets, direction: Floats, is_static: Bools, states: TrackStates, xy_px: Floats, link_px: float
) -> tuple[TrackSets, Ints]:
    """The tracks of the nearest surfaces: those with the largest rate speed / Z, whether it comes, goes or crosses.

    (Of a thing that approaches, the largest rate is also the largest 1 / ttc_z. Of one that recedes it is the smallest,
    and one that crosses has none: its tracks would make no surfaces.) What the tracks have in common moves all surfaces
    alike, and does not make one of two; but no surface is flat.
    """
    is_usable = has_value(states.status[members.index]) & np.isfinite(direction[members.set_of, 0])
    usable, owner = members.where(is_usable)
    if not len(usable):
        return usable, owner
    along = direction[owner[usable.set_of]]
    rate_hz = np.sum(states.abc_hz[usable.index] * along, axis=1)
    sigma_hz = np.hypot(states.own_sigma_along(along, usable.index), _RELIEF * rate_hz)
    is_in = in_nearest_surface(rate_hz, sigma_hz, xy_px[usable.index], usable, members.lengths[owner], link_px)
    # What stands in our way was found as one surface, and may have few tracks.
    has_none = usable.sums(is_in.astype(np.int64)) == 0
    is_whole = has_none & is_static[owner] & (usable.lengths >= _LEAST_OF_SURFACE)
    surfaces, left = usable.where(is_in | is_whole[usable.set_of])
    return surfaces, owner[left]


def _joint_covariances(
    states: TrackStates, surfaces: TrackSets, weight: Floats, abc_hz: Floats
) -> tuple[Floats, Floats]:
    """Covariances of weighted means of (a, b, c), and by what part the speeds that the tracks share may change.

    Own noise averages out, errors of what they share do not. Tracks of a surface share one path, but for those timed by
    expansion: their neighbourhoods overlap, so that they are taken to err as one. Where each track has a direction of
    its own (three frames), nothing is common.
    """
    shared = states.shared
    if shared is None:
        return _averaged_out(states, surfaces, weight), np.zeros(len(surfaces))
    number = np.maximum.reduceat(shared.path_of[surfaces.index], surfaces.first)
    on_path = shared.path_of[surfaces.index] == number[surfaces.set_of]
    has_path = number >= 0
    on_path &= has_path[surfaces.set_of]
    cov = shared.covariances_of_means(surfaces, np.where(on_path, weight, 0.0), abc_hz, number, _TRIMMED_VARIANCE)
    off_weight = np.where(on_path, 0.0, weight)
    off_cov = surfaces.sums(off_weight[:, None, None] * states.cov[surfaces.index])
    cov = np.where(has_path[:, None, None], cov, 0.0) + surfaces.sums(off_weight)[:, None, None] * off_cov
    return cov, np.where(has_path, shared.change[number], 0.0)


def _averaged_out(states: TrackStates, surfaces: TrackSets, weight: Floats) -> Floats:
    return _TRIMMED_VARIANCE * surfaces.sums((weight**2)[:, None, None] * states.cov[surfaces.index])
