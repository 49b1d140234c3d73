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

from ttcvid.compiled import compiled_for
from ttcvid.model import Bools, Floats, Ints

# A track fits a velocity that explains it worse than the scene by no more than this, in units of what is usual; misfits
# below the first are noise.
_NOISE, _NOT_WORSE = 1.0, 1.0
# The tracks that fit what two of them say, then those that fit what all of these say: so often.
_ROUNDS = 3


@dataclass(frozen=True)
class GrowthSums:
    """What each of M tracks says of the unknowns (a, b, c) of its thing, its place taken out.

    Its squared residuals, in units of its variance, are quadratic in them: ``sums (8, M)`` are the information on a
    (that on b is the same, and the two do not meet), the couplings of a and b with c, the information on c, the score
    of a, b, c, the squared residuals where all are 0. ``freedom (M,)`` degrees of freedom of each by itself: its
    velocity is that of others, too.
    """

    sums: Floats
    freedom: Floats

    def of(self, track: Ints) -> GrowthSums:
        """Those of the tracks that an index array picks."""
        return GrowthSums(self.sums.take(track, axis=1), self.freedom.take(track))

    def unknowns(self, members: Bools) -> tuple[Floats, Floats]:
        """(a, b, c) of the tracks that a mask (M,) picks, 1/s, and their covariance (3, 3); NaN: none."""
        aa, ac, bc, cc, score_a, score_b, score_c, _ = self.sums[:, members].sum(axis=1)
        if not (aa > 0.0 and aa * cc > ac * ac + bc * bc):
            return np.full(3, np.nan), np.full((3, 3), np.nan)
        # By how much a and b follow c.
        along = np.array([-ac / aa, -bc / aa, 1.0])
        cov = np.diag([1.0 / aa, 1.0 / aa, 0.0]) + aa / (aa * cc - ac * ac - bc * bc) * np.outer(along, along)
        return cov @ [score_a, score_b, score_c], cov

    def redchi_of(self, unknowns: Floats) -> Floats:
        """Chi-square over degrees of freedom of each track with (a, b, c) ``(3, ...)``: (..., M)."""
        a, b, c = unknowns
        by_sums = [a * a + b * b, 2.0 * a * c, 2.0 * b * c, c * c, -2.0 * a, -2.0 * b, -2.0 * c, np.ones_like(a)]
        return np.asarray(np.maximum(np.stack(by_sums, axis=-1) @ self.sums, 0.0) / self.freedom)

    def sharing_a_velocity(self, redchi: Floats, gate: float, least_tracks: int) -> Bools | None:
        """Which tracks (M,) one velocity explains that comes nearer; None where they are too few.

        What the first track says with each of the others is tried, and what explains most better than the scene is
        found again by all that fit it.

        Parameters
        ----------
        redchi : (M,) of the tracks on the scene's path; what misfits by more than the ``gate`` does not fit.
        """
        if len(redchi) < max(least_tracks, 2):
            return None
        limit = np.minimum(gate, np.maximum(redchi, _NOISE) + _NOT_WORSE)
        fits = np.empty(len(redchi), dtype=bool)
        return fits if _share(self.sums, self.freedom, redchi, limit, least_tracks, fits) else None


@compiled_for("(f8[:, ::1], f8[::1], f8[::1], f8[::1], i8, b1[::1])")
def _share(sums: Floats, freedom: Floats, redchi: Floats, limit: Floats, least_tracks: int, fits: Bools) -> bool:
    """Fill ``fits (M,)`` as `GrowthSums.sharing_a_velocity` returns it; False: too few."""
    n_sums, n = sums.shape
    tried, total, terms, chi2, most = np.empty_like(fits), np.empty(n_sums), np.empty(n_sums), np.empty(n), -np.inf
    for k in range(1, n + _ROUNDS - 1):
        # First the pairs, then all that fit the best of them.
        if k >= n and np.count_nonzero(fits) < least_tracks:
            return False
        for r in range(n_sums):
            total[r] = sums[r, 0] + sums[r, k] if k < n else 0.0
            for i in range(n if k >= n else 0):
                total[r] += sums[r, i] if fits[i] else 0.0
        aa, ac, bc, score_a, score_b = total[0], total[1], total[2], total[4], total[5]
        # What is left for c where a and b follow it, times the information on these.
        cc = aa * total[3] - ac * ac - bc * bc
        c = (aa * total[6] - ac * score_a - bc * score_b) / cc
        a, b, gain, is_near = (score_a - ac * c) / aa, (score_b - bc * c) / aa, 0.0, aa > 0.0 and cc > 0.0 and c < 0.0
        # As in `GrowthSums.redchi_of`.
        terms[0], terms[1], terms[2], terms[3] = a * a + b * b, 2.0 * a * c, 2.0 * b * c, c * c
        terms[4], terms[5], terms[6], terms[7] = -2.0 * a, -2.0 * b, -2.0 * c, 1.0
        for i in range(n):
            chi2[i] = 0.0
        for r in range(n_sums):
            for i in range(n):
                chi2[i] += terms[r] * sums[r, i]
        for i in range(n):
            off = max(chi2[i], 0.0) / freedom[i]
            tried[i] = is_near and off < limit[i]
            gain += (redchi[i] - off) * freedom[i] if tried[i] else 0.0
        if k >= n or gain > most:
            most, fits[:] = gain, tried
    return bool(np.count_nonzero(fits) >= least_tracks)


def growth_sums(xy: Floats, since_s: Floats, sigma_norm: Floats) -> GrowthSums:
    """What each track says.

    Parameters
    ----------
    xy : (L, M, 2) places in the plane z = 1 of the present camera, without its rotation, NaN where not seen.
    since_s : (L,) times relative to the present view.
    sigma_norm : (M,) noise of a coordinate.
    """
    is_seen, powers = np.isfinite(xy[..., 0]), np.vander(since_s, 3, increasing=True).T
    place = np.where(is_seen[:, None], xy.transpose(0, 2, 1), 0.0)
    # Sums over the views of 1, of x and y, and of their squares, each times the powers of t.
    (n, t, tt), (p, tp, ttp), (pp, tpp, ttpp) = (
        (powers @ each.reshape(len(since_s), -1)).reshape(3, *each.shape[1:])
        for each in (is_seen, place, place * place)
    )
    # x = x0 + a t - c t x, and the same with b for y: the columns, their means taken out.
    part = 1.0 / np.maximum(n, 1.0)
    aa, with_c, score_ab = tt - t * t * part, t * tp * part - ttp, tp - t * p * part
    products = ttpp - tp * tp * part, p * tp * part - tpp, pp - p * p * part
    sums = np.vstack([aa, with_c, products[0].sum(axis=0), score_ab, *(each.sum(axis=0) for each in products[1:])])
    return GrowthSums(sums / (sigma_norm * sigma_norm), np.maximum(2.0 * (n - 1.0), 1.0))
