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
from ttcvid.model import Floats, Ints

# Numbers of a place, and of a velocity.
_PLACE, _VELOCITY = 2, 3


@dataclass(frozen=True)
class GrowthSums:
    """What each of M tracks says of the velocity over the depth w of its thing, its place taken out.

    Its squared residuals, in units of its variance, are ``square (M,) - 2 w.score (M, 3) + w.info (M, 3, 3) w``;
    ``n_views (M,)``.
    """

    info: Floats
    score: Floats
    square: Floats
    n_views: Ints

    def take(self, index: Ints) -> GrowthSums:
        """The same of the tracks at an index array."""
        return GrowthSums(self.info[index], self.score[index], self.square[index], self.n_views[index])

    def velocities(self, sets: Floats) -> tuple[Floats, Floats]:
        """Velocity over depth, 1/s, and its covariance, of K sets of tracks: (K, 3), (K, 3, 3); NaN where not told.

        Parameters
        ----------
        sets : (K, M) weights of the tracks in the sets, 0 or 1.
        """
        info = (sets @ self.info.reshape(-1, _VELOCITY**2)).reshape(-1, _VELOCITY, _VELOCITY)
        is_told = np.linalg.det(info) > 0.0
        cov = np.linalg.inv(np.where(is_told[:, None, None], info, np.eye(_VELOCITY)))
        cov[~is_told] = np.nan
        return np.einsum("kij,kj->ki", cov, sets @ self.score), cov

    def misfits(self, velocity_hz: Floats) -> Floats:
        """Chi-square over degrees of freedom of each track on each of the velocities (K, 3): (K, M)."""
        products = (velocity_hz[:, :, None] * velocity_hz[:, None, :]).reshape(-1, _VELOCITY**2)
        chi2 = self.square - 2.0 * velocity_hz @ self.score.T + products @ self.info.reshape(-1, _VELOCITY**2).T
        return np.asarray(np.maximum(chi2, 0.0) / self.degrees_of_freedom)

    @property
    def degrees_of_freedom(self) -> Floats:
        """Of each track (M,) by itself: its velocity is that of others, too."""
        return np.asarray(np.maximum(_PLACE * (self.n_views - 1.0), 1.0))


def growth_sums(xy: Floats, since_s: Floats, sigma_norm: Floats) -> GrowthSums:
    """What each track says.

    Parameters
    ----------
    xy : (L, M, 2) places in the plane z = 1 of the present camera, without its rotation, NaN where not seen.
    since_s : (L,) times relative to the present view.
    sigma_norm : (M,) noise of a coordinate.
    """
    n_tracks = xy.shape[1]
    info, score = np.zeros((n_tracks, _VELOCITY, _VELOCITY)), np.zeros((n_tracks, _VELOCITY))
    square, n_views = np.zeros(n_tracks), np.zeros(n_tracks, dtype=np.int64)
    _add_up(np.ascontiguousarray(xy), since_s, sigma_norm, info, score, square, n_views)
    return GrowthSums(info, score, square, n_views)


@compiled
def _add_up(
    xy: Floats, since_s: Floats, sigma_norm: Floats, info: Floats, score: Floats, square: Floats, n_views: Ints
) -> None:
    """Fill the sums of `GrowthSums` of each track; its place is taken out as the mean of its rows."""
    column, mean = np.empty(3), np.empty(4)
    for m in range(xy.shape[1]):
        weight = 1.0 / (sigma_norm[m] * sigma_norm[m])
        for v in range(len(since_s)):
            n_views[m] += np.isfinite(xy[v, m, 0])
        for axis in range(2):
            mean[:] = 0.0
            for turn in range(2):
                for v in range(len(since_s)):
                    t, place = since_s[v], xy[v, m, axis]
                    if not np.isfinite(place):
                        continue
                    # x = x0 + a t - c t x, and the same with b for y.
                    column[:] = 0.0
                    column[axis], column[2] = t, -t * place
                    if turn == 0:
                        for a in range(3):
                            mean[a] += column[a] / n_views[m]
                        mean[3] += place / n_views[m]
                        continue
                    off = place - mean[3]
                    square[m] += weight * off * off
                    for a in range(3):
                        score[m, a] += weight * (column[a] - mean[a]) * off
                        for b in range(3):
                            info[m, a, b] += weight * (column[a] - mean[a]) * (column[b] - mean[b])
