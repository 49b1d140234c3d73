"""The states of objects: each that of its nearest well-supported surface, what is hit first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.objects.nearest_surface import in_nearest_of_path, tracks_needed
from ttcvid.stages.objects.paper_track_states import EXPANSION_NEIGHBOURS, SharedErrors, TrackStates, nothing_shared
from ttcvid.stages.objects.slant import move_to_centres, nearest_parts
from ttcvid.stages.tracking.groups import TrackSets

# Variance of a mean over the tracks within 2 sigma of it, relative to their count: the search for them is not free.
_TRIMMED_VARIANCE = 1.35
# Tracks that tell when a thing is reached that is one surface.
_LEAST_OF_SURFACE = 3
# The parts of a car's front lie in depths that differ by this (standard deviation, as a part of the distance).
_RELIEF = 0.025
# What turns by more than this has another velocity at each place, and its turn tells depths well: what lies behind its
# nearest tracks by no more than this part of the distance is as near, and the rest of it is not mixed in.
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
    """The state of the nearest surface of each object that has one.

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
    rated = _rated_tracks(members, direction, states, shared, xy_px)
    needed = tracks_needed(members.lengths[rated.owner])
    by_shared, shared_cov = rated.by_shared, shared.cov[rated.path]
    is_in = in_nearest_of_path(
        rated.rate_hz, rated.sigma_hz, by_shared, shared_cov, rated.xy_px, rated.sets, needed, link_px
    )
    rates = rated.rate_hz, rated.own_hz, rated.sigma_hz
    is_in, above_hz, variance, centre = nearest_parts(
        rated.sets, *rates, by_shared, shared_cov, rated.xy, needed, is_in, rated.turns
    )
    return _joined(rated, is_in, above_hz, variance, centre, is_one[rated.owner], states, shared)


@dataclass(frozen=True)
class _RatedTracks:
    """The tracks with a rate of K objects that have any: ``sets``, ``owner (K,)`` which of all objects each is.

    ``path (K,)`` the path that they share, -1 for none, whether it ``turns (K,)``, and ``along (K, 3)`` the directions
    of the objects. Of M tracks: rates ``rate_hz`` = speed over depth, with standard deviations ``own_hz`` by their own
    noise and ``sigma_hz`` by that and the relief of surfaces, ``(M,)`` each; ``by_shared (M, 9)`` what errors that
    tracks share do to them; places ``xy, xy_px (M, 2)``.
    """

    sets: TrackSets
    owner: Ints
    path: Ints
    turns: Bools
    along: Floats
    rate_hz: Floats
    own_hz: Floats
    sigma_hz: Floats
    by_shared: Floats
    xy: Floats
    xy_px: Floats


def _rated_tracks(
    members: TrackSets, direction: Floats, states: TrackStates, shared: SharedErrors, xy_px: Floats
) -> _RatedTracks:
    n, count = len(members.index), len(members)
    index, lengths, path = np.empty(n, dtype=np.int64), np.zeros(count, np.int64), np.empty(count, np.int64)
    rates, by_shared, places = np.empty((2, n)), np.empty((n, shared.rate_jacobian.shape[1])), np.empty((2, n, 2))
    m = _rate_each(
        members.index,
        members.lengths,
        states.has_value,
        np.ascontiguousarray(direction),
        (states.abc_hz, states.cov),
        (shared.path_of, shared.rate_hz, shared.rate_variance, shared.rate_jacobian),
        (np.ascontiguousarray(states.xy), np.ascontiguousarray(xy_px)),
        index,
        lengths,
        path,
        rates,
        by_shared,
        places,
    )
    owner = np.flatnonzero(lengths)
    path, (rate_hz, own_hz), (xy, xy_px) = path[owner], rates[:, :m], places[:, :m]
    sets = TrackSets(index[:m], lengths[owner])
    turns = (path >= 0) & (np.linalg.norm(shared.turn_rad_s, axis=1) > _TURNS_RAD_S)[path]
    sigma_hz = np.hypot(own_hz, np.where(turns, _TURNING_RELIEF, _RELIEF)[sets.set_of] * rate_hz)
    return _RatedTracks(sets, owner, path, turns, direction[owner], rate_hz, own_hz, sigma_hz, by_shared[:m], xy, xy_px)


@compiled_for(
    "(i8[::1], i8[::1], b1[::1], f8[:, ::1], Tuple((f8[:, ::1], f8[:, :, ::1])), "
    "Tuple((i8[::1], f8[::1], f8[::1], f8[:, ::1])), UniTuple(f8[:, ::1], 2), i8[::1], i8[::1], i8[::1], "
    "f8[:, ::1], f8[:, ::1], f8[:, :, ::1])"
)
def _rate_each(
    members: Ints,
    n_members: Ints,
    has_value: Bools,
    direction: Floats,
    state: tuple[Floats, Floats],
    shared: tuple[Ints, Floats, Floats, Floats],
    places: tuple[Floats, Floats],
    index: Ints,
    lengths: Ints,
    path: Ints,
    rates: Floats,
    by_shared: Floats,
    found_places: Floats,
) -> int:
    """Fills what `_RatedTracks` has, of all objects with a ``direction (K, 3)``; how many tracks those have.

    On a path the speed is one for all of its points: those of a turning thing have velocities of their own, and still
    the nearest has the largest rate. For other tracks it is the speed along the direction of the object.
    """
    abc_hz, cov = state
    path_of, path_rate_hz, path_variance, jacobian = shared
    m, place = 0, 0
    for k in range(len(n_members)):
        path[k] = -1
        for _ in range(n_members[k]):
            i = members[place]
            place += 1
            if not (has_value[i] and np.isfinite(direction[k, 0])):
                continue
            if path_of[i] >= 0:
                rate, variance = path_rate_hz[i], path_variance[i]
                for j in range(by_shared.shape[1]):
                    by_shared[m, j] = jacobian[i, j]
            else:
                rate, variance = 0.0, 0.0
                for j in range(3):
                    rate += abc_hz[i, j] * direction[k, j]
                    for q in range(3):
                        variance += direction[k, j] * cov[i, j, q] * direction[k, q]
                for j in range(by_shared.shape[1]):
                    by_shared[m, j] = 0.0
            rates[0, m], rates[1, m] = rate, np.sqrt(variance)
            for which in range(2):
                found_places[which, m, 0], found_places[which, m, 1] = places[which][i, 0], places[which][i, 1]
            path[k] = max(path[k], path_of[i])
            index[m] = i
            lengths[k] += 1
            m += 1
    return m


def _joined(
    rated: _RatedTracks,
    is_in: Bools,
    above_hz: Floats,
    variance: Floats,
    centre: Floats,
    is_one: Bools,
    states: TrackStates,
    shared: SharedErrors,
) -> JointStates:
    """The states of surfaces of the tracks that ``is_in (M,)`` picks, by `nearest_parts` with what else that gives.

    Their covariances come from noise, from not knowing the place, and of a plane from its ``variance (K,)``. A plane's
    state is that at the ``centre (K, 2)`` of its nearest part, wherever in it the tracks are.
    """
    n, count = len(rated.sets.index), len(rated.sets)
    index, lengths, weight = np.empty(n, dtype=np.int64), np.zeros(count, np.int64), np.empty(n)
    along, ref_px, abc_hz = rated.along.copy(), np.zeros((count, 2)), np.zeros((count, 3))
    # What was found as one surface may have few tracks.
    m = _join_each(
        rated.sets.index,
        rated.sets.lengths,
        is_in,
        is_one & (rated.sets.lengths >= _LEAST_OF_SURFACE),
        above_hz,
        (states.abc_hz, states.cov),
        rated.xy_px,
        (shared.path_of, shared.along),
        index,
        lengths,
        weight,
        along,
        ref_px,
        abc_hz,
    )
    turn_rad_s = np.where(rated.path[:, None] >= 0, shared.turn_rad_s[rated.path], 0.0)
    places = rated.xy, rated.xy_px
    move_to_centres(rated.sets.lengths, is_in, lengths, weight, places, centre, turn_rad_s, abc_hz, ref_px)
    left = np.flatnonzero(lengths)
    surfaces, weight = TrackSets(index[:m], lengths[left]), weight[:m]
    along, ref_px, abc_hz, variance = along[left], ref_px[left], abc_hz[left], variance[left]
    cov, place_cov = _joint_covariances(states, surfaces, weight, along, variance > 0.0)
    cov = cov + place_cov + _TRIMMED_VARIANCE * variance[:, None, None] * along[:, :, None] * along[:, None, :]
    return JointStates(rated.owner[left], ref_px, abc_hz, cov, place_cov)


@compiled_for(
    "(i8[::1], i8[::1], b1[::1], b1[::1], f8[::1], Tuple((f8[:, ::1], f8[:, :, ::1])), f8[:, ::1], "
    "Tuple((i8[::1], f8[:, ::1])), i8[::1], i8[::1], f8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1])"
)
def _join_each(
    rated: Ints,
    n_rated: Ints,
    is_in: Bools,
    is_whole: Bools,
    above: Floats,
    state: tuple[Floats, Floats],
    xy_px: Floats,
    path: tuple[Ints, Floats],
    index: Ints,
    lengths: Ints,
    weight: Floats,
    along: Floats,
    ref_px: Floats,
    abc_hz: Floats,
) -> int:
    """Fills the tracks of each surface, and the means over them, by weight; how many tracks all surfaces have.

    All of what ``is_whole (K,)`` makes up a surface where none was found. ``along (K, 3)`` comes as the directions of
    the objects and becomes along what the rate of the first track counts: its path, if it has one.
    """
    velocity, cov = state
    path_of, path_along = path
    m, place = 0, 0
    for k in range(len(n_rated)):
        low, high, begin, total = place, place + n_rated[k], m, 0.0
        place = high
        takes_all = is_whole[k]
        for p in range(low, high):
            takes_all = takes_all and not is_in[p]
        for p in range(low, high):
            if is_in[p] or takes_all:
                index[m], weight[m] = rated[p], 1.0 / max(cov[rated[p], 2, 2], _TINY)
                total += weight[m]
                m += 1
        lengths[k] = m - begin
        dx, dy, dz = along[k, 0], along[k, 1], along[k, 2]
        q = begin
        for p in range(low, high):
            if not (is_in[p] or takes_all):
                continue
            i = index[q]
            weight[q] /= total
            x, y, z = dx, dy, dz
            if path_of[i] >= 0:
                x, y, z = path_along[path_of[i], 0], path_along[path_of[i], 1], path_along[path_of[i], 2]
            if q == begin:
                along[k, 0], along[k, 1], along[k, 2] = x, y, z
            abc_hz[k, 0] += weight[q] * (velocity[i, 0] + above[p] * x)
            abc_hz[k, 1] += weight[q] * (velocity[i, 1] + above[p] * y)
            abc_hz[k, 2] += weight[q] * (velocity[i, 2] + above[p] * z)
            ref_px[k, 0] += weight[q] * xy_px[p, 0]
            ref_px[k, 1] += weight[q] * xy_px[p, 1]
            q += 1
    return m


def _joint_covariances(
    states: TrackStates, surfaces: TrackSets, weight: Floats, along: Floats, is_plane: Bools
) -> tuple[Floats, Floats]:
    """Covariances of weighted means of (a, b, c), by noise and by place, and the part of the place.

    Own noise averages out, errors of what they share do not. Tracks of a surface share one path, but for those timed by
    expansion: each of these is in the neighbourhoods of others, which err with it. Where each track has a direction of
    its own (three frames), nothing is common. What turns has another velocity at each of its places, and which of them
    is the nearest is not known: it may be any end of the surface. Where the rates along ``along`` (K, 3) are those of a
    plane, ``is_plane`` (K,), their noise is in its variance.
    """
    shared, count = states.shared, len(surfaces)
    place_cov = np.zeros((count, 3, 3))
    if shared is None:
        return _averaged_out(states, surfaces, weight, along, is_plane), place_cov
    cov = np.zeros((count, 3, 3))
    _fill_covariances(
        surfaces.index,
        surfaces.lengths,
        weight,
        np.where(is_plane, 0.0, _TRIMMED_VARIANCE),
        (states.cov, np.ascontiguousarray(states.xy)),
        (shared.path_of, shared.rate_variance, shared.jacobian),
        (shared.along, shared.cov, shared.turn_rad_s),
        EXPANSION_NEIGHBOURS,
        cov,
        place_cov,
    )
    return cov, place_cov


@compiled_for(
    "(i8[::1], i8[::1], f8[::1], f8[::1], Tuple((f8[:, :, ::1], f8[:, ::1])), "
    "Tuple((i8[::1], f8[::1], f8[:, :, ::1])), Tuple((f8[:, ::1], f8[:, :, ::1], f8[:, ::1])), i8, "
    "f8[:, :, ::1], f8[:, :, ::1])"
)
def _fill_covariances(
    index: Ints,
    lengths: Ints,
    weight: Floats,
    own_factor: Floats,
    state: tuple[Floats, Floats],
    of_tracks: tuple[Ints, Floats, Floats],
    of_paths: tuple[Floats, Floats, Floats],
    err_together: int,
    cov: Floats,
    place_cov: Floats,
) -> None:
    """Fills the results of `_joint_covariances`, surface by surface: all of them come as zeros.

    Noise of the tracks' own counts ``own_factor (K,)`` times. Of those without the path of the others, no more than
    ``err_together`` err together.
    """
    track_cov, xy = state
    path_of, rate_variance, jacobian = of_tracks
    path_along, shared_cov, turn_rad_s = of_paths
    n_shared, low = shared_cov.shape[1], 0
    by_shared, product, by_place = np.empty((3, n_shared)), np.empty(n_shared), np.empty(3)
    for k in range(len(lengths)):
        high, path, x, y = low + lengths[k], -1, 0.0, 0.0
        for m in range(low, high):
            path = max(path, path_of[index[m]])
            x, y = x + weight[m] * xy[index[m], 0], y + weight[m] * xy[index[m], 1]
        for j in range(3):
            for q in range(n_shared):
                by_shared[j, q] = 0.0
        own, others, squares = 0.0, 0.0, 0.0
        for m in range(low, high):
            i, w = index[m], weight[m]
            if path >= 0 and path_of[i] == path:
                own += w * w * rate_variance[i]
                for j in range(3):
                    for q in range(n_shared):
                        by_shared[j, q] += w * jacobian[i, j, q]
                continue
            others, squares = others + w, squares + w * w
            for j in range(3):
                for q in range(3):
                    cov[k, j, q] += w * w * track_cov[i, j, q]
        count = min(others * others / squares, err_together) if squares > 0.0 else 0.0
        for j in range(3):
            for q in range(3):
                cov[k, j, q] *= count
        if path >= 0:
            for j in range(3):
                for q in range(n_shared):
                    product[q] = 0.0
                    for r in range(n_shared):
                        product[q] += by_shared[j, r] * shared_cov[path, r, q]
                for r in range(3):
                    total = own_factor[k] * own * path_along[path, j] * path_along[path, r]
                    for q in range(n_shared):
                        total += product[q] * by_shared[r, q]
                    cov[k, j, r] += total
            tx, ty, tz = turn_rad_s[path, 0], turn_rad_s[path, 1], turn_rad_s[path, 2]
            for m in range(low, high):
                dx, dy = xy[index[m], 0] - x, xy[index[m], 1] - y
                by_place[0], by_place[1], by_place[2] = -tz * dy, tz * dx, tx * dy - ty * dx
                for j in range(3):
                    for r in range(3):
                        place_cov[k, j, r] += _END_VARIANCE * weight[m] * by_place[j] * by_place[r]
        low = high


def _averaged_out(states: TrackStates, surfaces: TrackSets, weight: Floats, along: Floats, is_plane: Bools) -> Floats:
    """Covariances (K, 3, 3) of means of tracks that have nothing in common; of a plane's, across ``along`` (K, 3)."""
    cov = _TRIMMED_VARIANCE * surfaces.sums((weight**2)[:, None, None] * states.cov[surfaces.index])
    across = np.eye(3) - np.where(is_plane[:, None, None], along[:, :, None] * along[:, None, :], 0.0)
    return np.asarray(across @ cov @ across)
