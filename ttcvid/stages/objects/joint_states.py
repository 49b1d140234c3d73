"""States of objects: of the nearest well-supported surface, which is hit first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.estimation.shared_trajectory import N_SHARED
from ttcvid.geometry.rotation import cross, skew
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.objects.nearest_surface import in_nearest_surface, tracks_needed
from ttcvid.stages.objects.states import EXPANSION_NEIGHBOURS, SharedErrors, TrackStates, nothing_shared
from ttcvid.stages.tracking.groups import TrackSets

# Variance of a mean over the tracks within 2 sigma of it, relative to their count: the search for them is not free.
_TRIMMED_VARIANCE = 1.35
# Minimum number of tracks of an object that was found as one surface.
_LEAST_OF_SURFACE = 3
# Standard deviation of the depths on the front of a car, as a share of its distance.
_RELIEF = 0.025
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
    acceleration_hz2, closing_cov : ``(K,)`` acceleration along the optical axis over Z, NaN where it is not known, and
        the covariance ``(K, 2, 2)`` of c and of it.
    """

    owner: Ints
    ref_px: Floats
    ref_sigma: Floats
    abc_hz: Floats
    cov: Floats
    acceleration_hz2: Floats
    closing_cov: Floats


def joint_states(
    members: TrackSets, direction: Floats, is_one: Bools, states: TrackStates, xy_px: Floats, link_px: float
) -> JointStates:
    """State of the nearest surface of each of N objects that has one: the weighted mean over its tracks.

    The nearest surface has the largest inverse depth (speed / Z), for any direction of motion: 1 / ttc_z orders the
    depths of approaching objects only. Errors common to all tracks shift all surfaces alike and do not count in their
    separation.

    Parameters
    ----------
    members, direction : tracks of the objects, and ``(N, 3)`` their ``dir``, NaN where there is none.
    is_one : ``(N,)`` found as one surface, and so may have few tracks.
    """
    shared = nothing_shared(len(states.xy)) if states.shared is None else states.shared
    has_direction = np.isfinite(direction[:, 0])
    sets, owner = members.where(states.has_value[members.index] & has_direction[members.set_of])
    path = _paths_of(sets, shared)
    rate_hz, variance, by_shared = _rates(sets, direction[owner], states, shared)
    sigma_hz = np.sqrt(variance + (_RELIEF * rate_hz) ** 2)
    needed = tracks_needed(members.lengths[owner])
    is_in = in_nearest_surface(rate_hz, sigma_hz, xy_px[sets.index], sets, needed, link_px)
    above_hz = np.zeros(len(rate_hz))
    for k in np.flatnonzero((path >= 0) & (sets.lengths >= _LEAST_OF_SIDE)):
        own = slice(sets.first[k], sets.first[k] + sets.lengths[k])
        side_hz, is_near = _near_end(states.xy[sets.index[own]], rate_hz[own], sigma_hz[own])
        if is_near.any():
            is_in[own], above_hz[own] = is_near, side_hz - rate_hz[own]
    has_surface = np.bincount(sets.set_of[is_in], minlength=len(sets)) > 0
    takes_all = ~has_surface & is_one[owner] & (sets.lengths >= _LEAST_OF_SURFACE)
    is_in |= takes_all[sets.set_of]
    surfaces, left = sets.where(is_in)
    weight = 1.0 / np.maximum(states.cov[surfaces.index, 2, 2], _TINY)
    weight /= surfaces.sums(weight)[surfaces.set_of]
    abc_hz = surfaces.sums(weight[:, None] * states.abc_hz[surfaces.index])
    way = np.where((path >= 0)[:, None], shared.along[path], direction[owner])[left]
    abc_hz += surfaces.sums(weight * above_hz[is_in])[:, None] * way
    ref_px = surfaces.sums(weight[:, None] * xy_px[surfaces.index])
    ref = surfaces.sums(weight[:, None] * states.xy[surfaces.index])
    off_ref = states.xy[surfaces.index] - ref[surfaces.set_of]
    cov = _covariances(surfaces, weight, off_ref, states)
    ref_sigma = np.sqrt(surfaces.sums((weight[:, None] * off_ref) ** 2))
    surface_hz = surfaces.sums(weight * (rate_hz + above_hz)[is_in])
    of_tracks = variance[is_in], by_shared[is_in]
    closing = _accelerations(surfaces, weight, surface_hz, *of_tracks, cov[:, 2, 2], shared)
    return JointStates(owner[left], ref_px, ref_sigma, abc_hz, cov, *closing)


def _accelerations(
    surfaces: TrackSets,
    weight: Floats,
    rate_hz: Floats,
    variance: Floats,
    rate_jacobian: Floats,
    c_variance: Floats,
    shared: SharedErrors,
) -> tuple[Floats, Floats]:
    """`JointStates.acceleration_hz2` and ``closing_cov`` of surfaces with the inverse depths ``rate_hz (K,)``, 1/s.

    ``variance (M,), rate_jacobian (M, 12)`` are those of `_rates`, ``c_variance (K,)`` is that of c.
    """
    path, is_off = _paths_of(surfaces, shared), shared.path_of[surfaces.index] < 0
    along, turn = shared.along[path], shared.turn_rad_s[path]
    # The views of what turns are turned back, and show A - 2 turn x V.
    bend_hz = (shared.bend_hz[path] + 2.0 * cross(turn, along))[:, 2]
    by_shared = np.empty((len(path), 2, N_SHARED))
    by_c = weight[:, None] * shared.jacobian[surfaces.index, 2]
    by_shared[:, 0] = surfaces.sums(np.where(is_off[:, None], 0.0, by_c))
    by_shared[:, 1] = bend_hz[:, None] * surfaces.sums(weight[:, None] * rate_jacobian)
    by_shared[:, 1, :3] += 2.0 * rate_hz[:, None] * skew(turn)[:, 2]
    by_shared[:, 1, 5] += rate_hz
    by_shared[:, 1, 6:9] -= 2.0 * rate_hz[:, None] * skew(along)[:, 2]
    own = np.stack([along[:, 2], bend_hz], axis=1)
    variance = _TRIMMED_VARIANCE * surfaces.sums(weight**2 * variance)
    cov = by_shared @ shared.cov[path] @ np.swapaxes(by_shared, 1, 2)
    cov += variance[:, None, None] * own[:, :, None] * own[:, None, :]
    cov[:, 0, 0] = c_variance
    return np.where(path >= 0, rate_hz * bend_hz, np.nan), cov


def _paths_of(sets: TrackSets, shared: SharedErrors) -> Ints:
    """Index of the trajectory of each set, ``(K,)``; -1 for none (tracks timed by expansion)."""
    return np.asarray(np.maximum.reduceat(shared.path_of[sets.index], sets.first))


def _rates(
    sets: TrackSets, direction: Floats, states: TrackStates, shared: SharedErrors
) -> tuple[Floats, Floats, Floats]:
    """Inverse depths (speed over depth) of M tracks: value, variance by own noise, Jacobian by shared errors (M, 12).

    On a trajectory all points share one speed, on a turning body too, so that the nearest has the largest one. For
    other tracks it is the speed along the ``direction (K, 3)`` of the object, over depth. In 1/s.
    """
    index, along, has_path = sets.index, direction[sets.set_of], shared.path_of[sets.index] >= 0
    rate_hz = np.where(has_path, shared.rate_hz[index], np.einsum("mi,mi->m", along, states.abc_hz[index]))
    own = np.einsum("mi,mij,mj->m", along, states.cov[index], along)
    variance = np.where(has_path, shared.rate_variance[index], own)
    return rate_hz, variance, np.where(has_path[:, None], shared.rate_jacobian[index], 0.0)


def _near_end(xy: Floats, rate_hz: Floats, sigma_hz: Floats) -> tuple[Floats, Bools]:
    """Rates (M,), 1/s, of the visible side of an object, and which tracks are its near end (none: no side).

    Inverse depths on a plane are linear in the image. A selection by the tracks' own rates would select the largest
    errors. ``xy (M, 2)`` are its tracks' places in the plane z = 1, ``rate_hz, sigma_hz (M,)`` rates and standard
    deviations.
    """
    columns = np.column_stack([np.ones(len(xy)), xy - np.mean(xy, axis=0)])
    side_hz = np.full(len(xy), float(np.median(rate_hz)))
    belief = np.diag([0.0, 1.0, 1.0]) / (_SIDE_SLOPE * side_hz[0]) ** 2
    for _ in range(_SIDE_STEPS):
        off = (rate_hz - side_hz) / (_SIDE_SIGMAS * sigma_hz)
        weighted = columns / (sigma_hz**2 * (1.0 + off**2))[:, None]
        cov = np.linalg.inv(columns.T @ weighted + belief)
        plane = cov @ (weighted.T @ rate_hz)
        side_hz = columns @ plane
    is_on = np.abs(rate_hz - side_hz) < _SIDE_SIGMAS * sigma_hz
    is_side = plane[1:] @ np.linalg.solve(cov[1:, 1:], plane[1:]) > _SIDE_CHI2
    if not is_side or np.count_nonzero(is_on) < max(_LEAST_OF_SIDE, _PART_OF_SIDE * len(is_on)):
        return side_hz, np.zeros(len(xy), dtype=bool)
    nearest_hz = float(np.quantile(side_hz[is_on], 1.0 - _NEAR_PART))
    return side_hz, is_on & (side_hz >= nearest_hz - _NEAR_DEPTH * abs(nearest_hz))


def _covariances(surfaces: TrackSets, weight: Floats, off_ref: Floats, states: TrackStates) -> Floats:
    """Covariances ``(K, 3, 3)`` of the weighted means of (a, b, c), by noise and by place, 1/s^2.

    Own noise averages out, shared errors do not. Tracks of a surface share the errors of one trajectory; those timed by
    expansion share them with the tracks in whose neighbourhoods they are; tracks with directions of their own (three
    frames) share none. The velocity of a turning object varies with the place, and the nearest may be either end.
    ``off_ref (M, 2)`` are the places of the tracks about their mean.
    """
    index, set_of, shared = surfaces.index, surfaces.set_of, states.shared
    squared_cov = (weight**2)[:, None, None] * states.cov[index]
    if shared is None:
        return _TRIMMED_VARIANCE * surfaces.sums(squared_cov)
    path = _paths_of(surfaces, shared)
    has_path, is_off = path >= 0, shared.path_of[index] < 0
    own = surfaces.sums(np.where(is_off, 0.0, weight**2 * shared.rate_variance[index]))
    by_shared = surfaces.sums(np.where(is_off[:, None, None], 0.0, weight[:, None, None] * shared.jacobian[index]))
    along = shared.along[path]
    on_path = _TRIMMED_VARIANCE * own[:, None, None] * along[:, :, None] * along[:, None, :]
    on_path += by_shared @ shared.cov[path] @ np.swapaxes(by_shared, 1, 2)
    # At most a neighbourhood of them has common errors.
    off_weight = np.where(is_off, weight, 0.0)
    squares = surfaces.sums(off_weight**2)
    together = np.minimum(surfaces.sums(off_weight) ** 2 / np.maximum(squares, _TINY), EXPANSION_NEIGHBOURS)
    cov = together[:, None, None] * surfaces.sums(np.where(is_off[:, None, None], squared_cov, 0.0))
    cov += np.where(has_path[:, None, None], on_path, 0.0)
    offset = np.column_stack([off_ref, np.zeros(len(index))])
    by_place = cross(np.where(has_path[:, None], shared.turn_rad_s[path], 0.0)[set_of], offset)
    place = (_END_VARIANCE * weight)[:, None, None] * by_place[:, :, None] * by_place[:, None, :]
    return np.asarray(cov + surfaces.sums(place))
