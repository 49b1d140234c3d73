"""Relative pose: rotation and direction of travel from the motion of the static scene between two frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import expit

from ttcvid.geometry.estimation.relative_pose import GaussianPrior, TwoViewFit, direction_from_flow, fit_motion
from ttcvid.geometry.medians import MEDIAN_NORMAL
from ttcvid.geometry.paper.epipole import MAX_DIRECTION_SIGMA_RAD
from ttcvid.geometry.paper.flow_line import flow_line_chi2
from ttcvid.geometry.rotation import normalize, rotation_from_vector, tangent_basis, vector_from_rotation
from ttcvid.model import Bools, Camera, Floats, Ints, Platform
from ttcvid.stages.egomotion.motion_prior import FORWARD_DIR, MOTION_PRIORS, EgomotionMemory, SceneWindow

# Yaw rates tried on the first pair of frames, where no previous rotation helps, rad.
_FIRST_YAWS_RAD = np.radians([0.0, -1.0, 1.0, -2.5, 2.5])
# Torr's robust information criterion (GRIC) caps a residual at lambda3 (r - d), with lambda3 = 2, r = 4.
_GRIC_CAP = 2.0
# A fit with fewer points than this part within so many sigmas has started in the wrong place.
_INLIER_SIGMAS, _GOOD_INLIERS = 3.0, 0.5
# A camera that may go anywhere is looked for in so many directions across its view, both ways, where a fit explains
# less than this part of the points: half of them may be so far away that any direction does for them.
_MOST_INLIERS, _WAYS_ACROSS = 0.9, 16
# A part of the picture is still when most of its points are. With more than this share of the parts still, there is no
# translation to speak of.
_MOST_STILL = 0.5
# A camera that moves goes on while more than this part of them moves.
_LEAST_GOES_ON = 1.0 / 3.0
# A direction that is more than so many standard deviations off its prior, although that draws it there, is at odds.
_AT_ODDS = 2.0
# Median of the length of two standard normal variables.
_MEDIAN_RAYLEIGH = 1.1774
# A camera on a mast shakes by less than so many standard deviations; fewer points than this do not tell how.
_FARTHEST_SIGMAS, _LEAST_STILL = 4.0, 6
# Number of the cells of `picture_region` along one axis, and the least z of a ray that still has a cell of its own.
_REGION_COUNT, _LEAST_Z = 200, 0.05

REGION = 0.1
"""Side of the cells whose points err together, in focal lengths (80 px at f = 800 px), or part of the picture's width.

The smaller one: through a long lens a tenth of the focal length is most of the picture.
"""

STILL_SIGMAS = 3.03
"""A point is still under a rotation alone within so many sigmas: 99 % of a 2-D Gaussian."""

DIRECTION_FLOOR_RAD = float(np.radians(0.15))
"""Own direction of travel is not known better than this: matching errs in common over large parts of the picture.

That is 2 px at f = 800 px, which its covariance does not know.
"""

_ANGLES_RAD = 2.0 * np.pi / _WAYS_ACROSS * np.arange(_WAYS_ACROSS)
_ACROSS = np.stack([np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD), np.zeros(_WAYS_ACROSS)], axis=1)


@dataclass(frozen=True)
class Egomotion:
    """Motion of the camera from an earlier frame ("prev") to this one, in the camera of this frame.

    ``cam_R_prev (3, 3)`` with the covariance ``rotation_cov (3, 3)`` of its rotation vector in rad^2; ``direction
    (3,)`` is ``dir`` of the static scene (minus the own direction of travel), None where the camera does not translate
    measurably, with ``direction_cov (3, 3)`` in its tangent plane, rad^2: the mean over the last ``gap_frames``. Where
    it is not ``is_told`` it is the best guess, too uncertain to be a result.
    ``residual (N,)`` in sigmas, of the points that determined it. ``window`` of a camera that may go anywhere.
    """

    cam_R_prev: Floats
    rotation_cov: Floats
    direction: Floats | None
    direction_cov: Floats | None
    residual: Floats
    gap_frames: int = 1
    window: SceneWindow | None = None
    is_told: bool = True

    @property
    def rotation_sigma_rad(self) -> float:
        """Standard deviation of the rotation vector, root mean square over its axes."""
        return float(np.sqrt(np.trace(self.rotation_cov) / 3.0))

    @property
    def residual_spread(self) -> float:
        """Robust standard deviation of the scene's residuals in sigmas: 1 where the noise is what was assumed.

        Movers are cut off at three times the spread, and the cut is allowed for.
        """
        size = np.sort(np.abs(self.residual))
        middle, n = MEDIAN_NORMAL if self.direction is not None else _MEDIAN_RAYLEIGH, len(size)
        spread = 0.5 * (size[(n - 1) // 2] + size[n // 2]) / middle
        for _ in range(3):
            n = int(np.searchsorted(size, _INLIER_SIGMAS * spread, side="right"))
            spread = 0.5 * (size[(n - 1) // 2] + size[n // 2]) / middle
        return float(spread)

    @cached_property
    def rotation_rad(self) -> Floats:
        """Rotation vector of ``cam_R_prev``, ``(3,)`` rad."""
        return vector_from_rotation(self.cam_R_prev)


@dataclass(frozen=True)
class RayPairs:
    """The same N points in an earlier and in the present frame.

    ``before, now (N, 3)`` are their unit rays, each in its own camera; ``sigma_rad (N,)`` the noise of one coordinate;
    ``region (N,)`` the part of the picture that each lies in (`picture_region`); ``had_moved (N,)`` whether it had
    moved before the earlier frame, but for the camera's turn, since it was first seen; None where that is not known.
    """

    before: Floats
    now: Floats
    sigma_rad: Floats
    region: Ints
    had_moved: Bools | None = None

    @property
    def observed(self) -> tuple[Floats, Floats, Floats, Ints]:
        """What a fit is to: the rays, their noise and their parts of the picture."""
        return self.before, self.now, self.sigma_rad, self.region


def estimate_egomotion(
    pairs: RayPairs, least_parallax_rad: float, memory: EgomotionMemory, platform: Platform
) -> TwoViewFit:
    """Rotation and direction of travel by robust Gauss-Newton with priors.

    Every static point moves in the plane of its ray and the direction of travel, by an unknown amount: the residual is
    its distance from that plane, in sigmas. Movers lose their weight (Geman and McClure). Rotation without translation
    is chosen where it explains the same flow (Torr's GRIC).

    Parameters
    ----------
    pairs : Points of the scene.
    least_parallax_rad : Flow left after the rotation that does not count as translation, however small the noise:
        matching has common errors where light or blur change.
    memory : Start of the search.
    platform : What carries the camera: the prior.

    Notes
    -----
    An essential matrix from random samples of five points fails where the flow is small and the motion forward: it
    trades yaw for sideways translation. The prior on the change of the rotation prevents that.
    """
    belief = MOTION_PRIORS[platform]
    prior = memory.prior(belief)
    observed = pairs.observed
    turning = _best([fit_motion(*observed, prior, start) for start in _rotation_starts(prior, memory)])
    if not belief.can_translate:
        return _shaking((*observed, prior), turning)
    moving = _fit_from_starts((*observed, prior), turning.cam_R_prev, memory)
    if memory.usual is not None and prior.direction is not None and belief.direction_sigma_rad is not None:
        if not memory.goes_on:
            # It may go back. That is as unlikely as before its usual direction was known: the opposite of a direction
            # is 2 / sigma off.
            back = replace(prior, direction=-prior.direction)
            other = _fit_from_starts((*observed, back), turning.cam_R_prev, replace(memory, direction=back.direction))
            if other.cost + 4.0 / belief.direction_sigma_rad**2 < moving.cost:
                moving, prior = other, back
        moving = _weighed(moving, observed, prior, belief.direction_sigma_rad)
        if memory.goes_on and moving.sense.sum() < 0.0:
            # Most points go the other way: they are of movers, or the camera has begun to go back.
            moving = replace(moving, doubt=np.eye(3))
    may_move = moving.direction is not None and not belief.excludes(moving.direction)
    may_move = may_move and _is_translation(turning, moving, pairs, least_parallax_rad)
    return moving if may_move else turning


def _weighed(
    fit: TwoViewFit, observed: tuple[Floats, Floats, Floats, Ints], prior: GaussianPrior, wide_rad: float
) -> TwoViewFit:
    """A fit with the prior of its direction weighed anew: as what the points say is, whose neighbours err together.

    One whose direction is at odds with the prior has that of a camera of which nothing is known, ``wide_rad``.
    """
    assert fit.direction is not None
    assert prior.direction is not None
    off_rad = float(np.linalg.norm(fit.direction - prior.direction))
    is_at_odds = off_rad > _AT_ODDS * prior.direction_sigma_rad
    sigma_rad = wide_rad if is_at_odds else prior.direction_sigma_rad / math.sqrt(fit.spread_ratio)
    return fit_motion(*observed, replace(prior, direction_sigma_rad=sigma_rad), fit.cam_R_prev, fit.direction)


def with_doubt(fit: TwoViewFit, pairs: RayPairs, memory: EgomotionMemory, platform: Platform) -> TwoViewFit:
    """A fit with the doubt that fits from other starts cast on its direction, where it leaves much unexplained.

    That is the worst of theirs, by its likelihood beside this one. Parameters as of `estimate_egomotion`.
    """
    belief = MOTION_PRIORS[platform]
    prior, sigma_rad = memory.prior(belief), belief.direction_sigma_rad
    if fit.direction is None or prior.direction is None or sigma_rad is None:
        return fit
    if np.mean(_explained(fit)) >= _MOST_INLIERS:
        return fit
    expected = prior.direction if fit.direction @ prior.direction >= 0.0 else -prior.direction
    prior, starts = replace(prior, direction=expected), _around(expected, sigma_rad)
    others = [fit_motion(*pairs.observed, prior, fit.cam_R_prev, start) for start in starts]
    noise = max(1.0, float(np.median(np.abs(fit.residual))) / MEDIAN_NORMAL)
    off = np.array([other.direction for other in others]) - fit.direction
    likely = expit(0.5 * np.array([fit.cost - other.cost for other in others]) / noise**2)
    worst = int(np.argmax(likely * (off * off).sum(axis=1)))
    return replace(fit, doubt=fit.doubt + likely[worst] * np.outer(off[worst], off[worst]))


def egomotion_of(fit: TwoViewFit) -> Egomotion:
    """Own motion as a fit has it."""
    if fit.direction is None:
        return Egomotion(fit.cam_R_prev, fit.covariance, None, None, fit.residual)
    basis = tangent_basis(fit.direction)
    direction_cov = basis @ (fit.covariance[:2, :2] + basis.T @ fit.doubt @ basis) @ basis.T
    is_told = bool(np.trace(direction_cov) < MAX_DIRECTION_SIGMA_RAD**2)
    return Egomotion(
        fit.cam_R_prev, fit.covariance[2:, 2:], fit.direction, direction_cov, fit.residual, is_told=is_told
    )


def cost_of(fit: TwoViewFit, pairs: RayPairs) -> float:
    """Cost of a fit on some points, also on others than those behind it: Torr's criterion, less is better.

    A point that moves against the direction lies behind the camera, and has the largest cost of a point.
    """
    turned = pairs.before @ fit.cam_R_prev.T
    off = pairs.now - turned
    if fit.direction is None:
        return _criterion(0.5 * np.einsum("ni,ni->n", off, off) / pairs.sigma_rad**2, 2, 3)
    squares = flow_line_chi2(fit.direction, turned, pairs.now, pairs.sigma_rad)
    is_behind = off @ fit.direction < -_INLIER_SIGMAS * pairs.sigma_rad
    return _criterion(np.where(is_behind, np.inf, squares), 3, 5)


def region_side_of(camera: Camera) -> float:
    """Side of the cells of `picture_region`, in the plane z = 1."""
    return REGION * min(1.0, camera.image_size.longer_side_px / camera.fx_px)


def picture_region(rays: Floats, side: float = REGION) -> Ints:
    """Number of the cell of a coarse grid over the picture that each ray ``(N, 3)`` lies in: (N,), without gaps."""
    half, deep = _REGION_COUNT // 2, side * np.fmax(rays[:, 2:], _LEAST_Z)
    # A ray that is not known (NaN) has its place in the corner.
    cell = np.fmax(np.minimum(np.floor(rays[:, :2] / deep), half - 1.0), -half)
    number = ((cell + half) @ (1.0, _REGION_COUNT)).astype(np.int64)
    number -= number.min(initial=_REGION_COUNT * _REGION_COUNT)
    return (np.cumsum(np.bincount(number) > 0) - 1)[number]


def _rotation_starts(prior: GaussianPrior, memory: EgomotionMemory) -> list[Floats]:
    """The expected rotation, or several yaws where there is no previous frame to expect one from."""
    if memory.rotation_rad is not None:
        return [prior.cam_R_prev]
    return [rotation_from_vector(np.array([0.0, yaw_rad, 0.0])) for yaw_rad in _FIRST_YAWS_RAD]


def _shaking(observed: tuple[Floats, Floats, Floats, Ints, GaussianPrior], turning: TwoViewFit) -> TwoViewFit:
    """The rotation of a camera on a mast: ``turning``, unless that is a lorry that passes before it.

    It only shakes. A turn beyond that is one where it explains the flow of most points (a camera that is panned after
    all); a surface that goes past is no turn: what is nearer to the border of the picture moves as far there, and would
    move farther. The camera then shakes as the points do that have moved no farther than that.
    """
    rays_prev, rays_cam, sigma_rad, region, prior = observed
    farthest_rad = _FARTHEST_SIGMAS * prior.rotation_sigma_rad
    shaken_rad = float(np.linalg.norm(vector_from_rotation(turning.cam_R_prev @ prior.cam_R_prev.T)))
    if shaken_rad < farthest_rad or np.mean(turning.residual < _INLIER_SIGMAS) > _GOOD_INLIERS:
        return turning
    stays = np.linalg.norm(rays_cam - rays_prev, axis=1) < farthest_rad
    if np.count_nonzero(stays) < _LEAST_STILL:
        # Only movers: the noise is not observed either.
        rows, residual = np.empty((4, 0)), np.array([_MEDIAN_RAYLEIGH])
        information = prior.rotation_sigma_rad**-2.0 * np.eye(3)
        return TwoViewFit(prior.cam_R_prev, None, residual, 0.0, information, rows, region[:0], np.zeros(1))
    still = (rays_prev[stays], rays_cam[stays], sigma_rad[stays], region[stays], prior)
    return fit_motion(*still, prior.cam_R_prev)


def _fit_from_starts(
    observed: tuple[Floats, Floats, Floats, Ints, GaussianPrior], turning_R: Floats, memory: EgomotionMemory
) -> TwoViewFit:
    """The best fit from the last motion; on a first pair, or when that explains little, from other starts too.

    Further starts: the rotation that explains most of the flow by itself (a camera that was swung), each with the
    last direction, forward, and the direction in which the flow planes meet. The residuals do not tell a direction from
    its opposite, and no search leads from one to the other: where more points would lie behind the camera than before
    it, the opposite is tried as well (a car that backs out of where it stopped).

    A camera that may go anywhere sways across its view in turn: from the wrong side no search comes round, the points
    nearby are rejected like movers, and those far away show no translation.
    """
    rays_prev, rays_cam, _, _, prior = observed
    last = FORWARD_DIR if memory.direction is None else memory.direction
    fits = [fit_motion(*observed, prior.cam_R_prev, last)]
    n_inliers = np.count_nonzero(np.abs(fits[0].residual) < _INLIER_SIGMAS)
    if memory.direction is None or n_inliers < _GOOD_INLIERS * len(rays_cam):
        rotations = [turning_R] if memory.rotation_rad is not None else [*_rotation_starts(prior, memory), turning_R]
        for rotation in rotations:
            flow_direction = direction_from_flow(rays_prev, rays_cam, rotation)
            fits += [fit_motion(*observed, rotation, start) for start in (last, flow_direction)]
    best = _best(fits)
    if prior.direction is None and np.mean(_explained(best)) < _MOST_INLIERS:
        best = _best([best, *(fit_motion(*observed, turning_R, start) for start in _ACROSS)])
    if best.sense.sum() < 0.0 and best.direction is not None:
        best = _best([best, fit_motion(*observed, best.cam_R_prev, -best.direction)])
    return best


def _around(direction: Floats, sigma_rad: float) -> Floats:
    """A direction ``(3,)``, and four that are a standard deviation off it: (5, 3)."""
    across = math.tan(sigma_rad) * tangent_basis(direction).T
    return normalize(direction + np.concatenate([np.zeros((1, 3)), across, -across]))


def _explained(fit: TwoViewFit) -> Bools:
    """Points (N,) that a fit explains."""
    return np.asarray((np.abs(fit.residual) < _INLIER_SIGMAS) & (fit.sense >= 0.0))


def _is_translation(turning: TwoViewFit, moving: TwoViewFit, pairs: RayPairs, least_parallax_rad: float) -> bool:
    """Whether the flow speaks of translation: by GRIC, and not by a few movers before a resting camera.

    With the camera at rest the flow of the movers alone also meets somewhere, and one lorry can hold 40 % of all
    points: translation has to be seen in half of the parts of the picture. Nor by dirt on the lens: as the camera
    turns, it looks like a scene near by that goes across. Where a moving camera may have stopped, only a part says so
    that had moved and is still now: what is too far away never moves. (Unless it is most of the picture: then movers
    may be all that moves.)
    """
    if _criterion(turning.residual**2, 2, 3) <= _criterion(moving.residual**2, 3, 5):
        return False
    flow_rad = turning.residual * np.sqrt(2.0) * pairs.sigma_rad
    half = 0.5 * np.bincount(pairs.region)
    is_point_still = (turning.residual < STILL_SIGMAS) | (flow_rad < least_parallax_rad)
    moved_rad = np.linalg.norm(pairs.now - pairs.before, axis=1)
    is_point_still |= _are_stuck(moved_rad, ~is_point_still, least_parallax_rad)
    is_still = np.bincount(pairs.region, is_point_still) > half
    if pairs.had_moved is None:
        return bool(np.mean(is_still) < _MOST_STILL)
    tells = ~is_still | (np.bincount(pairs.region, pairs.had_moved) > half)
    goes_on = np.mean(is_still) < 1.0 - _LEAST_GOES_ON
    return bool(goes_on and np.count_nonzero(is_still & tells) < _MOST_STILL * np.count_nonzero(tells))


def _are_stuck(moved_rad: Floats, differs: Bools, least_rad: float) -> Bools:
    """Points (N,) fixed to the camera, which turns: of those that do not follow its turn, what ``differs (N,)``.

    They have moved by ``moved_rad (N,)``, less than ``least_rad``. Of a scene in motion some do so by chance, about as
    many as move by as much more: there are flows of all lengths.
    """
    is_near = differs & (moved_rad < 2.0 * least_rad)
    is_stuck: Bools = is_near & (moved_rad < least_rad)
    n_near, n_stuck = np.count_nonzero(is_near), np.count_nonzero(is_stuck)
    return is_stuck & (2 * n_stuck - n_near > _INLIER_SIGMAS * math.sqrt(n_near))


def _best(fits: list[TwoViewFit]) -> TwoViewFit:
    return min(fits, key=lambda fit: fit.cost)


def _criterion(squares: Floats, dimension: int, n_parameters: int) -> float:
    """Torr's criterion of a two-view model: ``dimension`` of its manifold in the 4-D space of point pairs.

    ``squares (N,)`` are squared residuals in sigmas.
    """
    n = len(squares)
    capped = np.minimum(squares, _GRIC_CAP * (4 - dimension))
    return float(capped.sum()) + math.log(4.0) * dimension * n + math.log(4.0 * n) * n_parameters
