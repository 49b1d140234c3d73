"""The tracks of a frame as the search for rigid bodies sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.rotation import turned_into_plane
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.bodies import Body, refined_mover
from ttcvid.stages.connected import nearest_neighbours
from ttcvid.stages.history import TrackHistory

# Neighbours that have a say in where a track belongs.
_N_NEIGHBOURS = 8
# Points of one mover lie side by side: their rates are at least this part of the median. A far point of the scene,
# which any path explains that turns like the scene's, is kept out by this.
_LEAST_RATE = 0.4


@dataclass(frozen=True)
class BodyViews:
    """N tracks over L views.

    ``rays (L, N, 3)``, each in the camera of its view, NaN where not observed; ``sigma_norm (N,)``; ``xy_px (N, 2)``
    now; ``t_s (L,)``; ``is_free (N,)`` tracks not frozen to their pixel; ``neighbours (N, K)`` the nearest tracks
    within ``link_px``, the track itself standing in for missing ones.
    """

    rays: Floats
    sigma_norm: Floats
    xy_px: Floats
    t_s: Floats
    focal_px: float
    is_free: Bools
    neighbours: Ints
    link_px: float

    @property
    def since_s(self) -> Floats:
        """Times relative to the present view: (L,)."""
        return np.asarray(self.t_s - self.t_s[-1])

    @property
    def has_neighbour(self) -> Bools:
        """Which of the neighbours are another track: (N, K)."""
        return np.asarray(self.neighbours != np.arange(len(self.neighbours))[:, None])

    def misfit(self, mover: Body, index: Ints) -> Floats:
        """Misfit of the tracks ``index`` on a mover's path."""
        rate_hz = np.full(len(index), mover.rate_hz)
        return mover.fit(self.rays[:, index], self.sigma_norm[index], rate_hz, _LEAST_RATE * mover.rate_hz).misfit

    def refined(self, mover: Body, scene: Body, index: Ints, n_steps: int) -> Body:
        """A mover's path by the tracks ``index``."""
        return refined_mover(mover, scene, self.rays[:, index], self.sigma_norm[index], self.since_s, n_steps)

    def in_plane(self, body: Body, index: Ints) -> Floats:
        """The tracks ``index`` as if a body had not turned: (L, M, 2) in the plane z = 1 of the present camera."""
        return turned_into_plane(self.rays[:, index], body.cam_R_past)


def body_views(history: TrackHistory, is_free: Bools, link_px: float, model_error_px: float) -> BodyViews:
    """The tracks of the history with their neighbours.

    Parameters
    ----------
    model_error_px : error of a position that no track's noise knows of: lens, shutter, focal length.
    """
    sigma_norm = np.maximum(history.sigma_norm, model_error_px / history.focal_px)
    neighbours = nearest_neighbours(history.xy_px, _N_NEIGHBOURS, link_px)
    return BodyViews(
        history.rays, sigma_norm, history.xy_px, history.t_s, history.focal_px, is_free, neighbours, link_px
    )
