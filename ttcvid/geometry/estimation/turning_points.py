"""The motion of one body that turns, and its points, together, by damped Gauss-Newton.

A point at (x, y, 1) now, kappa times as near as the body's middle C, is seen at time t along

    X(t) = R(t) (x, y, 1) + kappa S(t),    S(t) = (1 - R(t)) C + V t + G(t) A,    G(t) = int_0^t (t - s) R(s) ds,

R(t) the rotation by omega t: the middle starts with V and has the acceleration A in axes that turn with the body, as on
a circle. Lengths are in units of the middle's depth. `N_SHARED` unknowns in this order: V, A, omega.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.kernels.path_point import ROBUST_SIGMAS
from ttcvid.geometry.rotation import rotation_from_vector, skew
from ttcvid.model import Floats

N_SHARED = 9
"""Unknowns that the points of a body share."""

_MAX_STEPS = 25
# Damping (Levenberg and Marquardt): a part of the diagonal, less after a good step, more after a bad one.
_FIRST_DAMPING, _LEAST_DAMPING, _LESS, _MORE, _MOST_DAMPING = 1e-3, 1e-7, 0.2, 8.0, 1e4
# Nothing comes nearer to the camera than this part of its present depth: a path folds over behind it.
_LEAST_DEPTH = 0.05
# Below this angle the series is more exact than the closed form, rad.
_SMALL_RAD = 1e-2
# Step of numerical derivatives by what is shared.
_STEP = 1e-5
# A velocity is known to this in any case, in depths a second: no system is without a solution.
_FASTEST_HZ = 100.0
# Unknowns of a point, and of it and the body together.
_N_OWN, _N_ALL = 3, 3 + N_SHARED


@dataclass(frozen=True)
class TurningViews:
    """Views of N points of a body: ``xy (L, 2, N)``, NaN where not seen, at ``t_s (L,)``.

    ``sigma (N,)`` is their noise, ``centre (3,)`` the body's middle now, (x, y, 1).
    """

    xy: Floats
    t_s: Floats
    sigma: Floats
    centre: Floats


@dataclass(frozen=True)
class TurningBeliefs:
    """What is believed of a turning body before its views are seen: means and standard deviations.

    ``mean_turn_rad_s (3,)`` with ``turn_sigma_rad_s``; acceleration over the speed, ``bend_hz``, of which the speed is
    taken as ``least_speed_hz`` at least; ``relief`` of kappa about 1.
    """

    mean_turn_rad_s: Floats
    turn_sigma_rad_s: float
    bend_hz: float
    least_speed_hz: float
    relief: float

    def precision(self, shared: Floats) -> Floats:
        """Information ``(9,)`` on what is shared."""
        speed_hz = max(float(np.sqrt(np.sum(shared[:3] ** 2))), self.least_speed_hz)
        return np.repeat([_FASTEST_HZ**-2, (self.bend_hz * speed_hz) ** -2, self.turn_sigma_rad_s**-2], 3)

    @property
    def mean(self) -> Floats:
        """Mean ``(9,)`` of what is shared."""
        return np.append(np.zeros(6), self.mean_turn_rad_s)


@dataclass(frozen=True)
class TurningFit:
    """Where the descent ends: ``own (N, 3)``, x, y, kappa, and ``shared (9,)``, V, A, omega.

    ``information (9, 9)`` on what is shared, once the points follow; ``squares`` of the residuals in sigmas, none
    counted for more than the robust limit, and the points' median of them by the degree of freedom, ``usual``.
    """

    own: Floats
    shared: Floats
    information: Floats
    squares: float
    usual: float


def fit_turning_points(
    views: TurningViews, beliefs: TurningBeliefs, converged_chi2: float, own: Floats, shared: Floats
) -> TurningFit:
    """Points and body where they fit best, from where they start, ``own (N, 3)`` and ``shared (9,)``.

    The search ends when a step promises a smaller fall of chi-square than ``converged_chi2``. A start that brings a
    point too near is none: nothing changes, and its squares are infinite.
    """
    at, loose = _at(views, own, shared), beliefs.relief**-2
    if at is None:
        return TurningFit(own, shared, np.eye(N_SHARED), np.inf, 1.0)
    damping, fall = _FIRST_DAMPING, 0.0
    for _ in range(_MAX_STEPS):
        # Beliefs weigh as much beside views that err by more than they should.
        scale2 = max(1.0, at.usual)
        cost = _Cost(ROBUST_SIGMAS**2 * scale2, beliefs.mean, scale2 * beliefs.precision(at.shared), scale2 * loose)
        equations, better = _equations(views, at, cost.far), None
        while damping < _MOST_DAMPING and better is None:
            system = _Reduced(equations, at.own, cost.loose, damping)
            score = system.score - cost.precision * (at.shared - cost.mean)
            information = system.information + np.diag((1.0 + damping) * cost.precision)
            step = np.asarray(np.linalg.solve(information, score), dtype=np.float64)
            fall = system.fall + float(score @ step)
            trial = _at(views, at.own + system.follow(step), at.shared + step)
            if trial is not None and cost.of(trial) < cost.of(at):
                better = trial
            else:
                damping *= _MORE
        if better is None:
            break
        at, damping = better, max(_LESS * damping, _LEAST_DAMPING)
        if fall < converged_chi2 * scale2:
            break
    # What is told at the end counts beliefs as they are.
    equations = _equations(views, at, ROBUST_SIGMAS**2 * max(1.0, at.usual))
    information = _Reduced(equations, at.own, loose, 0.0).information + np.diag(beliefs.precision(at.shared))
    return TurningFit(at.own, at.shared, information, float(np.sum(np.minimum(at.squares, ROBUST_SIGMAS**2))), at.usual)


@dataclass(frozen=True)
class _At:
    """A place of the search: points ``own (N, 3)`` and ``shared (9,)``, with R (L, 3, 3), S (L, 3) and X (L, 3, N).

    ``residual (L, 2, N)`` in sigmas, 0 where not seen; their ``squares (L, N)``; the points' median of these by the
    degree of freedom, ``usual``.
    """

    own: Floats
    shared: Floats
    rotation: Floats
    shift: Floats
    place: Floats
    residual: Floats
    squares: Floats
    usual: float


@dataclass(frozen=True)
class _Cost:
    """Squared residuals, which grow as their logarithm beyond ``far``, and beliefs.

    ``mean (9,)`` and ``precision (9,)`` of what is shared, and information on kappa, about 1, ``loose``.
    """

    far: float
    mean: Floats
    precision: Floats
    loose: float

    def of(self, at: _At) -> float:
        """The cost of a place."""
        beyond = np.log(np.maximum(at.squares / self.far, 1.0))
        of_beliefs = self.loose * np.sum((at.own[:, 2] - 1.0) ** 2) + self.precision @ (at.shared - self.mean) ** 2
        return float(np.sum(np.minimum(at.squares, self.far)) + self.far * np.sum(beyond) + of_beliefs)


def trajectory(t_s: Floats, centre: Floats, shared: Floats) -> tuple[Floats, Floats]:
    """R ``(L, 3, 3)`` and S ``(L, 3)`` at times ``(L,)`` for what is shared, ``(9,)``.

    The body's middle is now at ``centre (3,)``.
    """
    rotation, bent = _turns(t_s, shared[6:])
    return rotation, _shift(t_s, centre, shared, rotation, bent)


def _turns(t_s: Floats, turn: Floats) -> tuple[Floats, Floats]:
    """R and G ``(..., L, 3, 3)`` at times ``(L,)`` of turns ``(..., 3)``."""
    rotation = rotation_from_vector(t_s[:, None] * turn[..., None, :])
    rate = np.sqrt(np.sum(turn**2, axis=-1))[..., None, None, None]
    t = t_s[:, None, None]
    angle = rate * t
    is_small = np.abs(angle) < _SMALL_RAD
    safe = np.where(is_small, 1.0, rate)
    series = t**3 * (1.0 / 6.0 - angle**2 / 120.0), t**4 * (1.0 / 24.0 - angle**2 / 720.0)
    once = np.where(is_small, series[0], (t - np.sin(angle) / safe) / safe**2)
    twice = np.where(is_small, series[1], (0.5 * t**2 - 2.0 * (np.sin(0.5 * angle) / safe) ** 2) / safe**2)
    cross = skew(turn)[..., None, :, :]
    return rotation, 0.5 * t**2 * np.eye(3) + once * cross + twice * (cross @ cross)


def _shift(t_s: Floats, centre: Floats, shared: Floats, rotation: Floats, bent: Floats) -> Floats:
    """S ``(..., L, 3)`` of R and G ``(..., L, 3, 3)``."""
    moved = centre + t_s[:, None] * shared[:3]
    return np.asarray(moved - rotation @ centre + bent @ shared[3:6], dtype=np.float64)


def _at(views: TurningViews, own: Floats, shared: Floats) -> _At | None:
    """What the views say of points ``own (N, 3)`` and what is shared; None with a point too near."""
    rotation, shift = trajectory(views.t_s, views.centre, shared)
    place = np.asarray(rotation @ _rays(own) + shift[..., None] * own[:, 2], dtype=np.float64)
    is_seen = np.isfinite(views.xy)
    if (is_seen[:, 0] & (place[:, 2] < _LEAST_DEPTH)).any():
        return None
    residual = np.where(is_seen, (views.xy - place[:, :2] / place[:, 2:]) / views.sigma, 0.0)
    squares = np.sum(residual**2, axis=1)
    degrees = np.maximum(2 * np.sum(is_seen[:, 0], axis=0) - 3, 1)
    usual = float(np.median(np.sum(squares, axis=0) / degrees))
    return _At(own, shared, rotation, shift, place, residual, squares, usual)


def _rays(own: Floats) -> Floats:
    """(x, y, 1) of points ``own (N, 3)``: (3, N)."""
    return np.stack([own[:, 0], own[:, 1], np.ones(len(own))])


def _equations(views: TurningViews, at: _At, far: float) -> Floats:
    """Normal equations ``(N, 13, 13)`` of each point and its body; last row and column: the score.

    Squared residuals above ``far`` lose weight. How R and S follow the turn is taken by differences.
    """
    t_s, kappa = views.t_s, at.own[:, 2]
    n_views, n = len(t_s), len(at.own)
    turned, bent = _turns(t_s, at.shared[6:] + _STEP * np.eye(4, 3, -1))
    dragged = _shift(t_s, views.centre, at.shared, turned[1:], bent[1:])
    # How X follows the unknowns.
    moves = np.empty((_N_ALL, n_views, 3, n))
    moves[0], moves[1], moves[2] = at.rotation[..., 0, None], at.rotation[..., 1, None], at.shift[..., None]
    moves[3:6] = np.eye(3)[:, None, :, None] * t_s[:, None, None] * kappa
    moves[6:9] = bent[0].transpose(2, 0, 1)[..., None] * kappa
    moves[9:] = ((turned[1:] - at.rotation) @ _rays(at.own) + (dragged - at.shift)[..., None] * kappa) / _STEP
    root = np.sqrt(far / np.maximum(at.squares, far))
    depth = at.place[:, 2:]
    weight = np.where(np.isfinite(views.xy[:, :1]), root[:, None] / (depth * views.sigma), 0.0)
    rows = np.empty((_N_ALL + 1, n_views, 2, n))
    rows[:_N_ALL] = weight * (moves[:, :, :2] - at.place[:, :2] / depth * moves[:, :, 2:])
    rows[_N_ALL] = root[:, None] * at.residual
    by_point = np.ascontiguousarray(rows.reshape(_N_ALL + 1, 2 * n_views, n).transpose(2, 0, 1))
    return by_point @ by_point.transpose(0, 2, 1)


class _Reduced:
    """What N points say of their body, once each of them follows (Schur complement), with a damped diagonal.

    ``information (9, 9)`` and ``score (9,)``; ``fall``: by how much the points alone lower chi-square. ``loose`` is the
    information on kappa, about 1.
    """

    def __init__(self, equations: Floats, own: Floats, loose: float, damping: float) -> None:
        system, score = equations[:, :_N_ALL, :_N_ALL].copy(), equations[:, :_N_ALL, _N_ALL].copy()
        system[:, 2, 2] += loose
        score[:, 2] -= loose * (own[:, 2] - 1.0)
        system[:, np.arange(_N_ALL), np.arange(_N_ALL)] *= 1.0 + damping
        coupling = system[:, :_N_OWN, _N_OWN:]
        solved = np.linalg.solve(
            system[:, :_N_OWN, :_N_OWN], np.concatenate([coupling, score[:, :_N_OWN, None]], axis=2)
        )
        self._coupling, self._alone = solved[:, :, :N_SHARED], solved[:, :, N_SHARED]
        followed = np.einsum("nab,nac->bc", coupling, solved)
        self.information: Floats = np.sum(system[:, _N_OWN:, _N_OWN:], axis=0) - followed[:, :N_SHARED]
        self.score: Floats = np.sum(score[:, _N_OWN:], axis=0) - followed[:, N_SHARED]
        self.fall = float(np.sum(score[:, :_N_OWN] * self._alone))

    def follow(self, step: Floats) -> Floats:
        """Steps ``(N, 3)`` of the points for the ``step (9,)`` of what is shared."""
        return np.asarray(self._alone - self._coupling @ step, dtype=np.float64)
