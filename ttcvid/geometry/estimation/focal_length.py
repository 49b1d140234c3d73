"""Self-calibration: the focal length of a camera from the motion of points of a static scene.

With a wrong focal length, no rotation and no motion past static points explains what a turning camera sees. How well a
clip determines it depends on how far the camera turns, and is part of the result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.geometry.estimation.bundle import Bundle, BundleFit, Views, adjust_bundle
from ttcvid.geometry.estimation.relative_pose import GaussianPrior, direction_from_flow, fit_motion
from ttcvid.geometry.rotation import normalize, rotation_from_vector, vector_from_rotation
from ttcvid.model import Floats

# Focal lengths that are tried as starts, in picture widths: 48, 90, 67, 34, 24 deg of view. The first shows whether
# the camera turns.
_STARTS = (1.12, 0.5, 0.75, 1.64, 2.35)
# Noise of a coordinate with which starts are compared, px, and the least that is believed.
_COARSE_PX, _LEAST_PX = 1.0, 0.05
# Residuals spread less than the noise, as they have been fitted.
_FITTED = 1.2
# Steps with the focal length held and free at each start, and of the best one with the noise as found, twice.
_HELD_STEPS, _FREE_STEPS, _LAST_STEPS = 5, 10, 40
# What is believed beforehand of log f about one picture width (53 deg), of the principal point in picture widths, and
# of the lens: KITTI's rectified pictures are off centre by 1.5 %, telephones bend lines by some per cent.
_LOG_FOCAL_SIGMA, _CENTRE_SIGMA, _DISTORTION_SIGMA = 0.5, 0.03, 0.03
# A camera that only turns is believed where each unknown of one that moves lowers the cost by less than this times what
# noise alone would do: errors of a track hang together.
_WORTH_OF_UNKNOWN = 2.0
# Square of the residuals, in those of the noise believed, below which views are exact.
_LEAST_NOISE = 0.01
# Any turn from one frame to the next is possible.
_OPEN = GaussianPrior(np.zeros(3), float(np.radians(40.0)))
# Directions of motion that are tried between neighbouring frames.
_DIRECTIONS = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class FocalFit:
    """``log_focal`` (f in px) with its standard deviation ``sigma``, and how well the views fit.

    ``spread_px`` of the residuals; ``behind`` the share of points that would lie behind the camera; ``lens_chi2``
    chi-square (three degrees of freedom) of principal point and distortion against what lenses have; ``turned_rad`` the
    largest turn of the camera, without turns about its optical axis.
    """

    log_focal: float
    sigma: float
    spread_px: float
    behind: float
    lens_chi2: float
    turned_rad: float


def fit_focal_length(views: Views, t_s: Floats, width_px: float, least_turn_rad: float) -> FocalFit | None:
    """Focal length that makes all views of a static scene consistent, by bundle adjustment.

    Principal point and radial distortion are unknowns within narrow priors: not to estimate them, but because their
    possible values make the focal length uncertain. The start assumes a constant speed over the times ``t_s (J,)`` of
    the frames. None where the camera turns by less than ``least_turn_rad`` at the first trial focal length.
    """
    mean = np.array([np.log(width_px), 0.0, 0.0, 0.0])
    sigma = np.array([_LOG_FOCAL_SIGMA, _CENTRE_SIGMA * width_px, _CENTRE_SIGMA * width_px, _DISTORTION_SIGMA])
    only_focal = np.array([_LOG_FOCAL_SIGMA, 0.0, 0.0, 0.0])
    fits = []
    for start in _STARTS:
        bundle = _start(views, t_s, start * width_px)
        held = adjust_bundle(views, bundle, _COARSE_PX, mean, np.zeros(4), _HELD_STEPS)
        if start == _STARTS[0] and _turned_rad(held.bundle) < least_turn_rad:
            return None
        fits.append(adjust_bundle(views, held.bundle, _COARSE_PX, mean, only_focal, _FREE_STEPS))
    fit, spread_px = min(fits, key=lambda one: one.cost), _COARSE_PX
    for _ in range(2):
        spread_px = max(_LEAST_PX, _FITTED * fit.spread * spread_px)
        fit = adjust_bundle(views, fit.bundle, spread_px, mean, sigma, _LAST_STEPS)
    turning = replace(fit.bundle, translation=np.zeros((views.n_frames, 3)), inverse=np.zeros(views.n_points))
    only_turning = adjust_bundle(views, turning, spread_px, mean, sigma, _LAST_STEPS, can_move=False)
    if _explains_enough(only_turning, fit, views):
        fit = only_turning
    return FocalFit(
        log_focal=float(fit.bundle.shared[0]),
        sigma=fit.log_focal_sigma,
        spread_px=fit.spread * spread_px,
        behind=float(np.mean(fit.behind)),
        lens_chi2=float(np.sum((fit.bundle.shared[1:] / sigma[1:]) ** 2)),
        turned_rad=_turned_rad(fit.bundle),
    )


def _explains_enough(turning: BundleFit, moving: BundleFit, views: Views) -> bool:
    """Whether a camera that only turns explains the views nearly as well as one that moves.

    Where there is no parallax, the distances of the points and the translations follow the noise, and take the focal
    length with them. Each of these unknowns lowers the cost by the noise squared for nothing.
    """
    n_more = views.n_points + 3 * (views.n_frames - 1)
    n_free = 2 * len(views.frame) - 2 * views.n_points - n_more - 3 * views.n_frames
    noise = max(moving.cost / max(n_free, 1), _LEAST_NOISE)
    return turning.cost - moving.cost < _WORTH_OF_UNKNOWN * noise * n_more


def _turned_rad(bundle: Bundle) -> float:
    """How far the camera has turned at most, but for the turn about its optical axis.

    That one tells nothing: it turns the picture, whatever the focal length.
    """
    return float(np.linalg.norm(np.ptp(vector_from_rotation(bundle.rotation)[:, :2], axis=0)))


def _start(views: Views, t_s: Floats, focal_px: float) -> Bundle:
    """Motions from frame to frame at a given focal length, one after the other, and the points that fit them best."""
    rays = normalize(np.column_stack([views.xy_px / focal_px, np.ones(len(views.frame))]))
    rotation, translation = np.empty((views.n_frames, 3, 3)), np.zeros((views.n_frames, 3))
    rotation[0] = np.eye(3)
    for j in range(1, views.n_frames):
        turn, direction = _step(views, rays, j, focal_px)
        rotation[j] = turn @ rotation[j - 1]
        translation[j] = turn @ translation[j - 1] + direction * (t_s[j] - t_s[j - 1])
    # The frame in the middle is what the points are told in.
    middle = views.n_frames // 2
    rotation = rotation @ rotation[middle].T
    translation = translation - rotation @ translation[middle]
    ray, inverse = _triangulated(views, rays, rotation, translation)
    return Bundle(rotation, translation, ray, inverse, np.array([np.log(focal_px), 0.0, 0.0, 0.0]))


def _step(views: Views, rays: Floats, j: int, focal_px: float) -> tuple[Floats, Floats]:
    """Rotation and ``dir`` of the scene from frame j - 1 to j, the best from several starts; none with few points."""
    before, now = np.flatnonzero(views.frame == j - 1), np.flatnonzero(views.frame == j)
    _, one, other = np.intersect1d(views.point[before], views.point[now], assume_unique=True, return_indices=True)
    before, now = before[one], now[other]
    if len(now) < len(_DIRECTIONS) + 1:
        return np.eye(3), np.zeros(3)
    flow = np.median(views.xy_px[now] - views.xy_px[before], axis=0) / focal_px
    looked = rotation_from_vector(np.array([-flow[1], flow[0], 0.0]))
    sigma_rad = np.full(len(now), _COARSE_PX / focal_px)
    observed = (rays[before], rays[now], sigma_rad, views.region[views.point[now]], _OPEN)
    turning = fit_motion(*observed, looked)
    starts = np.vstack([_DIRECTIONS, direction_from_flow(rays[before], rays[now], turning.cam_R_prev)])
    fits = [fit_motion(*observed, turn, start) for turn in (turning.cam_R_prev, np.eye(3)) for start in starts]
    best = min(fits, key=lambda one: one.cost)
    return best.cam_R_prev, best.direction if best.direction is not None else np.zeros(3)


def _triangulated(views: Views, rays: Floats, rotation: Floats, translation: Floats) -> tuple[Floats, Floats]:
    """Unit ray (N, 3) and inverse distance (N,) of each point, by linear least squares on all its views."""
    projection = np.concatenate([rotation, translation[:, :, None]], axis=2)[views.frame]
    equations = np.zeros((views.n_points, 4, 4))
    for axis in range(2):
        row = projection[:, axis] - (rays[:, axis] / rays[:, 2])[:, None] * projection[:, 2]
        np.add.at(equations, views.point, row[:, :, None] * row[:, None, :])
    _, vectors = np.linalg.eigh(equations)
    place = vectors[:, :, 0]
    depth = np.einsum("mi,mi->m", projection[:, 2], place[views.point])
    in_front = np.bincount(views.point, np.sign(depth), views.n_points)
    place = place * np.where(in_front < 0.0, -1.0, 1.0)[:, None]
    length = np.linalg.norm(place[:, :3], axis=1)
    return place[:, :3] / length[:, None], place[:, 3] / length
