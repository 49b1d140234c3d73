"""The states of tracks, and what in their errors tracks share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.intervals import collision_times_from_state
from ttcvid.geometry.estimation.shared_trajectory import N_SHARED
from ttcvid.geometry.paper.collision import angles_from_epipoles
from ttcvid.model import Bools, CollisionTimes, Floats, Ints, Status

EXPANSION_NEIGHBOURS = 8
"""Tracks around a point, itself among them, whose expansion is that of its surroundings: they err together."""
# As plain numbers, with which arrays are compared in a third of the time.
_OK, _AT_INFINITY = int(Status.ok), int(Status.epipole_at_infinity)


@dataclass(frozen=True)
class SharedErrors:
    """What is a track's own in the error of its (a, b, c), and what it shares with others of its path.

    ``path_of (N,)`` the path of each track, negative for none; ``along (K, 3)`` the direction in which the noise of a
    track's own views counts; ``rate_hz (N,)`` speed along the path over depth, with ``rate_variance (N,)``, 1/s^2, by
    that noise; ``jacobian (N, 3, 12)`` of (a, b, c) by the shared unknowns, in the order of `shared_trajectory`, and
    their covariance ``cov (K, 12, 12)``; ``turn_rad_s (K, 3)`` how the things on them turn themselves.
    """

    path_of: Ints
    along: Floats
    rate_hz: Floats
    rate_variance: Floats
    jacobian: Floats
    cov: Floats
    turn_rad_s: Floats


def nothing_shared(n: int) -> SharedErrors:
    """Of N tracks of which each has a direction of its own."""
    none, jacobian, cov = np.zeros((1, 3)), np.zeros((n, 3, N_SHARED)), np.zeros((1, N_SHARED, N_SHARED))
    return SharedErrors(np.full(n, -1), none, np.zeros(n), np.zeros(n), jacobian, cov, none)


@dataclass(frozen=True)
class TrackStates:
    """States of N tracks: ``xy (N, 2)`` normalised, ``abc_hz (N, 3)`` = V / Z with ``cov (N, 3, 3)`` in 1/s^2.

    ``sigma_norm (N,)`` noise of x and y, ``direction (N, 3)`` the track's ``dir``, ``status (N,)``. NaN: no result.
    ``shared`` says what of the covariance of tracks with one direction is common to them; None where each has its own.
    """

    xy: Floats
    abc_hz: Floats
    cov: Floats
    sigma_norm: Floats
    direction: Floats
    status: Ints
    shared: SharedErrors | None = None

    @property
    def has_value(self) -> Bools:
        """Tracks with a result: (N,)."""
        return has_value(self.status)

    @property
    def alpha_rad(self) -> Floats:
        """Angle between the ray and ``-dir``: (N,) in [0, pi], NaN where there is no direction."""
        return angles_from_epipoles(np.column_stack([self.xy, np.ones(len(self.xy))]), self.direction)

    @property
    def common(self) -> SharedErrors:
        """What the tracks share, nothing where each has a direction of its own."""
        return nothing_shared(len(self.xy)) if self.shared is None else self.shared

    def without(self, index: Bools, status: Ints) -> TrackStates:
        """No result for the tracks of ``index (N,)``, for the reason ``status (N,)``."""
        if not index.any():
            return self
        values = {name: getattr(self, name).copy() for name in ("abc_hz", "cov", "direction")}
        for each in values.values():
            each[index] = np.nan
        return replace(self, status=np.where(index, status, self.status), **values)

    def times(self) -> CollisionTimes:
        """The three times with their intervals: N rows."""
        x, y = self.xy.T
        return collision_times_from_state(x, y, self.abc_hz, self.cov, self.sigma_norm)


def has_value(status: Ints) -> Bools:
    """Which of the tracks with ``status (N,)`` have a result: (N,)."""
    return np.asarray((status == _OK) | (status == _AT_INFINITY))
