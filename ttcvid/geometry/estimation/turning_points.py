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
from ttcvid.geometry.kernels.turning_points import (
    N_ALL,
    N_OWN,
    N_SHARED,
    eliminate_points,
    set_equations,
    set_squares,
    set_trajectory,
)
from ttcvid.geometry.medians import median
from ttcvid.model import Floats

_MAX_STEPS = 25
# Damping (Levenberg and Marquardt): a part of the diagonal, less after a good step, more after a bad one.
_FIRST_DAMPING, _LEAST_DAMPING, _LESS, _MORE, _MOST_DAMPING = 1e-3, 1e-7, 0.2, 8.0, 1e4
# A velocity is known to this in any case, in depths a second: no system is without a solution.
_FASTEST_HZ = 100.0


@dataclass(frozen=True)
class TurningViews:
    """Views of N points of a body: ``xy (L, N, 2)``, NaN where not seen, at ``t_s (L,)``.

    ``sigma (N,)`` is their noise, ``centre (3,)`` the body's middle now, (x, y, 1).
    """

    xy: Floats
    t_s: Floats
    sigma: Floats
    centre: Floats

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats, Floats]:
        """All of it for the kernels."""
        return self.xy, self.t_s, self.sigma, self.centre


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
        equations, better = _Equations(views, at, cost.far, cost.loose), None
        while damping < _MOST_DAMPING and better is None:
            information, score, fall = equations.reduced(damping)
            information += np.diag((1.0 + damping) * cost.precision)
            score -= cost.precision * (at.shared - cost.mean)
            step = np.asarray(np.linalg.solve(information, score), dtype=np.float64)
            fall += float(score @ step)
            trial = _at(views, at.own + equations.follow(step), at.shared + step)
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
    information, *_ = _Equations(views, at, ROBUST_SIGMAS**2 * max(1.0, at.usual), loose).reduced(0.0)
    information += np.diag(beliefs.precision(at.shared))
    return TurningFit(at.own, at.shared, information, float(np.sum(np.minimum(at.squares, ROBUST_SIGMAS**2))), at.usual)


@dataclass(frozen=True)
class _At:
    """A place of the search: points ``own (N, 3)`` and ``shared (9,)``, and the ``way``: R (L, 3, 3) and S (L, 3).

    ``squares (N, L)`` of the residuals in sigmas, 0 where not seen; the points' median of them by the degree of
    freedom, ``usual``.
    """

    own: Floats
    shared: Floats
    way: tuple[Floats, Floats]
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
    way = np.empty((len(t_s), 3, 3)), np.empty((len(t_s), 3))
    set_trajectory(t_s, centre, shared, *way)
    return way


def _at(views: TurningViews, own: Floats, shared: Floats) -> _At | None:
    """What the views say of points ``own (N, 3)`` and what is shared; None with a point too near."""
    way = trajectory(views.t_s, views.centre, shared)
    squares, per_point = np.empty((len(own), len(views.t_s))), np.empty(len(own))
    if not set_squares(views.arrays, way, own, squares, per_point):
        return None
    return _At(own, shared, way, squares, median(per_point))


class _Equations:
    """Normal equations of each of N points and its body; ``far`` and ``loose`` as in `_Cost`."""

    def __init__(self, views: TurningViews, at: _At, far: float, loose: float) -> None:
        self._of_points = np.empty((len(at.own), N_ALL + 1, N_ALL))
        # Zeros: its upper triangle is never filled, and `follow` divides all of it.
        self._kept = np.zeros((len(at.own), N_ALL + 1, N_OWN))
        scratch = np.empty_like(at.way[0]), np.empty_like(at.way[1])
        set_equations(views.arrays, at.way, at.shared, at.own, far, loose, scratch, self._of_points)

    def reduced(self, damping: float) -> tuple[Floats, Floats, float]:
        """Information ``(9, 9)`` and score ``(9,)`` once the points follow, and by how much they alone lower the cost.

        The diagonal of the equations is damped.
        """
        information, score = np.zeros((N_SHARED, N_SHARED)), np.zeros(N_SHARED)
        fall = eliminate_points(self._of_points, damping, self._kept, information, score)
        return information + np.tril(information, -1).T, score, fall

    def follow(self, step: Floats) -> Floats:
        """Steps ``(N, 3)`` of the points for the ``step (9,)`` of what is shared, after `reduced`."""
        pivot = self._kept[:, range(N_OWN), range(N_OWN)]
        part = self._kept / np.where(pivot > 0.0, pivot, np.inf)[:, None]
        own = part[:, N_ALL] - np.einsum("nck,c->nk", part[:, N_OWN:N_ALL], step)
        own[:, 1] -= part[:, 2, 1] * own[:, 2]
        own[:, 0] -= part[:, 1, 0] * own[:, 1] + part[:, 2, 0] * own[:, 2]
        return np.where(pivot[:, 2:] > 0.0, own, 0.0)
