"""Last known positions of movers, also while they are hidden: what reappears behind a post is what vanished."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ttcvid.geometry.compiled import compiled_for
from ttcvid.model import Bools, Floats, Ints

# A mover is seen as a whole with this part of its tracks; the number of these falls by this part a frame at the most.
_WHOLE, _FALLS = 0.75, 0.95
_TINY_HZ = 1e-9


@dataclass(frozen=True)
class LastKnownPositions:
    """Positions of K movers relative to the camera, in s of their own speed.

    ``centre (K, 3)`` centroid of their tracks and ``extent (K,)`` the root mean square distance from it, of the last
    frame in which the mover was seen as a whole, predicted to now; ``n_tracks (K,)`` of the whole mover, ``seen_s
    (K,)`` time at which it was last found.
    """

    centre: Floats
    extent: Floats
    n_tracks: Floats
    seen_s: Floats

    def take(self, index: Ints | Bools) -> LastKnownPositions:
        """Those of the movers that an index array or a mask selects."""
        return LastKnownPositions(*(getattr(self, f.name)[index] for f in fields(self)))

    def with_new(self, count: int) -> LastKnownPositions:
        """These, and as many again at unknown positions."""
        new = nowhere(count)
        return LastKnownPositions(
            *(np.concatenate([getattr(self, f.name), getattr(new, f.name)]) for f in fields(self))
        )

    def carried_forward(self, cam_R_prev: Floats, step: Floats) -> LastKnownPositions:
        """Predicted for the next camera: rotated by ``cam_R_prev (3, 3)``, less the former ``step (K, 3)``."""
        return LastKnownPositions(self.centre @ cam_R_prev.T - step, self.extent, self.n_tracks, self.seen_s)

    def seen_again(self, number: Ints, xy: Floats, rate_hz: Floats, now_s: float, least: int) -> LastKnownPositions:
        """Updated by the tracks of this frame, at ``xy (N, 2)`` in the plane z = 1.

        Parameters
        ----------
        number
            ``(N,)`` 0 for a track of the scene, else 1 + index of its mover.
        xy
            ``(N, 2)`` in the plane z = 1.
        rate_hz
            ``(K,)`` median inverse depth (times speed) of the tracks of each mover.
        now_s
            Time of the frame.
        least
            Movers with fewer tracks are not updated.
        """
        centre, extent = self.centre.copy(), self.extent.copy()
        n_tracks, seen_s = self.n_tracks.copy(), self.seen_s.copy()
        _see(number, xy, rate_hz, now_s, least, centre, extent, n_tracks, seen_s)
        return LastKnownPositions(centre, extent, n_tracks, seen_s)


@compiled_for("(i8[::1], f8[:, ::1], f8[::1], f8, i8, f8[:, ::1], f8[::1], f8[::1], f8[::1])")
def _see(
    number: Ints,
    xy: Floats,
    rate_hz: Floats,
    now_s: float,
    least: int,
    centre: Floats,
    extent: Floats,
    n_tracks: Floats,
    seen_s: Floats,
) -> None:
    """Brings what `LastKnownPositions` knows up to date with the tracks of a frame."""
    n_movers = len(rate_hz)
    # Of the tracks of each mover: their number, the sums of x and y, and that of the squares of both.
    count, sums = np.zeros(n_movers), np.zeros((n_movers, 3))
    for i in range(len(number)):
        x, y = xy[i, 0], xy[i, 1]
        if number[i] > 0 and np.isfinite(x):
            sums[number[i] - 1, 0] += x
            sums[number[i] - 1, 1] += y
            sums[number[i] - 1, 2] += x * x + y * y
            count[number[i] - 1] += 1.0
    for k in range(n_movers):
        if count[k] >= least:
            seen_s[k] = now_s
            if count[k] >= _WHOLE * n_tracks[k]:
                x, y, away_s = sums[k, 0] / count[k], sums[k, 1] / count[k], 1.0 / max(rate_hz[k], _TINY_HZ)
                centre[k, 0], centre[k, 1], centre[k, 2] = x * away_s, y * away_s, away_s
                extent[k] = np.sqrt(max(sums[k, 2] / count[k] - x * x - y * y, 0.0)) * away_s
        n_tracks[k] = max(count[k], _FALLS * n_tracks[k])


def nowhere(count: int) -> LastKnownPositions:
    """Unknown positions of ``count`` movers."""
    return LastKnownPositions(
        np.full((count, 3), np.nan), np.full(count, np.nan), np.zeros(count), np.full(count, -np.inf)
    )
