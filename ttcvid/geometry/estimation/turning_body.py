"""A rigid body that turns while it moves, as its point tracks show it: a bus on a roundabout.

Its middle moves as on a circle, its acceleration turning with it: that is exact for a steady turn at a steady speed,
seen by a camera that moves steadily, however far it turns. Over a second in a junction (half a rad) a path that is a
polynomial in time, as in `shared_trajectory`, is wrong by pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.turning_points import Views, fit_turning_points, trajectory
from ttcvid.geometry.medians import median
from ttcvid.geometry.rotation import cross
from ttcvid.model import Floats

# Vehicles in junctions turn by up to 0.5 rad/s (6 m/s on a circle of 12 m); half of the time by less than 0.2.
TURN_SIGMA_RAD_S = 0.3
# A body's points lie within this of its middle's depth, as a part of it (standard deviation): it is no landscape.
_RELIEF = 0.3
# A speed below this says nothing of what an acceleration may be, in depths a second.
_LEAST_SPEED_HZ = 0.02
# At first the turn is held within this of where the search starts, so that the rest finds its place.
_HELD_RAD_S = 0.02
# The search starts with one of these turns, and with the flow over so many views.
_FIRST_TURNS_RAD_S, _FLOW_VIEWS = (0.0, 0.4, -0.4), 4
# The search ends where a step promises a smaller fall of the chi-square than this, with the turn held and free.
_ROUGH_CHI2, _FINE_CHI2 = 2.0, 0.05
# Ends of the search are one where they differ by less, as a chi-square with nine degrees of freedom: its 95 %.
_SAME_END_CHI2 = 16.9
# Step of numerical derivatives.
_STEP = 1e-6


@dataclass(frozen=True)
class TurningBody:
    """How a body moves, in units of the depth of its middle at time 0, at ``centre (3,)`` = (x, y, 1).

    ``velocity_hz, acceleration_hz2 (3,)`` of the middle at time 0, the latter turning with the body; ``turn_rad_s
    (3,)``; ``cov (9, 9)`` of the three of them in this order, by the noise as given. ``squares`` of the residuals in
    sigmas, each no larger than a robust fit counts it, and what is ``median_chi2`` of them by the degree of freedom.
    """

    centre: Floats
    velocity_hz: Floats
    acceleration_hz2: Floats
    turn_rad_s: Floats
    cov: Floats
    squares: float
    median_chi2: float

    @property
    def shared(self) -> Floats:
        """The unknowns in one: (9,)."""
        return np.concatenate([self.velocity_hz, self.acceleration_hz2, self.turn_rad_s])

    def path_turned_back(self, t_s: Floats) -> Floats:
        """Path ``(L, 3)`` of its points in views turned back by the turn; its derivative at time 0 is a unit vector."""
        rotation, shift = trajectory(np.ascontiguousarray(t_s, dtype=np.float64), self.centre, self.shared)
        return np.asarray(np.einsum("lji,lj->li", rotation, shift) / self.rate_hz)

    @property
    def rate_hz(self) -> float:
        """The length of that path's derivative at time 0 before it is made a unit vector, in depths a second."""
        return float(_normalized(self.centre, self.shared)[1])

    @property
    def start(self) -> Floats:
        """The derivative of that path at time 0, a unit vector (3,)."""
        return _normalized(self.centre, self.shared)[0][:3]

    @property
    def path_cov(self) -> Floats:
        """Covariance (9, 9) of the first and second derivative of that path at time 0, and of the turn."""
        # By central differences.
        off = _STEP * np.eye(9)
        after, before = _normalized(self.centre, self.shared + np.stack([off, -off]))[0]
        jacobian = (after - before).T / (2.0 * _STEP)
        return np.asarray(jacobian @ self.cov @ jacobian.T)


def fit_turning_body(
    xy: Floats,
    t_s: Floats,
    sigma_norm: Floats,
    bend_hz: float,
    turn_sigma_rad_s: float,
    may_do: Callable[[TurningBody], bool] = lambda _: True,
) -> TurningBody:
    """The body that its points show, by robust least squares on all of their views.

    Two motions may explain a small body alike: one, and its mirror image, which turns the other way (Necker's cube).
    The search starts with turns to both sides, and with none; by as much as what they come to is possible beside the
    best, the covariance holds it too.

    Parameters
    ----------
    xy, t_s, sigma_norm : Views ``(L, N, 2)`` in the plane z = 1 of the camera at time 0, NaN where not seen, the last
        of them at time 0 or after it, some seen; their times ``(L,)`` and noise ``(N,)``.
    bend_hz, turn_sigma_rad_s : Beliefs, per axis: acceleration over the speed, and turn.
    may_do : Whether a body may be what is looked for: where that to which the search without a turn at first comes is
        not, it is not made again. (It may be the mirror image, which explains nearly as much.)
    """
    is_seen = np.isfinite(xy[..., 0]).any(axis=1)
    xy, t_s = xy[is_seen], t_s[is_seen]
    now = int(np.argmin(np.abs(t_s)))
    # Where each point is seen then, or in the view that is nearest to that.
    order = np.argsort(np.abs(np.arange(len(xy)) - now), kind="stable")
    place = xy[order][np.isfinite(xy[order, :, 0]).argmax(axis=0), np.arange(xy.shape[1])]
    views = (
        np.ascontiguousarray(xy),
        np.ascontiguousarray(t_s, dtype=np.float64),
        np.ascontiguousarray(sigma_norm, dtype=np.float64),
        np.array([*map(median, place.T), 1.0]),
    )
    own = np.column_stack([place, np.ones(len(place))])
    first, *others = _starts(xy, t_s, now)
    found = [_fitted(views, own, first, bend_hz, turn_sigma_rad_s)]
    if may_do(found[0]):
        found += [_fitted(views, own, start, bend_hz, turn_sigma_rad_s) for start in others]
    return _with_doubts(found)


def _fitted(views: Views, own: Floats, start: Floats, bend_hz: float, turn_sigma_rad_s: float) -> TurningBody:
    """What the search comes to from a start (9,), the turn held there at first."""
    own, shared, information, others = own.copy(), start.copy(), np.eye(9), (bend_hz, _LEAST_SPEED_HZ, _RELIEF)
    fit_turning_points(views, (start[6:], _HELD_RAD_S, *others), _ROUGH_CHI2, own, shared, information)
    free = np.zeros(3), turn_sigma_rad_s, *others
    squares, median_chi2 = fit_turning_points(views, free, _FINE_CHI2, own, shared, information)
    cov: Floats = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return TurningBody(views[3], shared[:3], shared[3:6], shared[6:], cov, squares, median_chi2)


def _starts(xy: Floats, t_s: Floats, now: int) -> list[Floats]:
    """Where the search starts: as the points flow, without a turn and with one about the camera's vertical."""
    order = np.argsort(np.abs(t_s - t_s[now]), kind="stable")[1 : 1 + _FLOW_VIEWS]
    flow = (xy[order] - xy[now]) / (t_s[order] - t_s[now])[:, None, None]
    seen = flow[np.isfinite(flow[..., 0])]
    velocity_hz = np.array([*map(median, seen.T), 0.0] if len(seen) else [0.0, 0.0, 0.0])
    return [np.concatenate([velocity_hz, np.zeros(3), [0.0, turn, 0.0]]) for turn in _FIRST_TURNS_RAD_S]


def _with_doubts(found: list[TurningBody]) -> TurningBody:
    """The best of several, with a covariance that holds the others by how likely they are, each end once."""
    if len(found) == 1:
        return found[0]
    best, *others = sorted(found, key=lambda body: body.squares)
    ends = [best]
    for body in others:
        apart = np.array([body.shared - end.shared for end in ends])
        if all(np.einsum("ki,ki->k", apart, np.linalg.solve(best.cov, apart.T).T) > _SAME_END_CHI2):
            ends.append(body)
    worse = np.array([body.squares - best.squares for body in ends]) / max(1.0, best.median_chi2)
    share = np.exp(-0.5 * worse)
    apart = np.array([body.shared - best.shared for body in ends])
    cov = best.cov + np.einsum("k,ki,kj->ij", share / np.sum(share), apart, apart)
    return replace(best, cov=cov)


def _normalized(centre: Floats, shared: Floats) -> tuple[Floats, Floats]:
    """The first nine of what points share as in `shared_trajectory`, (..., 9), of a body's ``shared (..., 9)``, and the
    length of the first.

    First and second derivative at time 0 of the path in views turned back, V - omega x C and so on, both over the
    length of the first; and the turn.
    """
    velocity, acceleration, turn = shared[..., :3], shared[..., 3:6], shared[..., 6:]
    across = cross(turn, centre)
    start = velocity - across
    length = np.linalg.norm(start, axis=-1, keepdims=True)
    bend = acceleration - cross(turn, across + 2.0 * start)
    return np.concatenate([start / length, bend / length, turn], axis=-1), length[..., 0]
