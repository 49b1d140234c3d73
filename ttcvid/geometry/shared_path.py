"""What points of one path have to say together: its direction, its bend, and a rotation that is left in their views.

One track can hardly tell a braking car from a slower one, or a bent path from a wrong direction; all tracks of it can.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.geometry.rotation import normalize, rotation_from_vector, tangent_basis
from ttcvid.geometry.whole_track_on_path import NO_PATH, PathRates, fit_rates_on_paths
from ttcvid.model import Floats, Ints

N_SHARED = 9
"""Shared unknowns, in this order: u (3), v (3) with the path ``+ u t + v t^2 / 2``, and a rotation rate (3), rad/s."""

MOST_POINTS = 150
"""Of more points than this only an even part is asked: errors that neighbours share are what limits a path."""

# Joint steps. In all but the last one no view is too far off, by making the noise so many times larger: a believed path
# may be wrong by hundreds of sigmas at its far end, where a window would be cut at once and nothing learned of it.
_ROUNDS, _NO_LIMIT = 4, 1e3
# A point whose window has less than this part of the views, over the same of the median point, is left out.
_LOYAL_SHARE = 0.7
# As in the fit of each point (`whole_track_on_path`).
_ROBUST_SIGMAS = 3.0


@dataclass(frozen=True)
class PathBeliefs:
    """What is believed of K paths before their points are looked at: ``base (K, L, 3)``, ``direction (K, 3)`` = dir.

    Standard deviations about them: ``direction_cov (K, 3, 3)`` in the tangent plane, rad^2; of an acceleration over the
    speed, 1/s, ``along_sigma_hz`` along the direction and ``across_sigma_hz`` per axis across; ``turn_sigma_rad_s`` per
    axis of a rotation rate in the views.
    """

    base: Floats
    direction: Floats
    direction_cov: Floats
    along_sigma_hz: float
    across_sigma_hz: float
    turn_sigma_rad_s: float

    def bend_cov(self, power: int = 1) -> Floats:
        """Covariance (K, 3, 3) of the acceleration over the speed; with ``power`` -1 its inverse."""
        along = self.direction[:, :, None] * self.direction[:, None, :]
        return np.asarray(
            along * self.along_sigma_hz ** (2 * power) + (np.eye(3) - along) * self.across_sigma_hz ** (2 * power)
        )


@dataclass(frozen=True)
class SharedPaths:
    """K paths as all their points see them: ``path (K, L, 3)``, ``direction (K, 3)`` = dir at time 0.

    ``offset (K, 9)`` the shared unknowns, from the belief on, with ``cov (K, 9, 9)``.
    """

    path: Floats
    direction: Floats
    offset: Floats
    cov: Floats

    @property
    def bend_hz(self) -> Floats:
        """Acceleration over the speed beside what the belief has: (K, 3)."""
        return self.offset[:, 3:6]

    @property
    def turn_rad_s(self) -> Floats:
        """Rotation rate in the views: (K, 3)."""
        return self.offset[:, 6:]


def joined_paths(parts: list[SharedPaths]) -> SharedPaths:
    """Paths of several fits, one after the other."""
    return SharedPaths(
        *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(SharedPaths))
    )


def believed_paths(beliefs: PathBeliefs) -> SharedPaths:
    """The paths as they are believed, with what is not known of them."""
    count = len(beliefs.direction)
    cov = np.zeros((count, N_SHARED, N_SHARED))
    cov[:, :3, :3] = beliefs.direction_cov
    cov[:, 3:6, 3:6] = beliefs.bend_cov()
    cov[:, 6:, 6:] = beliefs.turn_sigma_rad_s**2 * np.eye(3)
    return SharedPaths(beliefs.base, beliefs.direction, np.zeros((count, N_SHARED)), cov)


def fit_shared_paths(
    xy: Floats,
    t_s: Floats,
    sigma_norm: Floats,
    beliefs: PathBeliefs,
    path_of: Ints,
    max_frames: int | None = None,
    gate_probability: float = 0.999,
) -> SharedPaths:
    """What the points of each path say of it together, by Gauss-Newton in turns with their places and rates.

    Parameters
    ----------
    beliefs
        Times and axes of ``base`` as in `fit_rates_on_paths`.
    xy, t_s, sigma_norm, path_of, max_frames, gate_probability
        As for `fit_rates_on_paths`. At most `MOST_POINTS` points of a path are used.
    """
    shared = believed_paths(beliefs)
    chosen = [_some(np.flatnonzero(path_of == number)) for number in range(len(beliefs.direction))]
    if not chosen:
        return shared
    index = np.concatenate(chosen)
    xy, sigma_norm, path_of = xy[:, index], sigma_norm[index], path_of[index]
    longest = len(t_s) if max_frames is None else max_frames
    n_views = np.minimum(np.count_nonzero(np.isfinite(xy[..., 0]), axis=0), longest)
    start = None
    for count in range(_ROUNDS):
        is_last = count == _ROUNDS - 1
        views = turned_back(xy, t_s, shared.turn_rad_s, path_of)
        rates = fit_rates_on_paths(
            views,
            t_s,
            sigma_norm if is_last else _NO_LIMIT * sigma_norm,
            shared.path,
            path_of,
            max_frames,
            gate_probability,
            start,
            has_sensitivities=False,
        )
        misfit = np.ones(len(shared.path)) if is_last else _NO_LIMIT * _misfit(rates, path_of, len(shared.path))
        misfit = np.maximum(misfit, 1.0)
        loyal = _keeping_to(path_of, rates.n_frames, n_views)
        information, score = path_information(views, t_s, misfit[path_of] * sigma_norm, shared.path, loyal, rates)
        # Misfit limits how far a point may be off; it is none of the noise, and takes nothing from the points' weight.
        information, score = information * misfit[:, None, None] ** 2, score * misfit[:, None] ** 2
        shared = _improved(shared, beliefs, information, score, t_s)
        start = np.column_stack([rates.xy, rates.rate_hz])
    return shared


def turned_back(xy: Floats, t_s: Floats, turn_rad_s: Floats, path_of: Ints) -> Floats:
    """Views ``(L, N, 2)`` without the rotation rates ``(K, 3)`` of their paths, about time 0."""
    if not turn_rad_s.any():
        return xy
    back = np.empty_like(xy)
    rotations = rotation_from_vector(-t_s[None, :, None] * turn_rad_s[:, None, :])
    _turn_views(np.ascontiguousarray(xy), rotations, np.asarray(path_of, dtype=np.int64), back)
    return back


def _misfit(rates: PathRates, path_of: Ints, count: int) -> Floats:
    """Typical size of the residuals of each path's points, in the sigmas of the fit: (K,)."""
    misfit = np.zeros(count)
    relative = rates.chi2 / np.maximum(rates.dof, 1)
    for number in range(count):
        mine = relative[path_of == number]
        misfit[number] = np.sqrt(np.median(mine)) if len(mine) else 0.0
    return misfit


def _keeping_to(path_of: Ints, n_frames: Ints, n_views: Ints) -> Ints:
    """Paths of the points; `NO_PATH` for those that leave theirs much sooner than others do: they move otherwise."""
    share = n_frames / np.maximum(n_views, 1)
    kept = path_of.copy()
    for number in range(int(path_of.max(initial=-1)) + 1):
        mine = path_of == number
        if mine.any():
            kept[mine & (share < _LOYAL_SHARE * np.median(share[mine]))] = NO_PATH
    return kept


def _some(index: Ints) -> Ints:
    """An even part of the points, no more than `MOST_POINTS`."""
    return index[:: -(-len(index) // MOST_POINTS)] if len(index) else index


def _improved(
    shared: SharedPaths, beliefs: PathBeliefs, information: Floats, score: Floats, t_s: Floats
) -> SharedPaths:
    """The paths after one joint step of all their points."""
    count = len(beliefs.direction)
    columns, prior = np.zeros((count, N_SHARED, 8)), np.zeros((count, 8, 8))
    columns[:, :3, :2], columns[:, 3:, 2:] = tangent_basis(beliefs.direction), np.eye(6)
    turned = np.swapaxes(columns, 1, 2)
    tangent = columns[:, :3, :2]
    prior[:, :2, :2] = np.linalg.inv(np.swapaxes(tangent, 1, 2) @ beliefs.direction_cov @ tangent)
    prior[:, 2:5, 2:5] = beliefs.bend_cov(-1)
    prior[:, 5:, 5:] = np.eye(3) / beliefs.turn_sigma_rad_s**2
    cov = np.linalg.inv(turned @ information @ columns + prior)
    right = turned @ score[..., None] - prior @ (turned @ shared.offset[..., None])
    offset = shared.offset + (columns @ (cov @ right))[..., 0]
    t = t_s[None, :, None]
    path = beliefs.base + t * offset[:, None, :3] + 0.5 * t * t * offset[:, None, 3:6]
    return SharedPaths(path, normalize(beliefs.direction + offset[:, :3]), offset, columns @ cov @ turned)


@compiled
def _turn_views(xy: Floats, rotations: Floats, path_of: Ints, back: Floats) -> None:
    """Fill ``back (L, N, 2)`` with the views turned by ``rotations (K, L, 3, 3)`` of their paths."""
    for place in range(len(xy)):
        for i in range(xy.shape[1]):
            x, y = xy[place, i, 0], xy[place, i, 1]
            if path_of[i] < 0:
                back[place, i] = xy[place, i]
                continue
            r = rotations[path_of[i], place]
            depth = r[2, 0] * x + r[2, 1] * y + r[2, 2]
            back[place, i, 0] = (r[0, 0] * x + r[0, 1] * y + r[0, 2]) / depth
            back[place, i, 1] = (r[1, 0] * x + r[1, 1] * y + r[1, 2]) / depth


def path_information(
    xy: Floats, t_s: Floats, sigma_norm: Floats, paths: Floats, path_of: Ints, rates: PathRates
) -> tuple[Floats, Floats]:
    """Information ``(K, 9, 9)`` and score ``(K, 9)`` of the shared unknowns of K paths.

    The place and the rate of each point are marginalised out. Parameters as for `fit_rates_on_paths`, ``rates`` its
    result: each point counts with the views of its window, at its fitted place.
    """
    count = len(paths)
    information, score = np.zeros((count, N_SHARED, N_SHARED)), np.zeros((count, N_SHARED))
    _gather(
        np.ascontiguousarray(xy),
        np.asarray(t_s, dtype=np.float64),
        np.asarray(sigma_norm, dtype=np.float64),
        np.argsort(np.abs(t_s), kind="stable"),
        np.ascontiguousarray(paths),
        np.asarray(path_of, dtype=np.int64),
        np.column_stack([rates.xy, rates.rate_hz]),
        rates.n_frames,
        information,
        score,
    )
    return information, score


@compiled
def _gather(
    xy: Floats,
    t_s: Floats,
    sigma: Floats,
    order: Ints,
    paths: Floats,
    path_of: Ints,
    state: Floats,
    n_frames: Ints,
    information: Floats,
    score: Floats,
) -> None:
    """Add up each point's part, with its place and rate eliminated."""
    limit = _ROBUST_SIGMAS * _ROBUST_SIGMAS
    by_x, by_y = np.zeros(N_SHARED), np.zeros(N_SHARED)
    with_x, with_y, with_rate = np.empty(N_SHARED), np.empty(N_SHARED), np.empty(N_SHARED)
    whole, right = np.empty((N_SHARED, N_SHARED)), np.empty(N_SHARED)
    for i in range(xy.shape[1]):
        number = path_of[i]
        if number < 0 or not np.isfinite(state[i, 2]) or n_frames[i] < 3:
            continue
        s, inverse = state[i], 1.0 / sigma[i]
        with_x[:], with_y[:], with_rate[:], whole[:], right[:] = 0.0, 0.0, 0.0, 0.0, 0.0
        place_info, rate_x, rate_y, rate_info, g_x, g_y, g_rate = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        count = 0
        for place in order:
            if count == n_frames[i]:
                break
            path = paths[number, place]
            if not np.isfinite(xy[place, i, 0] + xy[place, i, 1] + path[0] + path[2]):
                continue
            count += 1
            t = t_s[place]
            h = 1.0 / (1.0 + s[2] * path[2])
            x, y = (s[0] + s[2] * path[0]) * h, (s[1] + s[2] * path[1]) * h
            rx, ry = (xy[place, i, 0] - x) * inverse, (xy[place, i, 1] - y) * inverse
            square = rx * rx + ry * ry
            weight = limit / square if square > limit else 1.0
            a = h * inverse
            jx, jy = a * (path[0] - x * path[2]), a * (path[1] - y * path[2])
            for j in range(2):
                moved = s[2] * a * (t if j == 0 else 0.5 * t * t)
                by_x[3 * j], by_x[3 * j + 2] = moved, -x * moved
                by_y[3 * j + 1], by_y[3 * j + 2] = moved, -y * moved
            turned = inverse * t
            by_x[6], by_x[7], by_x[8] = -x * y * turned, (1.0 + x * x) * turned, -y * turned
            by_y[6], by_y[7], by_y[8] = -(1.0 + y * y) * turned, x * y * turned, x * turned
            place_info += weight * a * a
            rate_x += weight * a * jx
            rate_y += weight * a * jy
            rate_info += weight * (jx * jx + jy * jy)
            g_x += weight * a * rx
            g_y += weight * a * ry
            g_rate += weight * (jx * rx + jy * ry)
            for j in range(N_SHARED):
                wx, wy = weight * by_x[j], weight * by_y[j]
                with_x[j] += a * wx
                with_y[j] += a * wy
                with_rate[j] += jx * wx + jy * wy
                right[j] += rx * wx + ry * wy
                for k in range(N_SHARED):
                    whole[j, k] += wx * by_x[k] + wy * by_y[k]
        rate_info -= (rate_x * rate_x + rate_y * rate_y) / place_info
        if not rate_info > 0.0:
            continue
        g_rate -= (rate_x * g_x + rate_y * g_y) / place_info
        for j in range(N_SHARED):
            with_rate[j] -= (rate_x * with_x[j] + rate_y * with_y[j]) / place_info
        for j in range(N_SHARED):
            score[number, j] += (
                right[j] - (with_x[j] * g_x + with_y[j] * g_y) / place_info - with_rate[j] * g_rate / rate_info
            )
            for k in range(N_SHARED):
                information[number, j, k] += (
                    whole[j, k]
                    - (with_x[j] * with_x[k] + with_y[j] * with_y[k]) / place_info
                    - with_rate[j] * with_rate[k] / rate_info
                )
