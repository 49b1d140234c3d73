"""A rigid body that moves in a straight line before a resting camera: model of its point tracks.

Point i of the body is at ``P_i(t) = r_i + s_i (dt e + dq (a e + w b))``, in units of its depth at its own middle time:
r_i = (x_i, y_i, 1) is its ray there, s_i = |V| / Z_i its inverse depth times speed, e the unit direction shared by all
points. dt and dq are the differences of tau and tau^2 / 2 to the point's middle time, tau being the time from the
body's middle. The lines of the points meet at e in the picture (the vanishing point), and the speed-up along each line
tells the distance.

Three nuisance parameters have priors about zero: ``a`` the change of speed (1/s); ``w`` the turn rate (rad/s) towards
b, the level direction normal to e; and for each point a drift normal to its line, for what is not quite rigid: a
sleeve, the rim of a shape. They keep a body that brakes or turns slightly from counting as too certain, and one long
track from outweighing many short ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ttcvid.geometry.estimation.relative_pose import direction_from_flow
from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Bools, Floats, Ints

N_OWN, N_SHARED = 4, 4
"""Unknowns of a point (x, y, s, drift) and of the body (two of the direction, a, w)."""
RATE, DRIFT = 2, 3
# Least depth that a point may come to, in units of its middle depth: behind that a path folds over.
_LEAST_DEPTH = 0.02


@dataclass(frozen=True)
class BodyTracks:
    """Observations of one body's tracks, sorted by (track, time).

    ``track (N,)`` numbers 0 .. M-1, each with at least two observations; ``t_s (N,)``; ``xy (N, 2)`` undistorted
    normalised coordinates (the ray is (x, y, 1)); ``sigma`` their noise per coordinate, in the same units.
    """

    track: Ints
    t_s: Floats
    xy: Floats
    sigma: float

    @property
    def n_tracks(self) -> int:
        """Number of tracks."""
        return int(self.track[-1]) + 1 if len(self.track) else 0

    @cached_property
    def starts(self) -> Ints:
        """Row of the first observation of each track: (M,)."""
        return np.flatnonzero(np.diff(self.track, prepend=-1))

    @cached_property
    def counts(self) -> Ints:
        """Number of observations of each track: (M,)."""
        return np.diff(np.append(self.starts, len(self.track)))

    @cached_property
    def times(self) -> tuple[Floats, Floats]:
        """The dt and dq of each observation, ``(N,)`` in s and s^2."""
        tau = self.t_s - 0.5 * (self.t_s.min() + self.t_s.max())
        middle = (self.sums(tau) / self.counts)[self.track]
        return tau - middle, 0.5 * (tau**2 - middle**2)

    def sums(self, values: Floats) -> Floats:
        """Sum of ``values (N, ...)`` over each track: (M, ...)."""
        return np.asarray(np.add.reduceat(values, self.starts))

    def take(self, tracks: Bools) -> BodyTracks:
        """Only the tracks of a mask ``(M,)``, numbered again from 0."""
        rows = tracks[self.track]
        number = (np.cumsum(tracks) - 1).astype(np.int64)
        return BodyTracks(number[self.track[rows]], self.t_s[rows], self.xy[rows], self.sigma)


@dataclass(frozen=True)
class Unknowns:
    """``direction (3,)`` e; ``change (2,)`` a and w; ``own (M, 4)`` x, y, s and drift (sigmas per s) of each point."""

    direction: Floats
    change: Floats
    own: Floats


def direction_from_lines(tracks: BodyTracks) -> Floats:
    """A start direction ``(3,)``: where the planes of the tracks' first and last rays meet, along the motion."""
    rays = np.column_stack([tracks.xy, np.ones(len(tracks.xy))])
    last = tracks.starts + tracks.counts - 1
    return direction_from_flow(normalize(rays[tracks.starts]), normalize(rays[last]), np.eye(3))


def first_unknowns(tracks: BodyTracks, direction: Floats) -> Unknowns:
    """Start of the search: points at the means of their tracks, rates by least squares on straight paths, no drift."""
    dt, _ = tracks.times
    centre = tracks.sums(tracks.xy) / tracks.counts[:, None]
    towards = direction[:2] - centre * direction[2]
    slope = tracks.sums(dt[:, None] * tracks.xy) / tracks.sums(dt**2)[:, None]
    rate = np.sum(slope * towards, axis=1) / np.maximum(np.sum(towards**2, axis=1), 1e-6)
    return Unknowns(direction, np.zeros(2), np.column_stack([centre, rate, np.zeros(len(rate))]))


def residuals(tracks: BodyTracks, unknowns: Unknowns) -> Floats:
    """Observed less predicted positions, in sigmas: ``(N, 2)``."""
    point, _ = _points(tracks, unknowns)
    depth = np.maximum(point[:, 2:], _LEAST_DEPTH)
    drifted = unknowns.own[tracks.track, DRIFT, None] * across_lines(tracks, unknowns)
    return np.asarray((tracks.xy - point[:, :2] / depth) / tracks.sigma - drifted)


def linearised(tracks: BodyTracks, unknowns: Unknowns) -> tuple[Floats, Floats]:
    """Derivatives ``(N, 2, 8)`` of the predicted positions, in sigmas, by own and shared unknowns.

    And the basis ``(3, 2)`` of the direction's tangent plane.
    """
    dt, dq = tracks.times
    point, by_rate = _points(tracks, unknowns)
    depth = np.maximum(point[:, 2], _LEAST_DEPTH)
    basis = tangent_basis(unknowns.direction)
    rate = unknowns.own[tracks.track, RATE]
    by = np.zeros((len(dt), 3, N_OWN + N_SHARED))
    by[:, 0, 0] = by[:, 1, 1] = 1.0
    by[:, :, RATE] = by_rate
    along = rate * (dt + unknowns.change[0] * dq)
    by[:, :, 4:6] = along[:, None, None] * basis
    by[:, :, 6] = (rate * dq)[:, None] * unknowns.direction
    by[:, :, 7] = (rate * dq)[:, None] * _level_across(unknowns.direction)
    picture = point[:, :2] / depth[:, None]
    jacobian = (by[:, :2] - picture[:, :, None] * by[:, 2:]) / (depth[:, None, None] * tracks.sigma)
    jacobian[:, :, DRIFT] = across_lines(tracks, unknowns)
    return jacobian, basis


def _level_across(direction: Floats) -> Floats:
    """The level direction across ``direction``; any one across where that is upright."""
    across = np.array([direction[2], 0.0, -direction[0]])
    length = float(np.linalg.norm(across))
    return across / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])


def _points(tracks: BodyTracks, unknowns: Unknowns) -> tuple[Floats, Floats]:
    """P of each observation and its derivative by the rate, ``(N, 3)`` each."""
    dt, dq = tracks.times
    bend = unknowns.change[0] * unknowns.direction + unknowns.change[1] * _level_across(unknowns.direction)
    by_rate = dt[:, None] * unknowns.direction + dq[:, None] * bend
    own = unknowns.own[tracks.track]
    point = own[:, RATE, None] * by_rate
    point[:, :2] += own[:, :2]
    point[:, 2] += 1.0
    return point, by_rate


def across_lines(tracks: BodyTracks, unknowns: Unknowns) -> Floats:
    """Displacement of each observation by a unit drift of its point normal to its line, in sigmas: ``(N, 2)``."""
    towards = unknowns.direction[:2] - unknowns.own[:, :2] * unknowns.direction[2]
    across = np.nan_to_num(normalize(np.column_stack([-towards[:, 1], towards[:, 0]])))
    return np.asarray(across[tracks.track] * tracks.times[0][:, None])
