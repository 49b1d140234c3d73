"""Re-initialisation: movers whose trajectories have failed start again as bodies with a steady turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import Points, RigidPaths, fit_on_paths
from ttcvid.geometry.estimation.turning_body import TURN_SIGMA_RAD_S, fit_turning_body
from ttcvid.geometry.medians import median, medians
from ttcvid.geometry.rotation import rotation_from_vector, turned_into_plane
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.bodies import SHIFT_RATE_HZ, with_unit_speed

# A mover is re-initialised where its trajectory explains its points worse than this, over the median reduced
# chi-square, and the new one is better by the factor: of two equally good ones, one is better by chance.
_BADLY, _CLEARLY = 1.0, 1.5
# Where the first search, from no turn, finds a body that explains the points worse than the present trajectory by
# this factor, they are no body: in eleven scenes with turning objects, 37 bodies that were better in the end reached
# 1.7 at most; a street full of cars taken for one mover reaches 2 to 600.
_NO_BODY = 2.0
# Minimum and maximum number of points for the turn of a body, every so many views: more are slower and hardly better.
# Each is observed in at least so many views: a turn before that is unknown.
_LEAST_POINTS, _ENOUGH_POINTS, _EVERY_VIEWS = 8, 16, 2
_LEAST_VIEWS = 6
# Acceleration of a turning body: turn rate times speed across, and braking as of any mover along.
_BEND_HZ = float(np.hypot(SHIFT_RATE_HZ, TURN_SIGMA_RAD_S))


def reinitialised(
    movers: RigidPaths, rate_hz: Floats, is_asked: Bools, scene: RigidPaths, points: Points, median_redchi: float
) -> tuple[RigidPaths, Floats]:
    """Re-initialise movers that explain their points badly as steadily turning bodies, where that explains them better.

    What starts to turn, or is small, is followed as if it moved straight: by a trajectory without turn that swings with
    the mover's centre, at wrong depths. No small step leads from there to the turn, and the farther it goes the more
    tracks the trajectory loses: a bus becomes two. A small body looks nearly the same turned one way, and turned the
    other way with near and far exchanged (Necker's reversal); which it was shows when it is near. A steady turn and a
    steady acceleration, nine unknowns, are estimated from the views alone.

    ``rate_hz (K,)`` is the median inverse depth (times speed) of each mover, also returned; ``is_asked (K,)`` movers
    may be re-initialised; ``median_redchi`` is the median reduced chi-square of tracks on the scene's trajectory.
    """
    own = np.flatnonzero(is_asked[points.thing])
    if not len(own):
        return movers, rate_hz
    points = replace(points, track=points.track[own], thing=points.thing[own])
    fit = fit_on_paths(points, movers, rate_hz[points.thing])
    redchi = medians(fit.redchi, points.thing, len(movers))
    is_known = fit.n_views >= _LEAST_VIEWS
    n_known = np.bincount(points.thing, is_known, len(movers))
    cam_R_past, path, rate_hz = movers.cam_R_past.copy(), movers.path.copy(), rate_hz.copy()
    # NaN, without points, is not worse.
    for mover in np.flatnonzero((redchi > _BADLY * median_redchi) & (n_known >= _LEAST_POINTS)):
        is_own = points.thing == mover
        worst = _NO_BODY * float(redchi[mover])
        anew, anew_hz = _turning_steadily(points, points.track[is_own & is_known], scene, worst)
        of_one = replace(points, track=points.track[is_own], thing=np.zeros(np.count_nonzero(is_own), dtype=np.int64))
        anew_fit = fit_on_paths(of_one, anew, np.full(len(of_one.track), anew_hz))
        if median(anew_fit.redchi) < redchi[mover] / _CLEARLY:
            cam_R_past[mover], path[mover] = anew.cam_R_past[0], anew.path[0]
            rate_hz[mover] = medians(anew_fit.rate_hz, of_one.thing, 1)[0]
    return RigidPaths(cam_R_past, path), rate_hz


def _turning_steadily(points: Points, track: Ints, scene: RigidPaths, worst: float) -> tuple[RigidPaths, float]:
    """The path of the thing with the tracks (M,), as if it turned steadily, and the rate of its middle on it, 1/s.

    Where it leaves more than the ``worst`` that is usual by the degree of freedom, it is not looked for long.
    """
    track, since_s = track[:: -(-len(track) // _ENOUGH_POINTS)], points.since_s
    some = slice((len(since_s) - 1) % _EVERY_VIEWS, None, _EVERY_VIEWS)
    rays = points.rays[track, :, -len(since_s) :].transpose(2, 0, 1)[some]
    xy = turned_into_plane(rays, scene.cam_R_past[0, some])
    noise = points.sigma_norm[track]
    body = fit_turning_body(
        xy, since_s[some], noise, _BEND_HZ, TURN_SIGMA_RAD_S, lambda found: found.median_chi2 < worst
    )
    turned_back = rotation_from_vector(-since_s[:, None] * body.turn_rad_s)
    path = RigidPaths((turned_back @ scene.cam_R_past[0])[None], body.path_turned_back(since_s)[None])
    # What stops just now has hardly a speed at the present view: its mean speed is the unit, as of all movers.
    path, speed = with_unit_speed(path, since_s)
    return path, body.rate_hz * speed
