"""Points of rigid things on their paths relative to the camera, and the paths corrected by where the points were seen.

The static scene and every mover are treated alike: a thing at rest in its own frame, seen from a camera that moves past
it. Its points share, for each past view, one rotation and one shift, and have a depth each:
a point at (x, y, 1) now was at (x + rho T_x, y + rho T_y, 1 + rho T_z), up to its depth, when the thing was at T.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

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
    """M points, each on the path of its thing.

    ``place (M, 2)`` now, in the plane z = 1; ``rate_hz (M,)`` rho with its standard deviation ``rate_sigma_hz (M,)``;
    ``misfit (M,)`` robust chi-square over its degrees of freedom, about 1 for a point that moves along the path;
    ``n_views (M,)``. NaN (misfit: 0) with fewer than two views.
    """

    place: Floats
    rate_hz: Floats
    rate_sigma_hz: Floats
    misfit: Floats
    n_views: Ints

    def take(self, index: Ints) -> PathFit:
        """The points that an index array picks."""
        return PathFit(*(getattr(self, f.name)[index] for f in fields(self)))


def fit_on_paths(
    xy: Floats,
    paths: Floats,
    thing: Ints,
    sigma_norm: Floats,
    rate_hz: Floats | None = None,
    least_rate_hz: float | Floats = 0.0,
) -> PathFit:
    """Place and rate of each point, and how badly the path of its thing explains all of its views.

    In contrast to `whole_track_on_path` no view is left out: the question is not when the point arrives, but whether
    it belongs to the thing.

    Parameters
    ----------
    xy : (L, M, 2) positions in the plane z = 1 of the present camera, as if the thing had not turned since; the
        present last; NaN: not observed.
    paths : (K, L, 3) where each thing was relative to the camera, less where it is now, in s of its present speed.
    thing : (M,) which of the K things each point belongs to.
    sigma_norm : (M,) standard deviation of one coordinate.
    rate_hz : (M,) rates to start from; None or NaN: none.
    least_rate_hz : rates stay above it, one for all or (M,): nothing lies behind the camera, and points of one thing
        lie side by side.

    Source: DESIGN section 3 (w_i = s_i e).
    """
    m = xy.shape[1]
    least = np.broadcast_to(np.asarray(least_rate_hz, dtype=np.float64), (m,))
    start = np.zeros(m) if rate_hz is None else np.where(np.isfinite(rate_hz), rate_hz, 0.0)
    place, rate, sigma = np.full((m, 2), np.nan), np.full(m, np.nan), np.full(m, np.nan)
    misfit, n_views = np.zeros(m), np.zeros(m, dtype=np.int64)
    steps = _STEPS if rate_hz is not None else 2 * _STEPS
    _fit_each(
        xy, paths, thing, sigma_norm, np.maximum(start, least), least.copy(), steps, place, rate, sigma, misfit, n_views
    )
    return PathFit(place, rate, sigma, misfit, n_views)


def corrected_views(
    xy: Floats,
    paths: Floats,
    thing: Ints,
    fit: PathFit,
    sigma_norm: Floats,
    weight: Floats,
    turned_rad: Floats,
    shifted: Floats,
    turn_sigma_rad: Floats,
    shift_sigma: Floats,
) -> tuple[Floats, Floats]:
    """What is wrong with the rotation and the path of each past view of each thing, by the residuals of its points.

    One half of an alternation whose other half is `fit_on_paths`: robust least squares with six unknowns a view and
    Gaussian priors.

    Parameters
    ----------
    weight : (M,) of each point; 0 leaves it out.
    turned_rad, shifted : (K, L, 3) how far each view's rotation, in rad, and path lie from where the priors expect
        them.
    turn_sigma_rad, shift_sigma : (L,) standard deviations of the priors, the latter as a part of the path's length.

    Returns
    -------
    turn_rad : (K, L, 3) rotation vectors; a ray of the view is to be turned back by them. Zero for the present view.
    shift : (K, L, 3) to be added to the path.
    """
    turn, shift = np.zeros_like(paths), np.zeros_like(paths)
    normal, score = np.zeros((*paths.shape[:2], 6, 6)), np.zeros((*paths.shape[:2], 6))
    _add_up(xy, paths, thing, fit.place, fit.rate_hz, sigma_norm, weight, normal, score)
    _solve_each(paths, turned_rad, shifted, turn_sigma_rad, shift_sigma, normal, score, turn, shift)
    return turn, shift


@compiled
def _fit_each(
    xy: Floats,
    paths: Floats,
    thing: Ints,
    sigma_norm: Floats,
    start: Floats,
    least: Floats,
    n_steps: int,
    place: Floats,
    rate: Floats,
    rate_sigma: Floats,
    misfit: Floats,
    n_views: Ints,
) -> None:
    """Fill the results of `fit_on_paths`, point by point."""
    n_frames = xy.shape[0]
    views, path = np.empty((n_frames, 2)), np.empty((n_frames, 3))
    for i in range(xy.shape[1]):
        n = 0
        for k in range(n_frames):
            if np.isfinite(xy[k, i, 0]):
                views[n, 0], views[n, 1] = xy[k, i, 0], xy[k, i, 1]
                path[n, 0], path[n, 1] = paths[thing[i], k, 0], paths[thing[i], k, 1]
                path[n, 2] = paths[thing[i], k, 2]
                n += 1
        n_views[i] = n
        if n < 2 or not np.isfinite(xy[n_frames - 1, i, 0]):
            continue
        x, y, rho = views[n - 1, 0], views[n - 1, 1], start[i]
        inverse = 1.0 / (sigma_norm[i] * sigma_norm[i])
        information, chi2 = 0.0, 0.0
        for count in range(n_steps + 1):
            one, by_x, by_y, both, score_x, score_y, score, chi2 = _sums(views, path, n, x, y, rho, inverse)
            information = both - (by_x * by_x + by_y * by_y) / one
            if count == n_steps:
                break
            change = 0.0
            if information > 0.0:
                change = (score - (by_x * score_x + by_y * score_y) / one) / information
                change = max(change, least[i] - rho)
            x += (score_x - by_x * change) / one
            y += (score_y - by_y * change) / one
            rho += change
        place[i, 0], place[i, 1], rate[i] = x, y, rho
        rate_sigma[i] = 1.0 / np.sqrt(information)
        misfit[i] = chi2 / max(2 * n - 3, 1)


@compiled
def _sums(
    views: Floats, path: Floats, n: int, x: float, y: float, rho: float, inverse: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Normal equations of x, y, rho over the first n views, and the robust chi-square.

    Returns the information on x (and y), the couplings of x and y with rho, the information on rho, the score of x, y,
    rho, and chi-square (Huber). With h = 1 / (1 + rho T_z), d (px, py) / d (x, y, rho) has the rows (h, 0, j_x) and
    (0, h, j_y), j = h (T_xy - (px, py) T_z).
    """
    one, by_x, by_y, both, score_x, score_y, score, chi2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    limit = _ROBUST_SIGMAS * _ROBUST_SIGMAS
    for k in range(n):
        depth = 1.0 + rho * path[k, 2]
        h = 1.0 / (depth if depth > _LEAST_DEPTH_RATIO else _LEAST_DEPTH_RATIO)
        px, py = (x + rho * path[k, 0]) * h, (y + rho * path[k, 1]) * h
        rx, ry = views[k, 0] - px, views[k, 1] - py
        square = (rx * rx + ry * ry) * inverse
        w = inverse
        if square > limit:
            length = np.sqrt(square)
            w *= _ROBUST_SIGMAS / length
            square = 2.0 * _ROBUST_SIGMAS * length - limit
        chi2 += square
        jx, jy = (path[k, 0] - px * path[k, 2]) * h, (path[k, 1] - py * path[k, 2]) * h
        wh = w * h
        one += wh * h
        by_x += wh * jx
        by_y += wh * jy
        both += w * (jx * jx + jy * jy)
        score_x += wh * rx
        score_y += wh * ry
        score += w * (jx * rx + jy * ry)
    return one, by_x, by_y, both, score_x, score_y, score, chi2


@compiled
def _add_up(
    xy: Floats,
    paths: Floats,
    thing: Ints,
    place: Floats,
    rate: Floats,
    sigma_norm: Floats,
    weight: Floats,
    normal: Floats,
    score: Floats,
) -> None:
    """Add all points to ``normal (K, L, 6, 6)``, its lower half, and ``score (K, L, 6)`` of each past view.

    A point seen at p = (x, y, 1) moves in the picture by B (omega x p + g s) when the view turns by omega and the
    thing shifts by s, with B = [[1, 0, -x], [0, 1, -y]] and g = rho / (1 + rho T_z). Rotations come first.
    """
    limit = _ROBUST_SIGMAS * _ROBUST_SIGMAS
    for k in range(xy.shape[0] - 1):
        for i in range(xy.shape[1]):
            if not (weight[i] > 0.0 and np.isfinite(xy[k, i, 0] + rate[i])):
                continue
            path, rho = paths[thing[i], k], rate[i]
            depth = 1.0 + rho * path[2]
            if depth < _LEAST_DEPTH_RATIO:
                continue
            h = 1.0 / depth
            x, y = (place[i, 0] + rho * path[0]) * h, (place[i, 1] + rho * path[1]) * h
            rx, ry = xy[k, i, 0] - x, xy[k, i, 1] - y
            inverse = 1.0 / (sigma_norm[i] * sigma_norm[i])
            w = weight[i] * inverse / (1.0 + (rx * rx + ry * ry) * inverse / limit)
            g = rho * h
            xx, yy, xyw, wg = 1.0 + x * x, 1.0 + y * y, w * x * y, w * g
            a, b = normal[thing[i], k], score[thing[i], k]
            a[0, 0] += w * yy * yy + xyw * x * y
            a[1, 0] -= xyw * (xx + yy)
            a[1, 1] += w * xx * xx + xyw * x * y
            a[2, 0] -= w * x
            a[2, 1] -= w * y
            a[2, 2] += w * (x * x + y * y)
            a[3, 0] -= xyw * g
            a[3, 1] += wg * xx
            a[3, 2] -= wg * y
            a[4, 0] -= wg * yy
            a[4, 1] += xyw * g
            a[4, 2] += wg * x
            a[5, 0] += wg * y * (xx + y * y)
            a[5, 1] -= wg * x * (xx + y * y)
            a[3, 3] += wg * g
            a[5, 3] -= wg * g * x
            a[5, 4] -= wg * g * y
            a[5, 5] += wg * g * (x * x + y * y)
            b[0] -= xyw * rx + w * yy * ry
            b[1] += w * xx * rx + xyw * ry
            b[2] += w * (x * ry - y * rx)
            b[3] += wg * rx
            b[4] += wg * ry
            b[5] -= wg * (x * rx + y * ry)
    for number in range(len(normal)):
        for k in range(xy.shape[0] - 1):
            normal[number, k, 4, 4] = normal[number, k, 3, 3]


@compiled
def _solve_each(
    paths: Floats,
    turned: Floats,
    shifted: Floats,
    turn_sigma: Floats,
    shift_sigma: Floats,
    normal: Floats,
    score: Floats,
    turn: Floats,
    shift: Floats,
) -> None:
    """Add the priors, and fill the results of `corrected_views` by Cholesky's decomposition, in place."""
    for number in range(len(paths)):
        for k in range(paths.shape[1] - 1):
            path, a, b = paths[number, k], normal[number, k], score[number, k]
            length = np.sqrt(path[0] ** 2 + path[1] ** 2 + path[2] ** 2) + 1e-9
            for i in range(3):
                a[i, i] += 1.0 / turn_sigma[k] ** 2
                b[i] -= turned[number, k, i] / turn_sigma[k] ** 2
                a[3 + i, 3 + i] += 1.0 / (shift_sigma[k] * length) ** 2
                b[3 + i] -= shifted[number, k, i] / (shift_sigma[k] * length) ** 2
            for i in range(6):
                for j in range(i + 1):
                    value = a[i, j]
                    for c in range(j):
                        value -= a[i, c] * a[j, c]
                    a[i, j] = np.sqrt(value) if i == j else value / a[j, j]
            for i in range(6):
                for j in range(i):
                    b[i] -= a[i, j] * b[j]
                b[i] /= a[i, i]
            for i in range(5, -1, -1):
                for j in range(i + 1, 6):
                    b[i] -= a[j, i] * b[j]
                b[i] /= a[i, i]
            for i in range(3):
                turn[number, k, i], shift[number, k, i] = b[i], b[3 + i]
