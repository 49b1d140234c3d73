"""Movers as turning bodies, where their tracks contradict the trajectory that they have.

Gauss-Newton steps take turns of views and points: from the trajectory of one half of a turning bus they do not come
round to that of the bus in thirty steps. A turning body has nine unknowns for all views, and is found in one search.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import Points, RigidPaths
from ttcvid.geometry.estimation.turning_body import TURN_SIGMA_RAD_S, fit_turning_body
from ttcvid.geometry.rotation import rotation_from_vector, turned_into_plane
from ttcvid.model import Floats, Ints
from ttcvid.stages.segmentation.bodies import SHIFT_RATE_HZ, refined_movers
from ttcvid.stages.segmentation.body_views import BodyViews, cost_of, fit_on_movers
from ttcvid.stages.segmentation.scene import SeenScene

LEAST_POINTS, MOST_POINTS = 8, 50
"""A turning body needs so many tracks, and takes at most so many: neighbours share errors, and more take time."""
# It is one if its median reduced chi-square (over the usual one) is below this: what turns also follows several things
# a little better that do not move alike.
_FITS = 2.0
# Gauss-Newton steps from the turning body: its acceleration may change.
_STEPS = 2


def with_turning_bodies(
    views: BodyViews, seen: SeenScene, points: Points, movers: RigidPaths, rate_hz: Floats, gate: float
) -> RigidPaths:
    """K movers as turning bodies where these explain their tracks, in the units of their inverse depths.

    ``rate_hz (K,)`` are these, 1/s, ``points`` the tracks of the movers; a reduced chi-square (over the usual one)
    above the ``gate`` contradicts a trajectory. Most of its tracks have to contradict that of a mover: of somebody who
    walks, some always do.
    """
    redchi = fit_on_movers(points, movers, rate_hz).redchi / seen.median_redchi
    n_off = np.bincount(points.thing, redchi > gate, len(movers))
    n_points = np.bincount(points.thing, minlength=len(movers))
    is_doubtful = (2 * n_off > n_points) & (n_points >= LEAST_POINTS) & (rate_hz > 0.0)
    movers = movers.take(np.arange(len(movers)))
    for mover in np.flatnonzero(is_doubtful):
        is_own = points.thing == mover
        own = views.points(points.track[is_own])
        body, body_hz = _turning_body(views, seen.scene, own.track)
        body, own_hz = refined_movers(body, seen.scene, own, np.array([_STEPS]), np.full(len(own.track), body_hz))
        by_body = fit_on_movers(own, body, own_hz).redchi / seen.median_redchi
        if np.median(by_body) < _FITS and cost_of(by_body).sum() < cost_of(redchi[is_own]).sum():
            # At the distance that it had: its last known position is in the same units.
            movers.cam_R_past[mover] = body.cam_R_past[0]
            movers.path[mover] = own_hz[0] / rate_hz[mover] * body.path[0]
    return movers


def _turning_body(views: BodyViews, scene: RigidPaths, tracks: Ints) -> tuple[RigidPaths, float]:
    """The turning body that ``tracks (M,)`` show, and its inverse depth, 1/s."""
    used = tracks[:: -(-len(tracks) // MOST_POINTS)]
    xy = turned_into_plane(views.rays.take(used, axis=1), scene.cam_R_past[0])
    bend_hz = float(np.hypot(SHIFT_RATE_HZ, TURN_SIGMA_RAD_S))
    body = fit_turning_body(xy, views.since_s, views.sigma_norm[used], bend_hz, TURN_SIGMA_RAD_S)
    back = rotation_from_vector(-views.since_s[:, None] * body.turn_rad_s)
    return RigidPaths((back @ scene.cam_R_past[0])[None], body.path_turned_back(views.since_s)[None]), body.rate_hz
