"""The velocity over the depth of a small thing, from how its picture moves and grows: four unknowns for all tracks.

A point at (x, y) now, in the plane z = 1, of a thing that moves by (a, b, c) = V / Z and is small against its distance,
was at ((x + a t) / (1 + c t), (y + b t) / (1 + c t)). Multiplied out, that is linear in the place and in (a, b, c).
What a track says of them is a sum: any set of tracks is fitted by adding up. (A noisy place in the column of c pulls c
to zero: here by the square of the noise over that of the thing's size. Views of when the thing was smaller count as
much as the present one: where c t is 0.3, their noise is 1.3 times as large as it is taken to be.)

The thing goes straight on, the camera may not: one that is held by hand or hovers sways. How far it was off a straight
way is known from the scene, in units of the scene; times s, one over the depth of the thing in these units, it adds to
the ways of all its tracks. So s is the fourth unknown, and told only where the camera sways.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.compiled import compiled, compiled_for
from ttcvid.model import Bools, Floats, Ints

# Sums of a track: information on a (and b), couplings of a and b with c, information on c, score of a, b, c, squared
# residuals; then of s the couplings with a, b and c, the information and the score.
_N_SUMS = 13
# One over the time that the camera takes to where a thing is, is hardly more than this, 1/s: what is nearer than half a
# second away was found before.
_USUAL_S_HZ = 2.0
# A track fits a velocity that explains it worse than the scene by no more than this, in units of what is usual; misfits
# below the first are noise.
_NOISE, _NOT_WORSE = 1.0, 1.0
# The tracks that fit what two of them say, then those that fit what all of these say: so often.
_ROUNDS = 3


@dataclass(frozen=True)
class GrowthSums:
    """What each of M tracks says of the unknowns (a, b, c, s) of its thing, its place taken out.

    Its squared residuals, in units of its variance, are quadratic in them: ``sums (13, M)`` are the information on a
    (that on b is the same, and the two do not meet), the couplings of a and b with c, the information on c, the score
    of a, b, c, the squared residuals where all are 0, the couplings of s with a, b, c, the information on it and its
    score. ``freedom (M,)`` degrees of freedom of each by itself: its velocity is that of others, too.
    """

    sums: Floats
    freedom: Floats

    def of(self, track: Ints) -> GrowthSums:
        """Those of the tracks that an index array picks."""
        return GrowthSums(self.sums.take(track, axis=1), self.freedom.take(track))

    def unknowns(self, members: Bools) -> tuple[Floats, Floats]:
        """(a, b, c, s) of the tracks that a mask (M,) picks, 1/s, and their covariance (4, 4); NaN: none."""
        aa, ac, bc, cc, score_a, score_b, score_c, _, as_, bs, cs, ss, score_s = self.sums[:, members].sum(axis=1)
        ss += 1.0 / _USUAL_S_HZ**2
        info = np.array([[aa, 0.0, ac, as_], [0.0, aa, bc, bs], [ac, bc, cc, cs], [as_, bs, cs, ss]])
        if not (aa > 0.0 and aa * cc > ac * ac + bc * bc and np.linalg.det(info) > 0.0):
            return np.full(4, np.nan), np.full((4, 4), np.nan)
        cov = np.linalg.inv(info)
        return cov @ [score_a, score_b, score_c, score_s], cov

    def misfits(self, unknowns: Floats) -> Floats:
        """Chi-square over degrees of freedom of each track with (a, b, c, s): (M,)."""
        a, b, c, s = unknowns.tolist()
        aa, ac, bc, cc, score_a, score_b, score_c, square, as_, bs, cs, ss, score_s = self.sums
        towards = (
            (a * ac + b * bc - score_c) * c - a * score_a - b * score_b + (a * as_ + b * bs + c * cs - score_s) * s
        )
        chi2 = square + 2.0 * towards + (a * a + b * b) * aa + c * c * cc + s * s * ss
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


def growth_sums(xy: Floats, since_s: Floats, sigma_norm: Floats, sway: Floats) -> GrowthSums:
    """What each track says.

    Parameters
    ----------
    xy : (L, M, 2) places in the plane z = 1 of the present camera, without its rotation, NaN where not seen.
    since_s : (L,) times relative to the present view.
    sigma_norm : (M,) noise of a coordinate.
    sway : (L, 3) how far the scene lay off a straight way at its present velocity, in its units; 0 of a steady camera.
    """
    sums, freedom = np.empty((_N_SUMS, xy.shape[1])), np.empty(xy.shape[1])
    _add_up(np.ascontiguousarray(xy), since_s, sigma_norm, np.ascontiguousarray(sway), sums, freedom)
    return GrowthSums(sums, freedom)


@compiled_for("(f8[:, :, ::1], f8[::1], f8[::1], f8[:, ::1], f8[:, ::1], f8[::1])")
def _add_up(xy: Floats, since_s: Floats, sigma_norm: Floats, sway: Floats, sums: Floats, freedom: Floats) -> None:
    """Fill ``sums (13, M)`` and ``freedom (M,)`` of `GrowthSums`; places are taken out as the means of their rows.

    The rows are x = x0 + a t - c t x + s (sway_x - x sway_z), and the same with b for y.
    """
    n_views = len(since_s)
    for m in range(xy.shape[1]):
        n = mean_t = mean_x = mean_y = mean_tx = mean_ty = mean_ox = mean_oy = 0.0
        for v in range(n_views):
            t, x, y = since_s[v], xy[v, m, 0], xy[v, m, 1]
            if np.isfinite(x):
                n += 1.0
                mean_t += t
                mean_x += x
                mean_y += y
                mean_tx += t * x
                mean_ty += t * y
                mean_ox += sway[v, 0] - x * sway[v, 2]
                mean_oy += sway[v, 1] - y * sway[v, 2]
        part, weight = 1.0 / max(n, 1.0), 1.0 / (sigma_norm[m] * sigma_norm[m])
        freedom[m] = max(2.0 * (n - 1.0), 1.0)
        for j in range(_N_SUMS):
            sums[j, m] = 0.0
        for v in range(n_views):
            t, x, y = since_s[v], xy[v, m, 0], xy[v, m, 1]
            if np.isfinite(x):
                by_x, by_y = mean_tx * part - t * x, mean_ty * part - t * y
                off_x = sway[v, 0] - x * sway[v, 2] - mean_ox * part
                off_y = sway[v, 1] - y * sway[v, 2] - mean_oy * part
                t, x, y = t - mean_t * part, x - mean_x * part, y - mean_y * part
                sums[0, m] += weight * t * t
                sums[1, m] += weight * t * by_x
                sums[2, m] += weight * t * by_y
                sums[3, m] += weight * (by_x * by_x + by_y * by_y)
                sums[4, m] += weight * t * x
                sums[5, m] += weight * t * y
                sums[6, m] += weight * (by_x * x + by_y * y)
                sums[7, m] += weight * (x * x + y * y)
                sums[8, m] += weight * t * off_x
                sums[9, m] += weight * t * off_y
                sums[10, m] += weight * (by_x * off_x + by_y * off_y)
                sums[11, m] += weight * (off_x * off_x + off_y * off_y)
                sums[12, m] += weight * (off_x * x + off_y * y)


@compiled_for("(f8[:, ::1], f8[::1], f8[::1], f8, i8, b1[::1])")
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
            for m in range(n):
                fits[m] = tried[m]
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

    Returns by how much their chi-square is less than on the scene's path. ``total (13,)`` are the sums of those that
    say something; see `GrowthSums.unknowns` and `GrowthSums.misfits`.
    """
    info = total[0]
    # What is left for c and s where a and b follow them, times the information on these.
    cc = info * total[3] - total[1] * total[1] - total[2] * total[2]
    cs = info * total[10] - total[1] * total[8] - total[2] * total[9]
    ss = info * (total[11] + 1.0 / _USUAL_S_HZ**2) - total[8] * total[8] - total[9] * total[9]
    of_c = info * total[6] - total[1] * total[4] - total[2] * total[5]
    of_s = info * total[12] - total[8] * total[4] - total[9] * total[5]
    rest = cc * ss - cs * cs
    c, s = (ss * of_c - cs * of_s) / rest, (cc * of_s - cs * of_c) / rest
    a = (total[4] - total[1] * c - total[8] * s) / info
    b, gain = (total[5] - total[2] * c - total[9] * s) / info, 0.0
    is_nearer = info > 0.0 and cc > 0.0 and rest > 0.0 and c < 0.0
    across, deep, swayed = a * a + b * b, c * c, s * s
    for m in range(np.uint64(len(fits))):
        towards = (a * sums[1, m] + b * sums[2, m] - sums[6, m]) * c - a * sums[4, m] - b * sums[5, m]
        towards += (a * sums[8, m] + b * sums[9, m] + c * sums[10, m] - sums[12, m]) * s
        chi2 = sums[7, m] + 2.0 * towards + across * sums[0, m] + deep * sums[3, m] + swayed * sums[11, m]
        off = max(chi2, 0.0) / freedom[m]
        is_one = is_nearer and off < limit[m]
        fits[m] = is_one
        gain += (misfit[m] - off) * freedom[m] if is_one else 0.0
    return gain
