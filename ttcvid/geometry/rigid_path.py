"""Points of one rigid thing on its path relative to the camera, and that path corrected by where they were seen.

The static scene and every mover are treated alike: a thing at rest in its own frame, seen from a camera that moves past
it. Its points share, for each past view, one rotation and one shift, and have a depth each:
a point at (x, y, 1) now was at (x + rho T_x, y + rho T_y, 1 + rho T_z), up to its depth, when the thing was at T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.model import Floats, Ints

# Residuals beyond this, in sigmas, count by their length, no longer by its square.
_ROBUST_SIGMAS = 3.0
# Gauss-Newton steps on a point from its last place and rate: the path changes little between two frames.
_STEPS = 2
# The depth of a point over that at time 0, 1 + rho T_z, is taken as at least this.
_LEAST_DEPTH_RATIO = 0.05


@dataclass(frozen=True)
class PathFit:
    """N points on one path.

    ``place (N, 2)`` now, in the plane z = 1; ``rate_hz (N,)`` rho with its standard deviation ``rate_sigma_hz (N,)``;
    ``misfit (N,)`` robust chi-square over its degrees of freedom, about 1 for a point that moves along the path;
    ``n_views (N,)``. NaN (misfit: 0) with fewer than two views.
    """

    place: Floats
    rate_hz: Floats
    rate_sigma_hz: Floats
    misfit: Floats
    n_views: Ints


def fit_on_path(
    xy: Floats, path: Floats, sigma_norm: Floats, rate_hz: Floats | None = None, least_rate_hz: float = 0.0
) -> PathFit:
    """Place and rate of each point, and how badly the path explains all of its views.

    In contrast to `whole_track_on_path` no view is left out: the question is not when the point arrives, but whether
    it belongs to the thing.

    Parameters
    ----------
    xy : (L, N, 2) derotated positions in the plane z = 1 of the present camera, the present last; NaN: not observed.
    path : (L, 3) where the thing was relative to the camera, less where it is now, in s of its present speed.
    sigma_norm : (N,) standard deviation of one coordinate.
    rate_hz : (N,) rates to start from; None or NaN: none.
    least_rate_hz : rates stay above it: nothing lies behind the camera, and points of one thing lie side by side.

    Source: DESIGN section 3 (w_i = s_i e).
    """
    n = xy.shape[1]
    start = np.zeros(n) if rate_hz is None else np.nan_to_num(rate_hz)
    place, rate, sigma = np.full((n, 2), np.nan), np.full(n, np.nan), np.full(n, np.nan)
    misfit, n_views = np.zeros(n), np.zeros(n, dtype=np.int64)
    steps = _STEPS if rate_hz is not None else 2 * _STEPS
    _fit_each(
        xy,
        path,
        sigma_norm,
        np.maximum(start, least_rate_hz),
        least_rate_hz,
        steps,
        place,
        rate,
        sigma,
        misfit,
        n_views,
    )
    return PathFit(place, rate, sigma, misfit, n_views)


def corrected_views(
    xy: Floats,
    path: Floats,
    fit: PathFit,
    sigma_norm: Floats,
    weight: Floats,
    turned_rad: Floats,
    shifted: Floats,
    turn_sigma_rad: Floats,
    shift_sigma: Floats,
) -> tuple[Floats, Floats]:
    """What is wrong with the rotation and the path of each past view, by the residuals of the thing's points.

    One half of an alternation whose other half is `fit_on_path`: robust least squares with six unknowns a view and
    Gaussian priors.

    Parameters
    ----------
    weight : (N,) of each point; 0 leaves it out.
    turned_rad, shifted : (L, 3) how far each view's rotation, in rad, and path lie from where the priors expect them.
    turn_sigma_rad, shift_sigma : (L,) standard deviations of the priors, the latter as a part of the path's length.

    Returns
    -------
    turn_rad : (L, 3) rotation vectors; a ray of the view is to be turned back by them. Zero for the present view.
    shift : (L, 3) to be added to the path.
    """
    turn, shift = np.zeros_like(path), np.zeros_like(path)
    if len(path) > 1:
        _correct_each(
            xy,
            path,
            fit.place,
            fit.rate_hz,
            sigma_norm,
            weight,
            turned_rad,
            shifted,
            turn_sigma_rad,
            shift_sigma,
            turn,
            shift,
        )
    return turn, shift


@compiled
def _fit_each(
    xy: Floats,
    path: Floats,
    sigma_norm: Floats,
    start: Floats,
    least: float,
    n_steps: int,
    place: Floats,
    rate: Floats,
    rate_sigma: Floats,
    misfit: Floats,
    n_views: Ints,
) -> None:
    """Fill the results of `fit_on_path`, point by point."""
    n_frames = xy.shape[0]
    limit = _ROBUST_SIGMAS * _ROBUST_SIGMAS
    for i in range(xy.shape[1]):
        n = 0
        for k in range(n_frames):
            if np.isfinite(xy[k, i, 0]):
                n += 1
        n_views[i] = n
        if n < 2 or not np.isfinite(xy[n_frames - 1, i, 0]):
            continue
        x, y, rho = xy[n_frames - 1, i, 0], xy[n_frames - 1, i, 1], start[i]
        inverse = 1.0 / (sigma_norm[i] * sigma_norm[i])
        information, chi2 = 0.0, 0.0
        for count in range(n_steps + 1):
            one, by_x, by_y, both, score_x, score_y, score, chi2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(n_frames):
                if not np.isfinite(xy[k, i, 0]):
                    continue
                h = 1.0 / max(1.0 + rho * path[k, 2], _LEAST_DEPTH_RATIO)
                px, py = (x + rho * path[k, 0]) * h, (y + rho * path[k, 1]) * h
                rx, ry = xy[k, i, 0] - px, xy[k, i, 1] - py
                square = (rx * rx + ry * ry) * inverse
                w = inverse
                if square > limit:
                    length = np.sqrt(square)
                    w *= _ROBUST_SIGMAS / length
                    chi2 += 2.0 * _ROBUST_SIGMAS * length - limit
                else:
                    chi2 += square
                jx, jy = (path[k, 0] - px * path[k, 2]) * h, (path[k, 1] - py * path[k, 2]) * h
                one += w * h * h
                by_x += w * h * jx
                by_y += w * h * jy
                both += w * (jx * jx + jy * jy)
                score_x += w * h * rx
                score_y += w * h * ry
                score += w * (jx * rx + jy * ry)
            information = both - (by_x * by_x + by_y * by_y) / one
            if count == n_steps:
                break
            change = 0.0
            if information > 0.0:
                change = (score - (by_x * score_x + by_y * score_y) / one) / information
                change = max(change, least - rho)
            x += (score_x - by_x * change) / one
            y += (score_y - by_y * change) / one
            rho += change
        place[i, 0], place[i, 1], rate[i] = x, y, rho
        rate_sigma[i] = 1.0 / np.sqrt(information)
        misfit[i] = chi2 / max(2 * n - 3, 1)


@compiled
def _correct_each(
    xy: Floats,
    path: Floats,
    place: Floats,
    rate: Floats,
    sigma_norm: Floats,
    weight: Floats,
    turned: Floats,
    shifted: Floats,
    turn_sigma: Floats,
    shift_sigma: Floats,
    turn: Floats,
    shift: Floats,
) -> None:
    """Fill the results of `corrected_views`, view by view."""
    normal, score, jx, jy = np.zeros((6, 6)), np.zeros(6), np.zeros(6), np.zeros(6)
    for k in range(path.shape[0] - 1):
        normal[:] = 0.0
        score[:] = 0.0
        for i in range(xy.shape[1]):
            if not (weight[i] > 0.0 and np.isfinite(xy[k, i, 0]) and np.isfinite(rate[i])):
                continue
            rho = rate[i]
            depth = 1.0 + rho * path[k, 2]
            if depth < _LEAST_DEPTH_RATIO:
                continue
            h = 1.0 / depth
            px, py = (place[i, 0] + rho * path[k, 0]) * h, (place[i, 1] + rho * path[k, 1]) * h
            rx, ry = xy[k, i, 0] - px, xy[k, i, 1] - py
            inverse = 1.0 / (sigma_norm[i] * sigma_norm[i])
            square = (rx * rx + ry * ry) * inverse
            w = weight[i] * inverse / (1.0 + square / (_ROBUST_SIGMAS * _ROBUST_SIGMAS))
            # Rotation of the view by a small vector, then shift of the thing.
            jx[0], jx[1], jx[2] = -px * py, 1.0 + px * px, -py
            jy[0], jy[1], jy[2] = -1.0 - py * py, px * py, px
            jx[3], jx[5] = rho * h, -px * rho * h
            jy[4], jy[5] = rho * h, -py * rho * h
            for a in range(6):
                score[a] += w * (jx[a] * rx + jy[a] * ry)
                for b in range(a + 1):
                    normal[a, b] += w * (jx[a] * jx[b] + jy[a] * jy[b])
        length = np.sqrt(path[k, 0] ** 2 + path[k, 1] ** 2 + path[k, 2] ** 2) + 1e-9
        for a in range(3):
            normal[a, a] += 1.0 / turn_sigma[k] ** 2
            score[a] -= turned[k, a] / turn_sigma[k] ** 2
            normal[3 + a, 3 + a] += 1.0 / (shift_sigma[k] * length) ** 2
            score[3 + a] -= shifted[k, a] / (shift_sigma[k] * length) ** 2
        # Cholesky, in place.
        for a in range(6):
            for b in range(a + 1):
                value = normal[a, b]
                for c in range(b):
                    value -= normal[a, c] * normal[b, c]
                normal[a, b] = np.sqrt(value) if a == b else value / normal[b, b]
        for a in range(6):
            value = score[a]
            for b in range(a):
                value -= normal[a, b] * score[b]
            score[a] = value / normal[a, a]
        for a in range(5, -1, -1):
            value = score[a]
            for b in range(a + 1, 6):
                value -= normal[b, a] * score[b]
            score[a] = value / normal[a, a]
        turn[k] = score[:3]
        shift[k] = score[3:]
