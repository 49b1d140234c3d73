"""Where movers are, also while they are hidden: what comes out from behind a post is what went in."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ttcvid.model import Bools, Floats, Ints

# A mover is seen as a whole with this part of its tracks; the number of these falls by this part a frame at the most.
_WHOLE, _FALLS = 0.75, 0.95
_TINY_HZ = 1e-9


@dataclass(frozen=True)
class Whereabouts:
    """Where K movers are relative to the camera, in s of their own speed.

    ``centre (K, 3)`` the middle of their tracks and ``extent (K,)`` the root mean square distance of these from it, as
    they were when the thing was last seen as a whole, moved on with it since; ``n_tracks (K,)`` those of the whole
    thing, ``seen_s (K,)`` when it was found last.
    """

    centre: Floats
    extent: Floats
    n_tracks: Floats
    seen_s: Floats

    def take(self, index: Ints | Bools) -> Whereabouts:
        """Those of the movers that an index array or a mask picks."""
        return Whereabouts(*(getattr(self, f.name)[index] for f in fields(self)))

    def with_new(self, count: int) -> Whereabouts:
        """These, and so many of which nothing is known yet."""
        new = nowhere(count)
        return Whereabouts(*(np.concatenate([getattr(self, f.name), getattr(new, f.name)]) for f in fields(self)))

    def carried_forward(self, cam_R_prev: Floats, step: Floats) -> Whereabouts:
        """As the next camera sees them: turned by ``cam_R_prev (3, 3)``, less where they were (K, 3)."""
        return Whereabouts(self.centre @ cam_R_prev.T - step, self.extent, self.n_tracks, self.seen_s)

    def seen_again(self, number: Ints, xy: Floats, rate_hz: Floats, now_s: float, least: int) -> Whereabouts:
        """With the tracks of this frame, at ``xy (N, 2)`` in the plane z = 1.

        Parameters
        ----------
        number : (N,) 0 for a track of the scene, else 1 + place of its mover.
        rate_hz : (K,) median rate of the tracks of each mover.
        least : fewer tracks than this say nothing.
        """
        n_movers = len(self.centre)
        own = np.flatnonzero((number > 0) & np.isfinite(xy[:, 0]))
        mover, xy = number[own] - 1, xy[own]
        count = np.bincount(mover, minlength=n_movers)
        some = np.maximum(count, 1)
        middle = np.column_stack([np.bincount(mover, xy[:, axis], n_movers) / some for axis in (0, 1)])
        square = np.bincount(mover, np.sum((xy - middle[mover]) ** 2, axis=1), n_movers) / some
        is_whole = (count >= least) & (count >= _WHOLE * self.n_tracks)
        away_s = 1.0 / np.maximum(rate_hz, _TINY_HZ)
        centre = np.column_stack([middle, np.ones(n_movers)]) * away_s[:, None]
        return Whereabouts(
            np.where(is_whole[:, None], centre, self.centre),
            np.where(is_whole, np.sqrt(square) * away_s, self.extent),
            np.maximum(count, _FALLS * self.n_tracks),
            np.where(count >= least, now_s, self.seen_s),
        )


def nowhere(count: int) -> Whereabouts:
    """Of so many movers nothing is known."""
    return Whereabouts(np.full((count, 3), np.nan), np.full(count, np.nan), np.zeros(count), np.full(count, -np.inf))
