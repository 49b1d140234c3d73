"""What points of one path have to say together: its direction, its bend, and a rotation that is left in their views.

One track can hardly tell a braking car from a slower one, or a bent path from a wrong direction; all tracks of it can.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ttcvid.geometry.estimation.shared_trajectory_points import LEAST_VIEWS, PathPoints
from ttcvid.geometry.estimation.track_on_trajectory import fit_rates_on_paths
from ttcvid.geometry.kernels.shared_path import N_LOCAL, add_windows, descend_together, start_points
from ttcvid.geometry.medians import medians
from ttcvid.geometry.rotation import cross, each_turned_into_plane, rotation_from_vector, tangent_basis
from ttcvid.model import Bools, Floats, Ints

N_SHARED = 12
"""Shared unknowns, in this order: u (3), v (3), a rotation rate (3), rad/s, and w (3); the path has
``+ u t + v t^2 / 2 + w t^3 / 6``.
"""

# Where these stand among the unknowns of a fit (`kernels.shared_path`).
_U, _V, _W, _TURN = slice(0, 2), slice(2, 5), slice(5, 8), slice(8, 11)
# The third axis is the direction itself.
_ALONG = 4

CHANGE_SIGMA_HZ2 = 0.5
"""Usual prior of the change of an acceleration over the speed, per axis: 3 m/s^3 at 6 m/s.

Brakes come and go within half a second. Without it ends of paths lag behind, and claim not to.
"""

# A point whose window has less than this part of its views, over the same of the median point, is left out.
_LOYAL_SHARE = 0.7
# No direction is believed in more than this: one in a plane would have no information across it.
_LEAST_SIGMA_RAD = 1e-8


@dataclass(frozen=True)
class PathBeliefs:
    """What is believed of K paths before their points are looked at: ``base (K, L, 3)``, ``direction (K, 3)`` = dir.

    Standard deviations about them: ``direction_cov (K, 3, 3)`` in the tangent plane, rad^2; of an acceleration over the
    speed, 1/s, ``along_sigma_hz`` along the direction and ``across_sigma_hz`` per axis across; of how it changes,
    1/s^2, ``change_sigma_hz2`` per axis; ``turn_sigma_rad_s`` per axis of a rotation rate in the views. That rotation
    is an error of the camera's; of a thing that ``turns_itself`` it is its own, about its middle.
    """

    base: Floats
    direction: Floats
    direction_cov: Floats
    along_sigma_hz: float
    across_sigma_hz: float
    turn_sigma_rad_s: float
    turns_itself: bool = False
    change_sigma_hz2: float = CHANGE_SIGMA_HZ2

    def of(self, is_asked: Bools, turn_sigma_rad_s: float) -> PathBeliefs:
        """What is believed of the paths for which ``is_asked (K,)`` holds, with another belief in their turns."""
        return replace(
            self,
            base=self.base[is_asked],
            direction=self.direction[is_asked],
            direction_cov=self.direction_cov[is_asked],
            turn_sigma_rad_s=turn_sigma_rad_s,
        )


@dataclass(frozen=True)
class SharedPaths:
    """K paths as all their points see them: ``path (K, L, 3)``, ``direction (K, 3)`` = dir at time 0.

    A path is NaN at views that it is not told for. ``offset (K, 12)`` the shared unknowns, from the belief on, with
    ``cov (K, 12, 12)``. What is left in all views: the ``squares (K,)`` of the residuals in sigmas, each no larger than
    a robust fit counts it, and the ``median_chi2 (K,)`` by the degree of freedom; 0 where nothing was fitted.
    """

    path: Floats
    direction: Floats
    offset: Floats
    cov: Floats
    squares: Floats
    median_chi2: Floats

    @property
    def turn_rad_s(self) -> Floats:
        """Rotation rate in the views: (K, 3)."""
        return self.offset[:, 6:9]


def joined_paths(parts: list[SharedPaths]) -> SharedPaths:
    """Paths of several fits, one after the other."""
    return SharedPaths(
        *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(SharedPaths))
    )


def chosen_paths(first: SharedPaths, second: SharedPaths, asked: Ints, takes_second: Bools) -> SharedPaths:
    """Of K paths of which those of ``asked (Q,)`` were fitted again, these where ``takes_second (Q,)`` holds."""
    if not takes_second.any():
        return first
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
    along = beliefs.direction[:, :, None] * beliefs.direction[:, None, :]
    cov[:, 3:6, 3:6] = along * beliefs.along_sigma_hz**2 + (np.eye(3) - along) * beliefs.across_sigma_hz**2
    cov[:, 6:9, 6:9] = beliefs.turn_sigma_rad_s**2 * np.eye(3)
    cov[:, 9:, 9:] = beliefs.change_sigma_hz2**2 * np.eye(3)
    offset, left = np.zeros((count, N_SHARED)), np.zeros(count)
    return SharedPaths(beliefs.base, beliefs.direction, offset, cov, left, left)


@dataclass(frozen=True)
class PathFits:
    """What is believed of K paths, and what their points' views say, for either to be weighed against the other.

    Both are said of what the points of a path share, in its own axes ``basis (K, 3, 3)``: ``believed (K, 11, 11)`` is
    the information of the beliefs; ``information (K, 11, 11)`` and ``score (K, 11)`` are those of the views, at
    ``offset (K, 11)`` from the belief. ``left (K, 2)`` is that of `descend_together`.
    """

    beliefs: PathBeliefs
    t_s: Floats
    basis: Floats
    believed: Floats
    offset: Floats
    information: Floats
    score: Floats
    left: Floats

    def paths(self) -> SharedPaths:
        """The paths by the beliefs as they are and all views."""
        return self._paths(*self._weighed(self.believed))

    def with_braking(self, sigma_hz: float, chi2: float) -> PathFits:
        """With a wider prior of the acceleration along the direction, ``sigma_hz``, of the paths where it shows.

        It shows where its chi-square under this prior, over the misfit of the views, exceeds ``chi2``. ``left`` stays
        that of the fit with the narrower prior.
        """
        wide = self.believed.copy()
        wide[:, _ALONG, _ALONG] += sigma_hz**-2.0 - self.beliefs.along_sigma_hz**-2.0
        offset, cov = self._weighed(wide)
        brakes = offset[:, _ALONG] ** 2 > chi2 * np.maximum(self.left[:, 1], 1.0) * cov[:, _ALONG, _ALONG]
        return replace(self, believed=np.where(brakes[:, None, None], wide, self.believed))

    def _weighed(self, believed: Floats) -> tuple[Floats, Floats]:
        """Offsets (K, 11) by the belief and by what the views say, and their covariance."""
        cov = np.asarray(np.linalg.inv(believed + self.information), dtype=np.float64)
        return self.offset + _times(cov, self.score - _times(believed, self.offset)), cov

    def _paths(self, local: Floats, cov: Floats) -> SharedPaths:
        """The paths at the offsets ``local (K, 11)`` in their own axes, with ``cov (K, 11, 11)``."""
        columns = _to_camera(self.basis)
        offset = _times(columns, local)
        path, speed = _moved_paths(self.beliefs, offset, self.t_s)
        # Directions and bends are over the speed.
        columns[:, :6] /= speed[:, None, None]
        columns[:, 9:] /= speed[:, None, None]
        direction = (self.beliefs.direction + offset[:, :3]) / speed[:, None]
        offset[:, :6] /= speed[:, None]
        offset[:, 9:] /= speed[:, None]
        cov = columns @ cov @ columns.transpose(0, 2, 1)
        return SharedPaths(path, direction, offset, cov, self.left[:, 0], self.left[:, 1])


def fit_paths(
    points: PathPoints, beliefs: PathBeliefs, max_frames: int | None = None, gate_probability: float = 0.999
) -> PathFits:
    """What the points of each path say of it together, by Gauss-Newton on the paths and their points.

    First over all views, so that a path that was believed wrongly finds its place; from there one more step over the
    window of each point that fits. Points that leave their path much sooner than others do move otherwise, and are left
    out of that.

    Parameters
    ----------
    beliefs : Times and axes of ``base`` as in `fit_rates_on_paths`.
    max_frames, gate_probability : As for `fit_rates_on_paths`.
    """
    t_s, path_of, (n, count) = points.t_s, points.path_of, (len(points.path_of), len(beliefs.base))
    basis = np.concatenate([tangent_basis(beliefs.direction), beliefs.direction[:, :, None]], axis=2)
    state, mean_square, offset, left = np.empty((n, 3)), np.empty(n), np.empty((count, N_LOCAL)), np.empty((count, 2))
    start_points(points.views(points.xy), beliefs.base, state, mean_square)
    own_motion = _own_motion(beliefs, basis, state, path_of)
    believed = own_motion.transpose(0, 2, 1) @ _prior(beliefs, basis) @ own_motion
    descend_together(points.views(points.xy), beliefs.base, basis, believed, state, mean_square, offset, left)
    path, _ = _moved_paths(beliefs, _times(_to_camera(basis), offset), t_s)
    views = turned_back(points.xy, t_s, offset[:, _TURN], path_of)
    window = max_frames, gate_probability
    rates = fit_rates_on_paths(views, t_s, points.sigma_norm, path, path_of, *window, state)
    share = rates.n_frames / points.n_views
    is_used = (share >= _LOYAL_SHARE * medians(share, path_of, count)[path_of]) & (rates.n_frames >= LEAST_VIEWS)
    n_used = np.where(is_used & np.isfinite(rates.rate_hz), rates.n_frames, 0)
    information, score = np.zeros((count, N_LOCAL, N_LOCAL)), np.zeros((count, N_LOCAL))
    add_windows(points.views(views), path, basis, n_used, rates.state, information, score)
    information += np.tril(information, -1).transpose(0, 2, 1)
    return PathFits(beliefs, t_s, basis, believed, offset, information, score, left)


def turned_back(xy: Floats, t_s: Floats, turn_rad_s: Floats, path_of: Ints) -> Floats:
    """Views ``(L, N, 2)`` without the rotation rates ``(K, 3)`` of their paths, about time 0; any without a path."""
    if not turn_rad_s.any():
        return xy
    rotations = rotation_from_vector(-t_s[:, None] * turn_rad_s[:, None])
    xy, turns = xy.copy(), np.flatnonzero(np.asarray(turn_rad_s.any(axis=1))[path_of])
    xy[:, turns] = each_turned_into_plane(xy, turns, rotations, path_of[turns])
    return xy


def _times(matrices: Floats, vectors: Floats) -> Floats:
    """Products (K, n) of K matrices and K vectors."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _to_camera(basis: Floats) -> Floats:
    """Matrices (K, 12, 11) that take what the points of a path share from its own axes to those of the camera."""
    columns = np.zeros((len(basis), N_SHARED, N_LOCAL))
    columns[:, :3, _U], columns[:, 3:6, _V], columns[:, 9:, _W] = basis[:, :, :2], basis, basis
    columns[:, 6:9, _TURN] = np.eye(3)
    return columns


def _prior(beliefs: PathBeliefs, basis: Floats) -> Floats:
    """Information (K, 11, 11) of the belief on what moves along a path."""
    across, along, turn = beliefs.across_sigma_hz, beliefs.along_sigma_hz, beliefs.turn_sigma_rad_s
    change = beliefs.change_sigma_hz2
    prior = np.zeros((len(basis), N_LOCAL, N_LOCAL))
    prior[:] = np.diag(np.array([1.0, 1.0, across, across, along, *3 * [change], *3 * [turn]]) ** -2.0)
    plane = basis[:, :, :2]
    direction_cov = plane.transpose(0, 2, 1) @ beliefs.direction_cov @ plane
    prior[:, _U, _U] = np.linalg.inv(direction_cov + _LEAST_SIGMA_RAD**2 * np.eye(2))
    return prior


def _own_motion(beliefs: PathBeliefs, basis: Floats, state: Floats, path_of: Ints) -> Floats:
    """Matrices (K, 11, 11) that take shared offsets to the motion of the middle of what turns itself: the belief's.

    Views of a point at C + V t + A t^2 / 2, turned back at the rate omega, show it moving by
    (V - omega x C) t + (A - 2 omega x V) t^2 / 2, to first order in omega. The offsets are the latter. C is (x, y, 1) /
    rho of the middle of the points ``state (N, 3)``, in units in which the speed is 1, and V the unit vector of the
    direction.
    """
    count = len(basis)
    own_motion = np.zeros((count, N_LOCAL, N_LOCAL))
    own_motion[:] = np.eye(N_LOCAL)
    if beliefs.turns_itself:
        x, y, rho = (medians(column, path_of, count) for column in state.T)
        axes, has_middle = basis.transpose(0, 2, 1), rho > 0.0
        middle = np.column_stack([x, y, np.ones(count)])[has_middle] / rho[has_middle, None]
        # omega x C along the axis b is omega . (C x b).
        own_motion[has_middle, _U, _TURN] = cross(middle[:, None], axes[has_middle, :2])
        own_motion[:, _V, _TURN] = 2.0 * cross(beliefs.direction[:, None], axes)
    return own_motion


def _moved_paths(beliefs: PathBeliefs, offset: Floats, t_s: Floats) -> tuple[Floats, Floats]:
    """The paths ``(K, L, 3)`` at the shared offsets ``offset (K, 12)``, and their speeds (K,) before.

    A direction far from the believed one would be a longer one: the speed is 1 again on the paths, not in the offsets.
    """
    speed: Floats = np.sqrt(np.sum((beliefs.direction + offset[:, :3]) ** 2, axis=1))
    t, u, v, w = t_s[:, None], offset[:, None, :3], offset[:, None, 3:6], offset[:, None, 9:]
    path = beliefs.base + t * u + 0.5 * t**2 * v + t**3 / 6.0 * w
    return path / speed[:, None, None], speed
