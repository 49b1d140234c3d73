"""Place and rate of points whose relative path is known up to its scale, by maximum likelihood from their whole tracks.

All points of the static scene move along the camera's own path, all points of a translating object along one
direction; each has a depth of its own, which is all that its views have to tell beside where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.geometry.whole_track import window_gates
from ttcvid.model import Floats, Ints

NO_PATH = -1
"""Number of the path of a point that has none."""

LEAST_FRAMES = 2
"""Views that the rate needs; a window is never cut below them."""

# As for the free state (`whole_track_descent`, which a compiled function of this file may not call). The same sums
# stand in `shared_path_descent`, and with other weights in `rigid_path_descent`, which says why.
_ROBUST_SIGMAS = 3.0
_MAX_STEPS, _CONVERGED_CHI2, _WINDOW_STEPS, _TAIL = 8, 1e-2, 3, 3
_LEAST_DEPTH_RATIO = 0.1
_N_SUMS = 8


@dataclass(frozen=True)
class PathRates:
    """Places and rates of N points at time 0; NaN for a point without a path or with fewer than two views.

    ``xy (N, 2)``; ``rate_hz (N,)`` rho = (speed along the path) / Z, so that (a, b, c) = rho e with e the path's
    direction at time 0; ``cov (N, 3, 3)`` of (x, y, rho) by the noise of the point's own views. What errors that
    points share do to rho, to first order: ``by_path (N, 6)``, when the path has ``u t + v t^2 / 2`` too much, in 1/s
    per unit of the vectors u (a wrong direction) and v (in 1/s: a wrong acceleration over the speed); ``by_rotation
    (N, 3)`` in 1/s per rad/s, when the derotated rays turn at a constant rate that is not there.
    ``chi2, dof, n_frames (N,)`` of the window, as in `WholeTracks`, with 2 n_frames - 3 degrees of freedom.
    """

    xy: Floats
    rate_hz: Floats
    cov: Floats
    by_path: Floats
    by_rotation: Floats
    chi2: Floats
    dof: Ints
    n_frames: Ints


def straight_path(direction: Floats, t_s: Floats) -> Floats:
    """Path ``(L, 3)`` of a constant velocity along ``direction (3,)``, in s of it."""
    return np.asarray(t_s[:, None] * direction)


def fit_rates_on_paths(
    xy: Floats,
    t_s: Floats,
    sigma_norm: Floats,
    paths: Floats,
    path_of: Ints,
    max_frames: int | None = None,
    gate_probability: float = 0.999,
    start: Floats | None = None,
    has_sensitivities: bool = True,
) -> PathRates:
    """Place and rate of each point on its path, over the longest window that fits it (two views at the least).

    A point at (x, y, 1) now is seen at ``(x + rho T_x) / (1 + rho T_z)`` at a time with the path at T, and likewise in
    y: robust Gauss-Newton on the reprojection error.

    Parameters
    ----------
    xy, t_s, sigma_norm, max_frames, gate_probability
        As for `fit_whole_tracks`.
    paths
        ``(K, L, 3)``: where K things were relative to the camera, less where they are at time 0, in the axes of the
        camera at time 0, at each of the L times; in s: its derivative at time 0 is the unit vector e = dir. For a
        thing that moves straight ahead this is `straight_path`; for the static scene seen from a turning car it is the
        sum of the steps, each along its own direction. NaN where not known: those views are not used.
    start
        ``(N, 3)`` x, y, rho to start from; NaN rows, or None: from the linear solve.
    has_sensitivities
        False leaves ``by_path`` and ``by_rotation`` NaN, for speed.
    path_of
        ``(N,)`` path of each point, `NO_PATH` for none.

    Source: DESIGN section 3 ("w_i = s_i e with one shared e").

    >>> z, t = np.array([10.0, 11.0, 12.0]), np.array([0.0, -0.1, -0.2])
    >>> xy = np.column_stack([1.0 / z, 0.0 * z])[:, None]
    >>> path = straight_path(np.array([0.0, 0.0, -1.0]), t)[None]
    >>> fit_rates_on_paths(xy, t, np.array([1e-5]), path, np.array([0])).rate_hz.round(9)
    array([1.])
    """
    n = xy.shape[1]
    if xy.shape != (len(t_s), n, 2) or paths.shape[1:] != (len(t_s), 3) or path_of.shape != (n,):
        raise ValueError(
            "expected xy (L, N, 2), t_s (L,), paths (K, L, 3) and path_of (N,), "
            f"got {xy.shape}, {t_s.shape}, {paths.shape} and {path_of.shape}"
        )
    longest = len(t_s) if max_frames is None else min(max_frames, len(t_s))
    state, cov = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    by_path, by_rotation = np.full((n, 6), np.nan), np.full((n, 3), np.nan)
    chi2, n_frames = np.zeros(n), np.zeros(n, dtype=np.int64)
    _fit_each(
        np.ascontiguousarray(xy, dtype=np.float64),
        np.asarray(t_s, dtype=np.float64),
        np.asarray(sigma_norm, dtype=np.float64),
        np.argsort(np.abs(t_s), kind="stable"),
        longest,
        np.ascontiguousarray(paths, dtype=np.float64),
        np.asarray(path_of, dtype=np.int64),
        window_gates(longest, 3, gate_probability),
        window_gates(_TAIL, 0, gate_probability),
        np.full((n, 3), np.nan) if start is None else np.asarray(start, dtype=np.float64),
        has_sensitivities,
        state,
        cov,
        by_path,
        by_rotation,
        chi2,
        n_frames,
    )
    dof = np.maximum(2 * n_frames - 3, 0)
    return PathRates(state[:, :2], state[:, 2], cov, by_path, by_rotation, chi2, dof, n_frames)


@compiled
def _fit_each(
    xy: Floats,
    t_s: Floats,
    sigma: Floats,
    order: Ints,
    longest: int,
    paths: Floats,
    path_of: Ints,
    gates: Floats,
    tail_gates: Floats,
    start: Floats,
    has_sensitivities: bool,
    state: Floats,
    cov: Floats,
    by_path: Floats,
    by_rotation: Floats,
    chi2: Floats,
    n_frames: Ints,
) -> None:
    """Fill the results of `fit_rates_on_paths`, point by point."""
    t, views, path = np.empty(longest), np.empty((longest, 2)), np.empty((longest, 3))
    sums, s, step, step_near = np.zeros((longest + 1, _N_SUMS)), np.empty(3), np.empty(3), np.empty(3)
    for i in range(xy.shape[1]):
        if path_of[i] < 0 or not sigma[i] > 0.0:
            continue
        m, nearest, farthest = 0, 0.0, 0.0
        for place in order:
            if m == longest:
                break
            tz = paths[path_of[i], place, 2]
            # A sum is finite where all of its terms are.
            if np.isfinite(xy[place, i, 0] + xy[place, i, 1] + paths[path_of[i], place, 0] + tz):
                t[m] = t_s[place]
                for j in range(2):
                    views[m, j] = xy[place, i, j]
                for j in range(3):
                    path[m, j] = paths[path_of[i], place, j]
                nearest, farthest = min(nearest, tz), max(farthest, tz)
                m += 1
        n_frames[i] = m
        if m < LEAST_FRAMES:
            continue
        inverse, n = 1.0 / sigma[i], m
        low = -(1.0 - _LEAST_DEPTH_RATIO) / max(farthest, 1e-12)
        high = (1.0 - _LEAST_DEPTH_RATIO) / max(-nearest, 1e-12)
        has_start = np.isfinite(start[i, 0] + start[i, 1] + start[i, 2]) and low < start[i, 2] < high
        if has_start:
            s[0], s[1], s[2] = start[i, 0], start[i, 1], start[i, 2]
        else:
            s[0], s[1], s[2] = views[0, 0], views[0, 1], 0.0
            _add_up(views, path, m, s, inverse, True, sums)
            _solve(sums, m, s[2], low, high, step)
            for j in range(3):
                s[j] += step[j]
        for count in range(_MAX_STEPS):
            n = m if count < _WINDOW_STEPS else n
            _add_up(views, path, n, s, inverse, False, sums)
            fall = _solve(sums, n, s[2], low, high, step)
            while n > LEAST_FRAMES:
                whole = sums[n, 7] - fall
                if whole <= gates[n]:
                    k = max(n - _TAIL, LEAST_FRAMES)
                    near = sums[k, 7] - _solve(sums, k, s[2], low, high, step_near)
                    if whole - near <= tail_gates[n - k]:
                        break
                n -= 1
                fall = _solve(sums, n, s[2], low, high, step)
            for j in range(3):
                s[j] += step[j]
            chi2[i] = max(sums[n, 7] - fall, 0.0)
            if fall < _CONVERGED_CHI2:
                break
        n_frames[i] = n
        own, along_x, along_y = 1.0 / sums[n, 0], -sums[n, 1] / sums[n, 0], -sums[n, 2] / sums[n, 0]
        information = sums[n, 3] + along_x * sums[n, 1] + along_y * sums[n, 2]
        if not information > 0.0:
            continue
        variance = 1.0 / information
        state[i, 0], state[i, 1], state[i, 2] = s[0], s[1], s[2]
        cov[i, 0, 0] = own + along_x * along_x * variance
        cov[i, 1, 1] = own + along_y * along_y * variance
        cov[i, 0, 1] = cov[i, 1, 0] = along_x * along_y * variance
        cov[i, 0, 2] = cov[i, 2, 0] = along_x * variance
        cov[i, 1, 2] = cov[i, 2, 1] = along_y * variance
        cov[i, 2, 2] = variance
        if has_sensitivities:
            _sensitivities(t, views, path, n, s, inverse, along_x, along_y, variance, i, by_path, by_rotation)


@compiled
def _add_up(views: Floats, path: Floats, m: int, s: Floats, inverse: float, is_linear: bool, sums: Floats) -> None:
    """Running sums of the normal equations over the first m views, ``sums[k]`` of the first k.

    Columns: 0 the information on x (and y); 1, 2 the couplings of x, y with rho; 3 the information on rho; 4-6 the
    score of x, y, rho; 7 the squared residuals. ``is_linear``: with observed positions in the column of rho.
    """
    limit = _ROBUST_SIGMAS * _ROBUST_SIGMAS
    # In variables of their own, because a sum that is read back from memory takes twice as long.
    info, with_x, with_y, info_rate, score_x, score_y, score_rate, total = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(m):
        h = 1.0 / (1.0 + s[2] * path[k, 2])
        x, y = (s[0] + s[2] * path[k, 0]) * h, (s[1] + s[2] * path[k, 1]) * h
        rx, ry = (views[k, 0] - x) * inverse, (views[k, 1] - y) * inverse
        square = rx * rx + ry * ry
        # Without a branch: which views are far off cannot be guessed.
        weight = 1.0 if is_linear else limit / max(square, limit)
        if is_linear:
            x, y = views[k, 0], views[k, 1]
        jx, jy = path[k, 0] - x * path[k, 2], path[k, 1] - y * path[k, 2]
        hi = h * inverse
        w = weight * hi * hi
        gx, gy = weight * hi * rx, weight * hi * ry
        info += w
        with_x += w * jx
        with_y += w * jy
        info_rate += w * (jx * jx + jy * jy)
        score_x += gx
        score_y += gy
        score_rate += gx * jx + gy * jy
        total += weight * square
        sums[k + 1, 0], sums[k + 1, 1], sums[k + 1, 2], sums[k + 1, 3] = info, with_x, with_y, info_rate
        sums[k + 1, 4], sums[k + 1, 5], sums[k + 1, 6], sums[k + 1, 7] = score_x, score_y, score_rate, total


@compiled
def _solve(sums: Floats, n: int, rate: float, low: float, high: float, step: Floats) -> float:
    """Gauss-Newton step ``(3,)`` of x, y, rho by the first n views; returns by how much chi-square falls."""
    rest = 1.0 / sums[n, 0]
    information = sums[n, 3] - (sums[n, 1] * sums[n, 1] + sums[n, 2] * sums[n, 2]) * rest
    score = sums[n, 6] - (sums[n, 1] * sums[n, 4] + sums[n, 2] * sums[n, 5]) * rest
    change = score / information if information > 0.0 else 0.0
    # Half of the way to a limit at most.
    change = min(max(change, 0.5 * (low - rate)), 0.5 * (high - rate))
    step[0], step[1] = (sums[n, 4] - sums[n, 1] * change) * rest, (sums[n, 5] - sums[n, 2] * change) * rest
    step[2] = change
    fall: float = (sums[n, 4] * sums[n, 4] + sums[n, 5] * sums[n, 5]) * rest + change * (
        2.0 * score - information * change
    )
    return fall


@compiled
def _sensitivities(
    t: Floats,
    views: Floats,
    path: Floats,
    n: int,
    s: Floats,
    inverse: float,
    along_x: float,
    along_y: float,
    variance: float,
    i: int,
    by_path: Floats,
    by_rotation: Floats,
) -> None:
    """What a wrong path and a rotation left in the views of point i do to its rho: see `PathRates`."""
    for j in range(3):
        by_path[i, j] = by_path[i, 3 + j] = by_rotation[i, j] = 0.0
    for k in range(n):
        h = 1.0 / (1.0 + s[2] * path[k, 2])
        x, y = (s[0] + s[2] * path[k, 0]) * h, (s[1] + s[2] * path[k, 1]) * h
        rx, ry = (views[k, 0] - x) * inverse, (views[k, 1] - y) * inverse
        square = rx * rx + ry * ry
        weight = min(1.0, _ROBUST_SIGMAS * _ROBUST_SIGMAS / max(square, 1e-300))
        # What a shift of this view by (dx, dy) does to rho, with x and y free.
        gain = weight * variance * h * inverse * inverse
        px, py = gain * (path[k, 0] - x * path[k, 2] + along_x), gain * (path[k, 1] - y * path[k, 2] + along_y)
        for j in range(2):
            moved = s[2] * h * (t[k] if j == 0 else 0.5 * t[k] * t[k])
            by_path[i, 3 * j] -= moved * px
            by_path[i, 3 * j + 1] -= moved * py
            by_path[i, 3 * j + 2] += moved * (x * px + y * py)
        by_rotation[i, 0] -= t[k] * (x * y * px + (1.0 + y * y) * py)
        by_rotation[i, 1] += t[k] * ((1.0 + x * x) * px + x * y * py)
        by_rotation[i, 2] += t[k] * (x * py - y * px)
