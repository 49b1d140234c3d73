"""The tracks of a frame as the search for rigid bodies sees them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit, Points, RigidPaths, fit_on_paths, views_by_track
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.tracking.history import TrackHistory
from ttcvid.stages.tracking.neighbours import nearest_neighbours

# Neighbours that have a say in where a track belongs.
_N_NEIGHBOURS = 8
# Error of a position that no track's noise knows of: what lens and shutter leave with a calibrated camera, px, and what
# a lens that nobody measured does to a picture that turns by some degrees (distortion of some per cent, a shutter that
# rolls, a focal length that is off by 15 %), as a part of the picture's longer side: half a pixel of 960.
_MODEL_ERROR_PX, _UNKNOWN_LENS_ERROR = 0.1, 0.5 / 960.0
# Before an unknown lens that moves, neighbouring tracks drift together by so many times its error of a position (one
# standard deviation).
_DRIFT_BY_LENS = 2.0
# Points of one mover lie side by side: their rates are at least this part of the median. A far point of the scene,
# which any path explains that turns like the scene's, is kept out by this.
_LEAST_RATE = 0.4
WORST_REDCHI = 50.0
"""Above this reduced chi-square, over the usual one, all tracks are equally wrong: they belong to nothing."""


@dataclass(frozen=True)
class BodyViews:
    """N tracks over L views.

    ``rays (L, N, 3)``, each in the camera of its view, NaN where not observed, and again as `views_by_track`;
    ``sigma_norm (N,)`` their noise with the error of the camera, and ``plane_per_px (N,)`` what a pixel spans of the
    plane z = 1 where each track is; ``xy_px (N, 2)`` now; ``t_s (L,)``; ``is_free (N,)`` tracks not frozen to their
    pixel; ``link_px`` the distance within which two tracks are neighbours; ``common_px`` what neighbouring tracks
    err by together: of the tracker, and of an unknown lens.
    """

    rays: Floats
    rays_by_track: Floats
    sigma_norm: Floats
    plane_per_px: Floats
    xy_px: Floats
    t_s: Floats
    focal_px: float
    is_free: Bools
    link_px: float
    common_px: float

    @cached_property
    def since_s(self) -> Floats:
        """Times relative to the present view: (L,)."""
        return np.asarray(self.t_s - self.t_s[-1])

    @cached_property
    def xy(self) -> Floats:
        """Places now in the plane z = 1: (N, 2)."""
        return np.asarray(self.rays[-1, :, :2] / self.rays[-1, :, 2:])

    def neighbours(self) -> Ints:
        """The nearest tracks within ``link_px`` of each; the track itself for missing ones: (N, K)."""
        n = len(self.xy_px)
        every, alike = np.ones(n, dtype=bool), np.zeros(n, dtype=np.int64)
        return nearest_neighbours(self.xy_px, _N_NEIGHBOURS, self.link_px, every, alike)

    def points(self, track: Ints, thing: Ints | None = None) -> Points:
        """These tracks as points of bodies: ``track, thing (M,)``; None: all of one body."""
        thing = np.zeros(len(track), dtype=np.int64) if thing is None else thing
        return Points(self.rays_by_track, self.sigma_norm, self.since_s, track, thing)


def cost_of(redchi: Floats) -> Floats:
    """What a track costs on a body that leaves it this reduced chi-square, over the usual one: minus log likelihood.

    That of one Cauchy residual, whatever its number of views: a tracker's errors are alike in neighbouring frames.
    """
    return np.asarray(np.log1p(np.fmin(redchi, WORST_REDCHI)))


def fit_on_movers(points: Points, movers: RigidPaths, rate_hz: Floats) -> PathFit:
    """The points on the paths of movers, their rates not far below what is usual on each: ``rate_hz (K,)``."""
    median_hz = rate_hz[points.thing]
    return fit_on_paths(points, movers, median_hz, _LEAST_RATE * median_hz)


def body_views(history: TrackHistory, is_free: Bools, link_px: float, *, can_translate: bool) -> BodyViews:
    """The tracks of the history as bodies are found in them; whether the camera ``can_translate``."""
    camera = history.camera
    error_px, common_px = _MODEL_ERROR_PX, history.common_error_px
    if camera.is_assumed or camera.is_found:
        error_px = _UNKNOWN_LENS_ERROR * camera.image_size.longer_side_px
        common_px = math.hypot(common_px, _DRIFT_BY_LENS * error_px if can_translate else 0.0)
    return BodyViews(
        history.rays,
        views_by_track(history.rays),
        np.maximum(history.sigma_px, error_px) * history.plane_per_px,
        history.plane_per_px,
        history.xy_px,
        history.t_s,
        history.focal_px,
        is_free,
        link_px,
        common_px,
    )
