"""What is last known of movers, also while they are hidden: what reappears behind a post is what vanished."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import Points
from ttcvid.geometry.estimation.shared_translation import common_velocities
from ttcvid.model import Bools, Floats, Ints

# A mover is seen as a whole with this part of its tracks; the number of these falls by this part a frame at the most.
_WHOLE, _FALLS = 0.75, 0.95
# A velocity is that of the last views, s: cars brake within a second. So many views in any case, at low frame rates.
_RECENT_S, _LEAST_RECENT = 0.6, 4
UNSURE_HZ = 10.0
"""Standard deviation of a velocity that the tracks do not determine, 1/s."""
STEPS_TO_VELOCITY = 5
"""Gauss-Newton steps to the velocity of what was not known before."""
_LEAST_DEPTH_RATIO = 0.05
_TINY_HZ = 1e-9


@dataclass(frozen=True)
class LastKnown:
    """Positions and velocities of K movers relative to the camera, predicted to now.

    ``centre (K, 3)`` centroid of their tracks and ``extent (K,)`` the root mean square distance from it, in s of their
    own speed, of the last frame in which the mover was seen as a whole; ``n_tracks (K,)`` of the whole mover, ``seen_s
    (K,)`` time at which it was last found. ``v_hz (K, 3)`` V / Z as of then, 1/s, and ``info (K, 3, 3)`` its
    information matrix; 0 where nothing is known.
    """

    centre: Floats
    extent: Floats
    n_tracks: Floats
    seen_s: Floats
    v_hz: Floats
    info: Floats

    def take(self, index: Ints | Bools) -> LastKnown:
        """Those of the movers that an index array or a mask selects."""
        return LastKnown(*(getattr(self, f.name)[index] for f in fields(self)))

    def with_new(self, count: int) -> LastKnown:
        """These, and as many again of which nothing is known."""
        new = nothing_known(count)
        return LastKnown(*(np.concatenate([getattr(self, f.name), getattr(new, f.name)]) for f in fields(self)))

    def carried_forward(self, cam_R_prev: Floats, step: Floats, dt_s: float) -> LastKnown:
        """As the next camera, turned by ``cam_R_prev (3, 3)``, sees them, less the former ``step (K, 3)``.

        V is the same, the depth another.
        """
        place = self.centre / self.centre[:, 2:]
        ratio = (place + dt_s * self.v_hz) @ cam_R_prev[2]
        ratio = np.where(ratio > _LEAST_DEPTH_RATIO, ratio, 1.0)
        v_hz = self.v_hz @ cam_R_prev.T / ratio[:, None]
        info = cam_R_prev @ self.info @ cam_R_prev.T * (ratio**2)[:, None, None]
        return replace(self, centre=self.centre @ cam_R_prev.T - step, v_hz=v_hz, info=info)

    def with_positions(self, number: Ints, xy: Floats, rate_hz: Floats, now_s: float, least: int) -> LastKnown:
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
        return replace(
            self,
            centre=np.where(is_whole[:, None], centre, self.centre),
            extent=np.where(is_whole, extent, self.extent),
            n_tracks=np.maximum(count, _FALLS * self.n_tracks),
            seen_s=np.where(is_seen, now_s, self.seen_s),
        )


def recent_velocities(
    points: Points, cam_R_past: Floats, start_hz: Floats, n_steps: int, ahead_sigma_hz: Floats | float = np.inf
) -> tuple[Floats, Floats]:
    """`common_velocities`, with its parameters, by the last views, `_LEAST_RECENT` in any case."""
    first = max(0, min(int(np.searchsorted(points.since_s, -_RECENT_S)), len(points.since_s) - _LEAST_RECENT))
    recent = replace(points, since_s=points.since_s[first:])
    return common_velocities(recent, cam_R_past[first:], start_hz, n_steps, ahead_sigma_hz)


def nothing_known(count: int) -> LastKnown:
    """Of ``count`` movers."""
    unknown, nothing = np.full((count, 4), np.nan), (np.zeros((count, 3)), np.zeros((count, 3, 3)))
    return LastKnown(unknown[:, :3], unknown[:, 3], np.zeros(count), np.full(count, -np.inf), *nothing)
