"""What points of one path have to say together: its direction, its bend, and a rotation that is left in their views.

One track can hardly tell a braking car from a slower one, or a bent path from a wrong direction; all tracks of it can.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.geometry.estimation.shared_trajectory_belief import believe_as_found, set_beliefs, set_prior
from ttcvid.geometry.estimation.shared_trajectory_descent import N_LOCAL, add_up_windows, descend_together, start_points
from ttcvid.geometry.estimation.shared_trajectory_found import share
from ttcvid.geometry.estimation.shared_trajectory_points import PathPoints
from ttcvid.geometry.estimation.track_on_trajectory import fit_rates_on_paths
from ttcvid.geometry.rotation import rotation_from_vector, tangent_basis
from ttcvid.model import Bools, Floats, Ints

N_SHARED = 9
"""Shared unknowns, in this order: u (3), v (3) with the path ``+ u t + v t^2 / 2``, and a rotation rate (3), rad/s."""


@dataclass(frozen=True)
class PathBeliefs:
    """What is believed of K paths before their points are looked at: ``base (K, L, 3)``, ``direction (K, 3)`` = dir.

    Standard deviations about them: ``direction_cov (K, 3, 3)`` in the tangent plane, rad^2; of an acceleration over the
    speed, 1/s, ``along_sigma_hz`` along the direction and ``across_sigma_hz`` per axis across; ``turn_sigma_rad_s`` per
    axis of a rotation rate in the views. That rotation is an error of the camera's; of a thing that ``turns_itself`` it
    is its own, about its middle.
    """

    base: Floats
    direction: Floats
    direction_cov: Floats
    along_sigma_hz: float
    across_sigma_hz: float
    turn_sigma_rad_s: float
    turns_itself: bool = False

    def of(self, is_asked: Bools, turn_sigma_rad_s: float) -> PathBeliefs:
        """What is believed of the paths for which ``is_asked (K,)`` holds, with another belief in their turns."""
        return replace(
            self,
            base=self.base[is_asked],
            direction=self.direction[is_asked],
            direction_cov=self.direction_cov[is_asked],
            turn_sigma_rad_s=turn_sigma_rad_s,
        )

    def bend_cov(self) -> Floats:
        """Covariance (K, 3, 3) of the acceleration over the speed."""
        along = self.direction[:, :, None] * self.direction[:, None, :]
        return np.asarray(along * self.along_sigma_hz**2 + (np.eye(3) - along) * self.across_sigma_hz**2)


@dataclass(frozen=True)
class SharedPaths:
    """K paths as all their points see them: ``path (K, L, 3)``, ``direction (K, 3)`` = dir at time 0.

    ``offset (K, 9)`` the shared unknowns, from the belief on, with ``cov (K, 9, 9)``. ``direction_cov (K, 3, 3)`` in
    rad^2 is that of the middle of what turns itself. What is left in all views: the ``squares (K,)`` of the residuals
    in sigmas, each no larger than a robust fit counts it, and what is ``usual (K,)`` by the degree of freedom; 0 where
    nothing was fitted.
    """

    path: Floats
    direction: Floats
    offset: Floats
    cov: Floats
    direction_cov: Floats
    squares: Floats
    usual: Floats

    @property
    def turn_rad_s(self) -> Floats:
        """Rotation rate in the views: (K, 3)."""
        return self.offset[:, 6:]


def joined_paths(parts: list[SharedPaths]) -> SharedPaths:
    """Paths of several fits, one after the other."""
    return SharedPaths(
        *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(SharedPaths))
    )


def chosen_paths(first: SharedPaths, second: SharedPaths, asked: Ints, takes_second: Bools) -> SharedPaths:
    """Of K paths of which those of ``asked (Q,)`` were fitted again, these where ``takes_second (Q,)`` holds."""
    if not takes_second.any():
        return first
    if len(asked) == len(first.path) and takes_second.all():
        return second
    chosen = []
    for field in fields(SharedPaths):
        values = getattr(first, field.name).copy()
        values[asked[takes_second]] = getattr(second, field.name)[takes_second]
        chosen.append(values)
    return SharedPaths(*chosen)


def believed_paths(beliefs: PathBeliefs) -> SharedPaths:
    """The paths as they are believed, with what is not known of them."""
    count = len(beliefs.direction)
    cov = np.zeros((count, N_SHARED, N_SHARED))
    cov[:, :3, :3] = beliefs.direction_cov
    cov[:, 3:6, 3:6] = beliefs.bend_cov()
    cov[:, 6:, 6:] = beliefs.turn_sigma_rad_s**2 * np.eye(3)
    return SharedPaths(
        beliefs.base,
        beliefs.direction,
        np.zeros((count, N_SHARED)),
        cov,
        cov[:, :3, :3],
        np.zeros(count),
        np.zeros(count),
    )


@dataclass(frozen=True)
class PathFits:
    """What is believed of K paths, and what their points' views say, for either to be weighed against the other.

    Both are said of what the points of a path share, in its own axes ``basis (K, 3, 3)``: ``believed (K, 8, 8)`` is the
    information of the beliefs; ``information (K, 8, 8)`` and ``score (K, 8)`` are those of the views, at ``offset (K,
    8)`` from the belief. ``own_motion (K, 8, 8)`` is that of `set_beliefs`, ``left (K, 2)`` that of `descend_together`.
    """

    beliefs: PathBeliefs
    t_s: Floats
    basis: Floats
    own_motion: Floats
    believed: Floats
    offset: Floats
    information: Floats
    score: Floats
    left: Floats

    def paths(self) -> SharedPaths:
        """The paths by the beliefs as they are and all views."""
        return self._paths(self.believed, self.information, self.score)

    def paths_from_found_directions(self, found_cov: Floats, common: Floats, searched: SharedPaths) -> SharedPaths:
        """The paths by their believed directions, where these were found to ``found_cov (K, 3, 3)``, in rad^2.

        The search, whose `paths` are ``searched``, is to find a path that was believed wrongly, and believes in no
        direction as much. One that was found as if its path were straight is nearer to the truth, but for where views
        contradict it: by so much its covariance grows. Points whose noise is partly the same say less beside it: that
        of a mean over them is ``common (K,)`` times as large. The paths are known no better for it than by the search:
        errors that tracks have in common, and a turn that does not show, are in none of these covariances.
        """
        information, score = self.information / common[:, None, None], self.score / common[:, None]
        local, cov = self._weighed(self.believed, information, score)
        believed = self.believed.copy()
        believe_as_found(self.basis, self.own_motion, self.beliefs.direction_cov, found_cov, local, cov, believed)
        return _as_unsure_as(searched, self._paths(believed, information, score))

    def _paths(self, believed: Floats, information: Floats, score: Floats) -> SharedPaths:
        local, cov = self._weighed(believed, information, score)
        return _shared_paths(self.beliefs, self.basis, self.own_motion, local, cov, self.left, self.t_s)

    def _weighed(self, believed: Floats, information: Floats, score: Floats) -> tuple[Floats, Floats]:
        """Offsets (K, 8) and their covariance (K, 8, 8)."""
        cov = np.empty_like(believed)
        _invert_each(believed + information, cov)
        return self.offset + _times(cov, score - _times(believed, self.offset)), cov


def _as_unsure_as(searched: SharedPaths, paths: SharedPaths) -> SharedPaths:
    """The ``paths``, known as those that were ``searched`` are, which they may be as well."""
    off = searched.direction - paths.direction
    squares = off[:, :, None] * off[:, None, :]
    cov = searched.cov.copy()
    cov[:, :3, :3] += squares
    return replace(paths, cov=cov, direction_cov=searched.direction_cov + squares)


def fit_shared_paths(
    points: PathPoints, beliefs: PathBeliefs, max_frames: int | None = None, gate_probability: float = 0.999
) -> SharedPaths:
    """What the points of each path say of it together: see `fit_paths`."""
    return fit_paths(points, beliefs, max_frames, gate_probability).paths()


def fit_paths(
    points: PathPoints, beliefs: PathBeliefs, max_frames: int | None = None, gate_probability: float = 0.999
) -> PathFits:
    """What the points of each path say of it together, by Gauss-Newton on the paths and their points.

    First over all views, so that a path that was believed wrongly finds its place; from there one more step over the
    window of each point that fits.

    Parameters
    ----------
    beliefs
        Times and axes of ``base`` as in `fit_rates_on_paths`.
    max_frames, gate_probability
        As for `fit_rates_on_paths`.
    """
    t_s = points.t_s
    basis = np.concatenate([tangent_basis(beliefs.direction), beliefs.direction[:, :, None]], axis=2)
    prior = _prior(beliefs, basis)
    believed, own_motion = np.empty_like(prior), np.empty_like(prior)
    n, count = len(points.path_of), len(basis)
    state, relative, offset, left = np.empty((n, 3)), np.empty(n), np.empty((count, N_LOCAL)), np.empty((count, 2))
    start_points(points.views(points.xy), beliefs.base, basis, state, relative)
    set_beliefs(beliefs.turns_itself, basis, state, points.first, prior, own_motion, believed)
    descend_together(points.views(points.xy), beliefs.base, basis, believed, state, relative, offset, left)
    path, _ = _moved_paths(beliefs, basis, offset, t_s)
    views = turned_back(points.xy, t_s, offset[:, -3:], points.path_of)
    rates = fit_rates_on_paths(
        views,
        t_s,
        points.sigma_norm,
        path,
        points.path_of,
        max_frames,
        gate_probability,
        state,
        has_sensitivities=False,
    )
    information, score = np.zeros_like(believed), np.zeros_like(offset)
    add_up_windows(points.views(views), path, basis, rates.n_frames, rates.state, information, score)
    return PathFits(beliefs, t_s, basis, own_motion, believed, offset, information, score, left)


def _times(matrices: Floats, vectors: Floats) -> Floats:
    """Products (K, n) of K matrices and K vectors."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def turned_back(xy: Floats, t_s: Floats, turn_rad_s: Floats, path_of: Ints) -> Floats:
    """Views ``(L, N, 2)`` without the rotation rates ``(K, 3)`` of their paths, about time 0."""
    if not turn_rad_s.any():
        return xy
    back = np.empty_like(xy)
    rotations = rotation_from_vector(-t_s[None, :, None] * turn_rad_s[:, None, :])
    turns = np.asarray(turn_rad_s.any(axis=1))
    _turn_views(np.ascontiguousarray(xy), rotations, turns, np.asarray(path_of, dtype=np.int64), back)
    return back


def _prior(beliefs: PathBeliefs, basis: Floats) -> Floats:
    """Information (K, 8, 8) of the belief on what moves along a path."""
    prior = np.zeros((len(basis), N_LOCAL, N_LOCAL))
    along_sigma_hz, across_sigma_hz = beliefs.along_sigma_hz, beliefs.across_sigma_hz
    set_prior(basis, beliefs.direction_cov, across_sigma_hz, along_sigma_hz, beliefs.turn_sigma_rad_s, prior)
    return prior


def _moved_paths(beliefs: PathBeliefs, basis: Floats, local: Floats, t_s: Floats) -> tuple[Floats, Floats]:
    """The paths ``(K, L, 3)`` at the offsets ``local (K, 8)`` in their own axes, and their velocities at time 0 (K, 3).

    A direction far from the believed one would be a longer one: the speed is 1 again on the paths, not in the velocity.
    """
    path, velocity = np.empty_like(beliefs.base), np.empty((len(basis), 3))
    _move_paths(beliefs.base, beliefs.direction, basis, local, t_s, path, velocity)
    return path, velocity


def _shared_paths(
    beliefs: PathBeliefs, basis: Floats, own_motion: Floats, local: Floats, cov: Floats, left: Floats, t_s: Floats
) -> SharedPaths:
    """The paths at the offsets ``local (K, 8)`` in their own axes, with ``cov (K, 8, 8)``; ``left (K, 2)``."""
    count = len(basis)
    path, velocity = _moved_paths(beliefs, basis, local, t_s)
    direction = np.empty((count, 3))
    offset, shared_cov, own_cov = np.empty((count, N_SHARED)), np.empty((count, 9, 9)), np.empty((count, 3, 3))
    share(basis, own_motion, local, cov, velocity, direction, offset, shared_cov, own_cov)
    return SharedPaths(path, direction, offset, shared_cov, own_cov, left[:, 0], left[:, 1])


@compiled_for("(f8[:, :, ::1], f8[:, :, ::1])")
def _invert_each(information: Floats, cov: Floats) -> None:
    """Fills ``cov (K, n, n)``, the inverses of symmetric positive matrices, by Cholesky factors."""
    n = information.shape[1]
    root, inverse = np.zeros((n, n)), np.zeros((n, n))
    for k in range(len(information)):
        for j in range(n):
            total = information[k, j, j]
            for m in range(j):
                total -= root[j, m] * root[j, m]
            root[j, j] = np.sqrt(total)
            for i in range(j + 1, n):
                total = information[k, i, j]
                for m in range(j):
                    total -= root[i, m] * root[j, m]
                root[i, j] = total / root[j, j]
        # The inverse of the lower factor.
        for j in range(n):
            inverse[j, j] = 1.0 / root[j, j]
            for i in range(j + 1, n):
                total = 0.0
                for m in range(j, i):
                    total -= root[i, m] * inverse[m, j]
                inverse[i, j] = total / root[i, i]
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for m in range(i, n):
                    total += inverse[m, i] * inverse[m, j]
                cov[k, i, j] = cov[k, j, i] = total


@compiled_for("(f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[::1], f8[:, :, ::1], f8[:, ::1])")
def _move_paths(
    base: Floats, direction: Floats, basis: Floats, local: Floats, t_s: Floats, path: Floats, velocity: Floats
) -> None:
    """Fills ``path (K, L, 3)`` and ``velocity (K, 3)`` of `_moved_paths`."""
    for k in range(len(base)):
        square = 0.0
        for j in range(3):
            velocity[k, j] = direction[k, j] + basis[k, j, 0] * local[k, 0] + basis[k, j, 1] * local[k, 1]
            square += velocity[k, j] * velocity[k, j]
        slower = 1.0 / np.sqrt(square)
        for j in range(3):
            bend = basis[k, j, 0] * local[k, 2] + basis[k, j, 1] * local[k, 3] + basis[k, j, 2] * local[k, 4]
            change = velocity[k, j] - direction[k, j]
            for place in range(len(t_s)):
                t = t_s[place]
                path[k, place, j] = (base[k, place, j] + t * change + 0.5 * t * t * bend) * slower


@compiled_for("(f8[:, :, ::1], f8[:, :, :, ::1], b1[::1], i8[::1], f8[:, :, ::1])")
def _turn_views(xy: Floats, rotations: Floats, turns: Bools, path_of: Ints, back: Floats) -> None:
    """Fill ``back (L, N, 2)`` with the views turned by ``rotations (K, L, 3, 3)`` of the paths that turn at all."""
    for place in range(len(xy)):
        for i in range(xy.shape[1]):
            x, y = xy[place, i, 0], xy[place, i, 1]
            if path_of[i] < 0 or not turns[path_of[i]]:
                back[place, i, 0], back[place, i, 1] = x, y
                continue
            r = rotations[path_of[i], place]
            depth = r[2, 0] * x + r[2, 1] * y + r[2, 2]
            back[place, i, 0] = (r[0, 0] * x + r[0, 1] * y + r[0, 2]) / depth
            back[place, i, 1] = (r[1, 0] * x + r[1, 1] * y + r[1, 2]) / depth
