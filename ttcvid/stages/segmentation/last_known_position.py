"""Last known positions of movers, also while they are hidden: what reappears behind a post is what vanished."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

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
        """Updated by the tracks of this frame, at ``xy (N, 2)`` in the plane z = 1; movers of fewer than ``least`` not.

        ``number (N,)`` is 0 for a track of the scene, else 1 + index of its mover; ``rate_hz (K,)`` the median inverse
        depth (times speed) of the tracks of each mover.
        """
        own = np.flatnonzero((number > 0) & np.isfinite(xy[:, 0]))
        mover, (x, y), n_movers = number[own] - 1, xy[own].T, len(rate_hz)
        count = np.bincount(mover, minlength=n_movers)
        x, y, square = (np.bincount(mover, one, n_movers) / np.maximum(count, 1) for one in (x, y, x * x + y * y))
        away_s = 1.0 / np.maximum(rate_hz, _TINY_HZ)
        centre = np.stack([x, y, np.ones(n_movers)], axis=1) * away_s[:, None]
        extent = np.sqrt(np.maximum(square - x * x - y * y, 0.0)) * away_s
        is_seen = count >= least
        is_whole = is_seen & (count >= _WHOLE * self.n_tracks)
        return LastKnownPositions(
            np.where(is_whole[:, None], centre, self.centre),
            np.where(is_whole, extent, self.extent),
            np.maximum(count, _FALLS * self.n_tracks),
            np.where(is_seen, now_s, self.seen_s),
        )


def nowhere(count: int) -> LastKnownPositions:
    """Unknown positions of ``count`` movers."""
    return LastKnownPositions(
        np.full((count, 3), np.nan), np.full(count, np.nan), np.zeros(count), np.full(count, -np.inf)
    )
