"""States of objects: of the nearest well-supported surface, which is hit first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.rotation import cross
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.objects.nearest_surface import in_nearest_surface, tracks_needed
from ttcvid.stages.objects.states import EXPANSION_NEIGHBOURS, SharedErrors, TrackStates
from ttcvid.stages.tracking.groups import TrackSets

# Variance of a mean over the tracks within 2 sigma of it, relative to their count: the search for them is not free.
_TRIMMED_VARIANCE = 1.35
# Minimum number of tracks of an object that was found as one surface.
_LEAST_OF_SURFACE = 3
# Standard deviation of the depths on what is hit first, as a share of its distance: 0.2 m at 15 m. Twice that takes the
# middle of a bicycle seen from behind for its end, half of that takes a few points for a surface.
_RELIEF = 0.012
# Where nothing is supported at that, so much is tried: the tracks of a thing near by, of which each has a depth of its
# own, are known better than they agree.
_WIDER_RELIEFS = 0.036, 0.108
# A side has at least so many tracks, and this part of the object's. Its slope has a chi-square (two degrees of freedom)
# above the third: noise exceeds 14 once in a thousand, but neighbours on the rear of a car share its relief.
_LEAST_OF_SIDE, _PART_OF_SIDE, _SIDE_CHI2 = 8, 0.8, 40.0
# Prior of the slope of its rate over the rate: the tangent of up to 45 deg (standard deviation, per component).
_SIDE_SLOPE = 0.5
# Its near end is this share of its tracks, with those that are farther by no more than this share of the distance.
_NEAR_PART, _NEAR_DEPTH = 0.1, 0.01
# Inliers of a side are within so many standard deviations; iterations of the robust fit.
_SIDE_SIGMAS, _SIDE_STEPS = 2.0, 5
# Squared distance of the end of a line from its middle over the variance of its points.
_END_VARIANCE = 3.0
# Least variance of a rate, 1/s^2.
_TINY = 1e-24


@dataclass(frozen=True)
class JointStates:
    """States of K surfaces.

    owner : ``(K,)`` index of the object.
    ref_px, ref_sigma : ``(K, 2)`` centroid, and its standard error in the plane z = 1: few points of it are tracked.
    abc_hz, cov : ``(K, 3)`` V / Z and its covariance ``(K, 3, 3)``, 1/s^2.
    """

    owner: Ints
    ref_px: Floats
    ref_sigma: Floats
    abc_hz: Floats
    cov: Floats


def joint_states(
    members: TrackSets, direction: Floats, is_one: Bools, states: TrackStates, xy_px: Floats, link_px: float
) -> JointStates:
    """State of the nearest surface of each of N objects that has one: the weighted mean over its tracks.

    The nearest surface has the largest inverse depth (speed / Z), for any direction of motion: 1 / ttc_z orders the
    depths of approaching objects only. Errors common to all tracks shift all surfaces alike and separate none.

    Parameters
    ----------
    members, direction : tracks of the objects, and ``(N, 3)`` their ``dir``, NaN where there is none.
    is_one : ``(N,)`` found as one surface, and so may have few tracks.
    """
    shared = states.common
    has_direction = np.isfinite(direction[:, 0])
    sets, owner = members.where(states.has_value[members.index] & has_direction[members.set_of])
    path = _paths_of(sets, shared)
    rate_hz, own_hz = own_rates(sets.index, direction[owner][sets.set_of], states)
    sigma_hz = np.hypot(own_hz, _RELIEF * rate_hz)
    n_tracks = members.lengths[owner]
    needed = tracks_needed(n_tracks)
    # Half of a thing, as a street that is taken for one has all depths; never where it was found as one surface.
    wider = np.maximum(needed, np.where(is_one[owner], n_tracks + 1, n_tracks // 2))
    is_in, is_deep = _nearest_surfaces(sets, rate_hz, own_hz, needed, wider, xy_px[sets.index], link_px)
    may_show = (path >= 0) & (sets.lengths >= _LEAST_OF_SIDE)
    above_hz = np.zeros(len(rate_hz))
    if may_show.any():
        asked = np.flatnonzero(may_show[sets.set_of])
        of_asked, _ = sets.where(may_show[sets.set_of])
        side_hz, is_near, is_side = _near_ends(of_asked, states.xy, rate_hz[asked], sigma_hz[asked])
        shown = asked[is_side]
        is_in[shown], above_hz[shown] = is_near[is_side], side_hz[is_side] - rate_hz[shown]
        is_deep[sets.set_of[shown]] = False
    has_surface = np.bincount(sets.set_of[is_in], minlength=len(sets)) > 0
    is_deep &= has_surface
    takes_all = ~has_surface & is_one[owner] & (sets.lengths >= _LEAST_OF_SURFACE)
    is_in |= takes_all[sets.set_of]
    surfaces, left = sets.where(is_in)
    weight = 1.0 / np.maximum(states.cov[surfaces.index, 2, 2], _TINY)
    weight /= surfaces.sums(weight)[surfaces.set_of]
    means = [xy_px[surfaces.index], states.xy[surfaces.index], states.abc_hz[surfaces.index]]
    ref_px, ref, abc_hz = np.split(surfaces.sums(weight[:, None] * np.hstack(means)), [2, 4], axis=1)
    up_hz = surfaces.sums(weight * above_hz[is_in])
    abc_hz += up_hz[:, None] * np.where((path >= 0)[:, None], shared.along[path], direction[owner])[left]
    off_ref = states.xy[surfaces.index] - ref[surfaces.set_of]
    ref_sigma = np.sqrt(surfaces.sums((weight[:, None] * off_ref) ** 2))
    cov = _covariances(surfaces, weight, off_ref, own_hz[is_in], states)
    # It may be nearer by as much as one of its tracks is, beyond that one's noise.
    mean_hz = surfaces.sums(weight * rate_hz[is_in])
    nearer = np.maximum.reduceat((rate_hz - own_hz)[is_in], surfaces.first) / mean_hz - 1.0
    nearer = np.where(is_deep[left], np.maximum(nearer, 0.0), 0.0)
    cov += (nearer**2)[:, None, None] * abc_hz[:, :, None] * abc_hz[:, None, :]
    return JointStates(owner[left], ref_px, ref_sigma, abc_hz, cov)


def _nearest_surfaces(
    sets: TrackSets, rate_hz: Floats, own_hz: Floats, needed: Ints, wider: Ints, xy_px: Floats, link_px: float
) -> tuple[Bools, Bools]:
    """Tracks ``(M,)`` of the nearest surface of each of K sets, by the least relief at which one is supported.

    And where that is more than `_RELIEF`, ``(K,)``: there any of them may be what is hit first. ``needed (K,)`` tracks
    support it at first, at a wider relief ``wider (K,)``.
    """
    is_in, is_deep = np.zeros(len(rate_hz), dtype=bool), np.zeros(len(sets), dtype=bool)
    for relief in (_RELIEF, *_WIDER_RELIEFS):
        lacks = (np.bincount(sets.set_of, is_in, len(sets)) == 0.0)[sets.set_of]
        if not lacks.any():
            break
        asked, left = sets.where(lacks)
        sigma_hz = np.hypot(own_hz[lacks], relief * rate_hz[lacks])
        is_in[lacks] = in_nearest_surface(rate_hz[lacks], sigma_hz, xy_px[lacks], asked, needed[left], link_px)
        is_deep[left], needed = relief > _RELIEF, wider
    return is_in, is_deep


def _paths_of(sets: TrackSets, shared: SharedErrors) -> Ints:
    """Index of the trajectory of each set, ``(K,)``; -1 for none (tracks timed by expansion)."""
    return np.asarray(np.maximum.reduceat(shared.path_of[sets.index], sets.first))


def own_rates(index: Ints, along: Floats, states: TrackStates) -> tuple[Floats, Floats]:
    """Inverse depths (speed over depth) of tracks ``index (M,)`` and their standard deviations by own noise, 1/s.

    On a trajectory all points share one speed, on a turning body too, so that the nearest has the largest one. For
    other tracks it is the speed along the direction ``along (M, 3)``, over depth.
    """
    shared = states.common
    has_path = shared.path_of[index] >= 0
    rate_hz = np.where(has_path, shared.rate_hz[index], np.einsum("mi,mi->m", along, states.abc_hz[index]))
    own = np.einsum("mi,mij,mj->m", along, states.cov[index], along)
    return rate_hz, np.sqrt(np.where(has_path, shared.rate_variance[index], own))


def _near_ends(sets: TrackSets, xy: Floats, rate_hz: Floats, sigma_hz: Floats) -> tuple[Floats, Bools, Bools]:
    """Rates (M,), 1/s, on the visible side of each object, which tracks are its near end, and of objects with a side.

    Inverse depths on a plane are linear in the image. A selection by the tracks' own rates would select the largest
    errors. ``xy (N, 2)`` are the places of all tracks in the plane z = 1, ``rate_hz, sigma_hz (M,)`` rates and standard
    deviations of those in the ``sets``.
    """
    set_of, xy = sets.set_of, xy[sets.index]
    columns = np.column_stack([np.ones(len(xy)), xy - (sets.sums(xy) / sets.lengths[:, None])[set_of]])
    usual_hz = sets.medians(rate_hz)
    side_hz = usual_hz[set_of]
    belief = np.diag([0.0, 1.0, 1.0]) / (_SIDE_SLOPE * usual_hz[:, None, None]) ** 2
    for _ in range(_SIDE_STEPS):
        off = (rate_hz - side_hz) / (_SIDE_SIGMAS * sigma_hz)
        weighted = columns / (sigma_hz**2 * (1.0 + off**2))[:, None]
        cov = np.linalg.inv(sets.sums(columns[:, :, None] * weighted[:, None]) + belief)
        plane = np.einsum("kij,kj->ki", cov, sets.sums(weighted * rate_hz[:, None]))
        side_hz = np.einsum("mi,mi->m", columns, plane[set_of])
    is_on = np.abs(rate_hz - side_hz) < _SIDE_SIGMAS * sigma_hz
    chi2 = np.einsum("ki,kij,kj->k", plane[:, 1:], np.linalg.inv(cov[:, 1:, 1:]), plane[:, 1:])
    n_on = np.bincount(set_of, is_on, len(sets))
    is_side = (chi2 > _SIDE_CHI2) & (n_on >= np.maximum(_LEAST_OF_SIDE, _PART_OF_SIDE * sets.lengths))
    nearest_hz = np.full(len(sets), np.nan)
    for k in np.flatnonzero(is_side):
        nearest_hz[k] = np.quantile(side_hz[is_on & (set_of == k)], 1.0 - _NEAR_PART)
    is_near = is_on & (side_hz >= (nearest_hz - _NEAR_DEPTH * np.abs(nearest_hz))[set_of])
    return side_hz, is_near, is_side[set_of]


def _covariances(surfaces: TrackSets, weight: Floats, off_ref: Floats, own_hz: Floats, states: TrackStates) -> Floats:
    """`JointStates.cov` of weighted means, by noise and by place.

    Own noise averages out, shared errors do not. Tracks of a surface share the errors of one trajectory; those timed by
    expansion share them with the tracks in whose neighbourhoods they are; tracks with directions of their own (three
    frames) share none. The velocity of a turning object varies with the place, and the nearest may be either end.
    ``off_ref (M, 2)`` are the places of the tracks about their mean, and ``own_hz (M,)`` the standard deviations of
    `own_rates` of the tracks, 1/s.
    """
    index, set_of, shared = surfaces.index, surfaces.set_of, states.common
    path, is_off = _paths_of(surfaces, shared), shared.path_of[index] < 0
    has_path, off_weight = path >= 0, np.where(is_off, weight, 0.0)
    along, turn = shared.along[path], np.where(has_path[:, None], shared.turn_rad_s[path], 0.0)
    by_shared = surfaces.sums(np.where(is_off[:, None, None], 0.0, weight[:, None, None] * shared.jacobian[index]))
    own_variance = _TRIMMED_VARIANCE * (weight * own_hz) ** 2
    on_path_variance = surfaces.sums(np.where(is_off, 0.0, own_variance))
    on_path = by_shared @ shared.cov[path] @ np.swapaxes(by_shared, 1, 2)
    on_path += on_path_variance[:, None, None] * along[:, :, None] * along[:, None, :]
    together = np.full(len(path), _TRIMMED_VARIANCE)
    if states.shared is not None:
        # At most a neighbourhood of them has common errors.
        squares = np.maximum(surfaces.sums(off_weight**2), _TINY)
        together = np.minimum(surfaces.sums(off_weight) ** 2 / squares, EXPANSION_NEIGHBOURS)
    own_cov = np.where(is_off[:, None, None], (weight**2)[:, None, None] * states.cov[index], 0.0)
    by_place = cross(turn[set_of], np.column_stack([off_ref, np.zeros(len(index))]))
    place = (_END_VARIANCE * weight)[:, None, None] * by_place[:, :, None] * by_place[:, None, :]
    cov = together[:, None, None] * surfaces.sums(own_cov) + surfaces.sums(place)
    return np.asarray(cov + np.where(has_path[:, None, None], on_path, 0.0))
