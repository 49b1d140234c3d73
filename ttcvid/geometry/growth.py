"""The velocity over the depth of a small thing, from how its picture moves and grows: three unknowns for all tracks.

A point at (x, y) now, in the plane z = 1, of a thing that moves by (a, b, c) = V / Z and is small against its distance,
was at ((x + a t) / (1 + c t), (y + b t) / (1 + c t)). Multiplied out, that is linear in the place and in (a, b, c).
What a track says of them is a sum: any set of tracks is fitted by adding up. (A noisy place in the column of c pulls c
to zero: here by the square of the noise over that of the thing's size. Views of when the thing was smaller count as
much as the present one: where c t is 0.3, their noise is 1.3 times as large as it is taken to be.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled
from ttcvid.model import Bools, Floats

# Sums of a track: information on a (and b), couplings of a and b with c, information on c, score of a, b, c, squared
# residuals.
_N_SUMS = 8
# A track fits a velocity that explains it worse than the scene by no more than this, in units of what is usual; misfits
# below the first are noise.
_NOISE, _NOT_WORSE = 1.0, 1.0
# The tracks that fit what two of them say, then those that fit what all of these say: so often.
_ROUNDS = 3


@dataclass(frozen=True)
class GrowthSums:
    """What each of M tracks says of the velocity over the depth w = (a, b, c) of its thing, its place taken out.

    Its squared residuals, in units of its variance, are quadratic in w: ``sums (8, M)`` are the information on a (that
    on b is the same, and the two do not meet), the couplings of a and b with c, the information on c, the score of a,
    b, c, and the squared residuals at w = 0. ``freedom (M,)`` degrees of freedom of each by itself: its velocity is
    that of others, too.
    """

    sums: Floats
    freedom: Floats

    def velocity(self, members: Bools) -> tuple[Floats, Floats]:
        """Velocity over depth (3,), 1/s, of the tracks that a mask (M,) picks, and its covariance (3, 3); NaN: none."""
        info_a, with_a, with_b, info_c, score_a, score_b, score_c, _ = self.sums[:, members].sum(axis=1).tolist()
        if not (info_a > 0.0 and info_a * info_c > with_a * with_a + with_b * with_b):
            return np.full(3, np.nan), np.full((3, 3), np.nan)
        # How a and b follow c.
        along = np.array([-with_a / info_a, -with_b / info_a, 1.0])
        variance_c = 1.0 / (info_c + along[0] * with_a + along[1] * with_b)
        cov = variance_c * np.outer(along, along) + np.diag([1.0 / info_a, 1.0 / info_a, 0.0])
        return cov @ [score_a, score_b, score_c], cov

    def misfits(self, velocity_hz: Floats) -> Floats:
        """Chi-square over degrees of freedom of each track at a velocity over depth (3,): (M,)."""
        a, b, c = velocity_hz.tolist()
        info_a, with_a, with_b, info_c, score_a, score_b, score_c, square = self.sums
        towards = (a * with_a + b * with_b - score_c) * c - a * score_a - b * score_b
        chi2 = square + 2.0 * towards + (a * a + b * b) * info_a + c * c * info_c
        return np.asarray(np.maximum(chi2, 0.0) / self.freedom)

    def sharing_a_velocity(self, misfit: Floats, gate: float, least_tracks: int) -> Bools | None:
        """Which tracks (M,) one velocity explains that comes nearer; None where they are too few.

        What the first track says with each of the others is tried, and what explains most better than the scene is
        found again by all that fit it.

        Parameters
        ----------
        misfit : (M,) of the tracks on the scene's path; what misfits by more than the ``gate`` does not fit.
        """
        fits = np.empty(len(misfit), dtype=bool)
        return fits if _search(self.sums, self.freedom, misfit, gate, least_tracks, fits) else None


def growth_sums(xy: Floats, since_s: Floats, sigma_norm: Floats) -> GrowthSums:
    """What each track says.

    Parameters
    ----------
    xy : (L, M, 2) places in the plane z = 1 of the present camera, without its rotation, NaN where not seen.
    since_s : (L,) times relative to the present view.
    sigma_norm : (M,) noise of a coordinate.
    """
    sums, freedom = np.empty((_N_SUMS, xy.shape[1])), np.empty(xy.shape[1])
    _add_up(np.ascontiguousarray(xy), since_s, sigma_norm, sums, freedom)
    return GrowthSums(sums, freedom)


@compiled
def _add_up(xy: Floats, since_s: Floats, sigma_norm: Floats, sums: Floats, freedom: Floats) -> None:
    """Fill ``sums (8, M)`` and ``freedom (M,)`` of `GrowthSums`; places are taken out as the means of their rows.

    The rows are x = x0 + a t - c t x, and the same with b for y.
    """
    for m in range(xy.shape[1]):
        n, mean_t, mean_x, mean_y, mean_tx, mean_ty = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for v in range(len(since_s)):
            t, x, y = since_s[v], xy[v, m, 0], xy[v, m, 1]
            if np.isfinite(x):
                n += 1
                mean_t, mean_x, mean_y = mean_t + t, mean_x + x, mean_y + y
                mean_tx, mean_ty = mean_tx + t * x, mean_ty + t * y
        freedom[m], part, weight = max(2.0 * (n - 1.0), 1.0), 1.0 / max(n, 1), 1.0 / (sigma_norm[m] * sigma_norm[m])
        mean_t, mean_x, mean_y = mean_t * part, mean_x * part, mean_y * part
        mean_tx, mean_ty = mean_tx * part, mean_ty * part
        tt = t_x = t_y = both = score_a = score_b = score_c = square = 0.0
        for v in range(len(since_s)):
            if np.isfinite(xy[v, m, 0]):
                t, x, y = since_s[v] - mean_t, xy[v, m, 0] - mean_x, xy[v, m, 1] - mean_y
                by_x, by_y = mean_tx - since_s[v] * xy[v, m, 0], mean_ty - since_s[v] * xy[v, m, 1]
                tt, t_x, t_y, both = tt + t * t, t_x + t * by_x, t_y + t * by_y, both + by_x * by_x + by_y * by_y
                score_a, score_b, score_c = score_a + t * x, score_b + t * y, score_c + by_x * x + by_y * y
                square += x * x + y * y
        sums[0, m], sums[1, m], sums[2, m], sums[3, m] = weight * tt, weight * t_x, weight * t_y, weight * both
        sums[4, m], sums[5, m], sums[6, m] = weight * score_a, weight * score_b, weight * score_c
        sums[7, m] = weight * square


@compiled
def _search(sums: Floats, freedom: Floats, misfit: Floats, gate: float, least_tracks: int, fits: Bools) -> bool:
    """Fill ``fits (M,)`` of `GrowthSums.sharing_a_velocity`; whether they are enough."""
    n = len(misfit)
    limit, tried, total, most = np.empty(n), np.empty(n, dtype=np.bool_), np.empty(_N_SUMS), -np.inf
    fits[:] = False
    for m in range(n):
        limit[m] = min(gate, max(misfit[m], _NOISE) + _NOT_WORSE)
    for other in range(1, n):
        for j in range(_N_SUMS):
            total[j] = sums[j, 0] + sums[j, other]
        gain = _explained(sums, freedom, misfit, limit, total, tried)
        if gain > most:
            most = gain
            fits[:] = tried
    for _ in range(_ROUNDS - 1):
        if np.sum(fits) < least_tracks:
            return False
        total[:] = 0.0
        for m in range(n):
            for j in range(_N_SUMS):
                total[j] += sums[j, m] if fits[m] else 0.0
        _explained(sums, freedom, misfit, limit, total, fits)
    return bool(np.sum(fits) >= least_tracks)


@compiled
def _explained(sums: Floats, freedom: Floats, misfit: Floats, limit: Floats, total: Floats, fits: Bools) -> float:
    """Fill ``fits (M,)``: tracks below their ``limit (M,)`` at what the sums of some say, if that comes nearer.

    Returns by how much their chi-square is less than on the scene's path. ``total (8,)`` are the sums of those that say
    something; see `GrowthSums.velocity` and `GrowthSums.misfits`.
    """
    info, rest = total[0], total[0] * total[3] - total[1] * total[1] - total[2] * total[2]
    c = (info * total[6] - total[1] * total[4] - total[2] * total[5]) / rest
    a, b, gain = (total[4] - total[1] * c) / info, (total[5] - total[2] * c) / info, 0.0
    is_nearer = info > 0.0 and rest > 0.0 and c < 0.0
    across, deep = a * a + b * b, c * c
    for m in range(np.uint64(len(fits))):
        towards = (a * sums[1, m] + b * sums[2, m] - sums[6, m]) * c - a * sums[4, m] - b * sums[5, m]
        chi2 = sums[7, m] + 2.0 * towards + across * sums[0, m] + deep * sums[3, m]
        off = max(chi2, 0.0) / freedom[m]
        is_one = is_nearer and off < limit[m]
        fits[m] = is_one
        gain += (misfit[m] - off) * freedom[m] if is_one else 0.0
    return gain
