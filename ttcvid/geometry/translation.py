"""The direction of a rigid body that moves in a straight line before a resting camera, from whole point tracks.

Point i of the body is at ``P_i(t) = r_i + s_i (dt e + dq (a e + w b))``, in units of its depth at its own middle time:
r_i = (x_i, y_i, 1) is its ray there, s_i = |V| / Z_i its rate, e the unit direction shared by all points. dt and dq are
the differences of tau and tau^2 / 2 to the point's middle time, tau being the time from the body's middle. The lines of
the points meet at e in the picture (the vanishing point), and the speed-up along each line tells how far away it is.

Two nuisances are held near zero by priors: ``a`` the change of speed (1/s) and ``w`` the rate of turning (rad/s)
towards b, the level direction across e. They keep a body that brakes, or turns imperceptibly, from being believed too
much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.rotation import normalize, tangent_basis
from ttcvid.model import Bools, Floats, Ints

N_OWN, N_SHARED = 3, 4
"""Unknowns of a point (x, y, s) and of the body (two of the direction, a, w)."""
_MAX_ITERATIONS = 40
# A step shorter than this, rad, ends the search.
_CONVERGED_RAD = 1e-7
# Longest step of the direction, rad, and of a and w.
_LONGEST_STEP = 0.3
# Scale of the Cauchy weights of an observation, in sigmas of its two coordinates.
_CAUCHY_SIGMAS = 3.0
# Least depth that a point may come to, in units of its middle depth: behind that a path folds over.
_LEAST_DEPTH = 0.02
# Median of the length of two standard normal variables.
_MEDIAN_RAYLEIGH = 1.1774


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

    @property
    def starts(self) -> Ints:
        """Row of the first observation of each track: (M,)."""
        return np.flatnonzero(np.diff(self.track, prepend=-1))

    def take(self, tracks: Bools) -> BodyTracks:
        """Only the tracks of a mask ``(M,)``, numbered anew."""
        rows = tracks[self.track]
        number = np.cumsum(tracks) - 1
        return BodyTracks(number[self.track[rows]].astype(np.int64), self.t_s[rows], self.xy[rows], self.sigma)


@dataclass(frozen=True)
class Translation:
    """A body's direction of motion.

    ``direction (3,)`` is ``dir`` = V / |V| with ``covariance (3, 3)`` in its tangent plane, rad^2, which allows for
    errors that last over several frames and are common to the tracks. ``speed_change_hz`` and ``turn_rad_s`` are a and
    w, with the standard deviation ``turn_sigma_rad_s``. ``noise`` is the noise found, in units of the one assumed;
    ``correlation`` how many times the variance is larger than independent errors would make it;
    ``rate_hz (M,)`` is s of each track, ``residual (M,)`` its root mean square residual in sigmas of the noise found.
    """

    direction: Floats
    covariance: Floats
    speed_change_hz: float
    turn_rad_s: float
    turn_sigma_rad_s: float
    noise: float
    correlation: float
    rate_hz: Floats
    residual: Floats


@dataclass(frozen=True)
class _Unknowns:
    direction: Floats
    change: Floats
    own: Floats


def fit_translation(
    tracks: BodyTracks,
    start: Floats,
    speed_change_sigma_hz: float,
    turn_sigma_rad_s: float,
    memory_s: float,
) -> Translation | None:
    """Maximum likelihood of the direction of a body, None where it does not converge.

    Gauss-Newton on the reprojection error with Cauchy weights; the unknowns of each point are eliminated.

    Parameters
    ----------
    start
        ``(3,)`` a first direction, its sign along the motion.
    speed_change_sigma_hz, turn_sigma_rad_s
        Priors of the nuisances (standard deviations).
    memory_s
        Errors farther apart in time than this are independent; nearer ones are taken as they are found.
    """
    times = _times(tracks)
    unknowns = _started(tracks, times, start)
    prior = 1.0 / np.array([np.inf, np.inf, speed_change_sigma_hz, turn_sigma_rad_s]) ** 2
    cost, damping, noise = np.inf, 1e-3, 1.0
    for _ in range(_MAX_ITERATIONS):
        residual, jacobian, basis = _linearised(tracks, times, unknowns)
        if residual is None:
            return None
        size = np.linalg.norm(residual, axis=1)
        noise = max(float(np.median(size)) / _MEDIAN_RAYLEIGH, 1e-3)
        weight = 1.0 / (1.0 + (size / (noise * _CAUCHY_SIGMAS)) ** 2)
        step_shared, step_own = _step(tracks, residual, jacobian, weight, noise, unknowns, prior, damping)
        if not (np.isfinite(step_shared).all() and np.isfinite(step_own).all()):
            return None
        trial = _moved(unknowns, basis, step_shared, step_own)
        cost, trial_cost = (_cost(tracks, times, one, noise, prior) for one in (unknowns, trial))
        if trial_cost <= cost:
            unknowns, damping = trial, max(damping * 0.2, 1e-9)
            if np.abs(step_shared).max() < _CONVERGED_RAD:
                break
        else:
            damping *= 8.0
            if damping > 1e6:
                break
    return _result(tracks, times, unknowns, prior, memory_s)


def direction_from_lines(tracks: BodyTracks) -> Floats:
    """A first direction ``(3,)``: where the planes of the tracks' first and last rays meet, along the motion."""
    rays = np.column_stack([tracks.xy, np.ones(len(tracks.xy))])
    first, last = tracks.starts, np.append(tracks.starts[1:], len(rays)) - 1
    q, p = normalize(rays[first]), normalize(rays[last])
    normals = np.cross(q, p)
    # The mean flow makes one more plane to lie in: parallel lines then meet far away along it, not anywhere.
    _, vectors = np.linalg.eigh(normals.T @ normals)
    direction: Floats = vectors[:, 0]
    flow = (p - q).sum(axis=0)
    return direction if direction @ flow >= 0 else -direction


def _times(tracks: BodyTracks) -> tuple[Floats, Floats]:
    """The dt and dq of each observation, ``(N,)``."""
    tau = tracks.t_s - 0.5 * (tracks.t_s.min() + tracks.t_s.max())
    count = np.diff(np.append(tracks.starts, len(tau)))
    middle = (np.add.reduceat(tau, tracks.starts) / count)[tracks.track]
    return tau - middle, 0.5 * (tau**2 - middle**2)


def _started(tracks: BodyTracks, times: tuple[Floats, Floats], start: Floats) -> _Unknowns:
    """Points at the means of their tracks, rates by least squares on the straight path."""
    dt, _ = times
    starts = tracks.starts
    count = np.diff(np.append(starts, len(dt)))[:, None]
    centre = np.add.reduceat(tracks.xy, starts) / count
    towards = start[:2] - centre * start[2]
    slope = np.add.reduceat(dt[:, None] * tracks.xy, starts) / np.add.reduceat(dt**2, starts)[:, None]
    rate = np.sum(slope * towards, axis=1) / np.maximum(np.sum(towards**2, axis=1), 1e-6)
    return _Unknowns(start, np.zeros(2), np.column_stack([centre, rate]))


def _across(direction: Floats) -> Floats:
    """The level direction across ``direction``; any one across where that is upright."""
    across = np.array([direction[2], 0.0, -direction[0]])
    length = float(np.linalg.norm(across))
    return across / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])


def _points(tracks: BodyTracks, times: tuple[Floats, Floats], unknowns: _Unknowns) -> tuple[Floats, Floats]:
    """P of each observation and its derivative by the rate, ``(N, 3)`` each."""
    dt, dq = times
    bend = unknowns.change[0] * unknowns.direction + unknowns.change[1] * _across(unknowns.direction)
    by_rate = dt[:, None] * unknowns.direction + dq[:, None] * bend
    own = unknowns.own[tracks.track]
    point = own[:, 2:] * by_rate
    point[:, :2] += own[:, :2]
    point[:, 2] += 1.0
    return point, by_rate


def _residuals(tracks: BodyTracks, point: Floats) -> Floats:
    depth = np.maximum(point[:, 2:], _LEAST_DEPTH)
    result: Floats = (tracks.xy - point[:, :2] / depth) / tracks.sigma
    return result


def _cost(tracks: BodyTracks, times: tuple[Floats, Floats], unknowns: _Unknowns, noise: float, prior: Floats) -> float:
    residual = _residuals(tracks, _points(tracks, times, unknowns)[0]) / noise
    square = np.sum(residual**2, axis=1) / _CAUCHY_SIGMAS**2
    return float(_CAUCHY_SIGMAS**2 * np.log1p(square).sum() + prior[2:] @ unknowns.change**2)


def _linearised(tracks: BodyTracks, times: tuple[Floats, Floats], unknowns: _Unknowns) -> tuple[Floats, Floats, Floats]:
    """Residuals ``(N, 2)``, minus their derivatives ``(N, 2, 7)`` by own and shared unknowns, and the basis."""
    dt, dq = times
    point, by_rate = _points(tracks, times, unknowns)
    residual = _residuals(tracks, point)
    depth = np.maximum(point[:, 2], _LEAST_DEPTH)
    basis = tangent_basis(unknowns.direction)
    rate = unknowns.own[tracks.track, 2]
    by = np.zeros((len(dt), 3, N_OWN + N_SHARED))
    by[:, 0, 0] = by[:, 1, 1] = 1.0
    by[:, :, 2] = by_rate
    along = rate * (dt + unknowns.change[0] * dq)
    by[:, :, 3:5] = along[:, None, None] * basis
    by[:, :, 5] = (rate * dq)[:, None] * unknowns.direction
    by[:, :, 6] = (rate * dq)[:, None] * _across(unknowns.direction)
    picture = point[:, :2] / depth[:, None]
    jacobian = (by[:, :2] - picture[:, :, None] * by[:, 2:]) / (depth[:, None, None] * tracks.sigma)
    return residual, jacobian, basis


def _eliminated(tracks: BodyTracks, jacobian: Floats, weight: Floats, damping: float) -> tuple[Floats, Floats]:
    """Inverse of each track's own block ``(M, 3, 3)`` and its mixed block ``(M, 3, 4)``."""
    own, shared = jacobian[:, :, :N_OWN], jacobian[:, :, N_OWN:]
    block = np.add.reduceat(np.einsum("nki,nkj,n->nij", own, own, weight), tracks.starts)
    mixed = np.add.reduceat(np.einsum("nki,nkj,n->nij", own, shared, weight), tracks.starts)
    diagonal = np.einsum("mii->mi", block)
    diagonal *= 1.0 + damping
    diagonal += 1e-12
    return np.linalg.inv(block), mixed


def _step(
    tracks: BodyTracks,
    residual: Floats,
    jacobian: Floats,
    weight: Floats,
    noise: float,
    unknowns: _Unknowns,
    prior: Floats,
    damping: float,
) -> tuple[Floats, Floats]:
    """Gauss-Newton step of the shared ``(4,)`` and own ``(M, 3)`` unknowns."""
    inverse, mixed = _eliminated(tracks, jacobian, weight, damping)
    own, shared = jacobian[:, :, :N_OWN], jacobian[:, :, N_OWN:]
    own_side = np.add.reduceat(np.einsum("nki,nk,n->ni", own, residual, weight), tracks.starts)
    gain = np.einsum("mij,mjk->mik", inverse, mixed)
    matrix = np.einsum("nki,nkj,n->ij", shared, shared, weight) - np.einsum("mij,mik->jk", mixed, gain)
    side = np.einsum("nki,nk,n->i", shared, residual, weight) - np.einsum("mik,mi->k", gain, own_side)
    matrix += np.diag(prior) * noise**2
    side -= prior * noise**2 * np.concatenate([np.zeros(2), unknowns.change])
    matrix += np.diag(damping * np.diag(matrix) + 1e-12)
    step: Floats = np.linalg.solve(matrix, side)
    step *= min(1.0, _LONGEST_STEP / max(float(np.abs(step).max()), 1e-12))
    return step, np.einsum("mij,mj->mi", inverse, own_side) - gain @ step


def _moved(unknowns: _Unknowns, basis: Floats, shared: Floats, own: Floats) -> _Unknowns:
    return _Unknowns(
        normalize(unknowns.direction + basis @ shared[:2]), unknowns.change + shared[2:], unknowns.own + own
    )


def _result(
    tracks: BodyTracks, times: tuple[Floats, Floats], unknowns: _Unknowns, prior: Floats, memory_s: float
) -> Translation | None:
    residual, jacobian, basis = _linearised(tracks, times, unknowns)
    size = np.linalg.norm(residual, axis=1)
    noise = max(float(np.median(size)) / _MEDIAN_RAYLEIGH, 1e-3)
    weight = 1.0 / (1.0 + (size / (noise * _CAUCHY_SIGMAS)) ** 2)
    inverse, mixed = _eliminated(tracks, jacobian, weight, 0.0)
    gain = np.einsum("mij,mjk->mik", inverse, mixed)
    own, shared = jacobian[:, :, :N_OWN], jacobian[:, :, N_OWN:]
    # Derivative of each observation by the shared unknowns once the own ones have followed.
    free = shared - np.einsum("nki,nij->nkj", own, gain[tracks.track])
    information = np.einsum("nki,nkj,n->ij", free, free, weight) / noise**2
    posterior = np.linalg.inv(information + np.diag(prior) + 1e-12 * np.eye(N_SHARED))
    scores = np.einsum("nki,nk,n->ni", free, residual, weight) / noise**2
    correlation = _correlation(tracks.t_s, scores, information, memory_s)
    covariance = posterior @ (correlation * information + np.diag(prior)) @ posterior
    if not np.isfinite(covariance).all():
        return None
    count = np.diff(np.append(tracks.starts, len(size)))
    per_track = np.sqrt(np.add.reduceat(size**2, tracks.starts) / (2 * count)) / noise
    return Translation(
        direction=unknowns.direction,
        covariance=basis @ covariance[:2, :2] @ basis.T,
        speed_change_hz=float(unknowns.change[0]),
        turn_rad_s=float(unknowns.change[1]),
        turn_sigma_rad_s=float(np.sqrt(covariance[3, 3])),
        noise=noise,
        correlation=correlation,
        rate_hz=unknowns.own[:, 2],
        residual=per_track,
    )


def _correlation(t_s: Floats, scores: Floats, information: Floats, memory_s: float) -> float:
    """Variance of the direction over what independent errors would give, at least 1.

    The scores of all tracks are added up frame by frame, which keeps what they have in common (a walker's bob), and the
    frames are linked up to ``memory_s`` apart with triangular weights (Newey and West, Econometrica 1987).
    """
    frame_t_s, frame = np.unique(t_s, return_inverse=True)
    sums = np.zeros((len(frame_t_s), scores.shape[1]))
    np.add.at(sums, frame, scores)
    apart = np.abs(frame_t_s[:, None] - frame_t_s[None, :])
    memory_s = min(memory_s, 0.25 * float(frame_t_s[-1] - frame_t_s[0]))
    kernel = np.maximum(1.0 - apart / max(memory_s, 1e-9), 0.0)
    spread = sums.T @ kernel @ sums
    part = slice(0, 2)
    inverse = np.linalg.pinv(information[part, part])
    return max(1.0, 0.5 * float(np.trace(inverse @ spread[part, part])))
