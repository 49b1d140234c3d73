"""Re-identification: movers that were hidden, behind a post or for want of texture, and are seen again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import RigidPaths
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.segmentation.bodies import SHIFT_RATE_HZ
from ttcvid.stages.segmentation.body_views import BodyViews
from ttcvid.stages.segmentation.data_association import Movers
from ttcvid.stages.segmentation.last_known import STEPS_TO_VELOCITY, UNSURE_HZ, recent_velocities
from ttcvid.stages.segmentation.scene import SeenScene

# A re-identified mover lies within this many of its extents of its predicted position.
_WITHIN_EXTENTS = 2.5
# Relative standard deviation of its speed: its last tracks were at the rim of what occluded it.
_UNSURE_PART = 0.3
# 99 % quantile of chi-square with three degrees of freedom: the velocities of one object.
_SAME_VELOCITY = 11.3
# Gauss-Newton steps a frame for the velocity of a known mover.
_STEPS = 1


def reidentified(
    views: BodyViews, seen: SeenScene, key: Ints, movers: Movers, found: list[Ints], paths: RigidPaths, rate_hz: Floats
) -> tuple[Ints, Movers, Bools]:
    """Which of J new movers are hidden ones: they lie at the predicted position of a hidden one, and move as it did.

    Parameters
    ----------
    key, movers : body of each track ``(N,)``, and the known movers.
    found, paths, rate_hz : tracks, trajectory and median rate of each new one.

    Returns both with the re-identified ones, and which of the new ones these are, ``(J,)``.
    """
    key, is_known, movers = key.copy(), np.zeros(len(found), dtype=bool), movers.take(np.arange(len(movers)))
    # One or two tracks may be left at the rim of what hides the others.
    hidden = np.flatnonzero((movers.n_missed > 0) & (movers.last.centre[:, 2] > 0.0))
    for place, members in enumerate(found):
        if not len(hidden):
            break
        as_hidden = _chi2_as_hidden(views, seen, members, movers.take(hidden))
        best = int(np.argmin(as_hidden))
        if not as_hidden[best] <= _SAME_VELOCITY:
            continue
        mover = hidden[best]
        key[members], is_known[place] = movers.key[mover], True
        movers.n_found[mover], movers.n_missed[mover] = movers.n_found[mover] + 1, 0
        movers.rate_hz[mover] = rate_hz[place]
        movers.paths.cam_R_past[mover], movers.paths.path[mover] = paths.cam_R_past[place], paths.path[place]
        hidden = np.delete(hidden, best)
    return key, movers, is_known


def with_velocities(views: BodyViews, scene: RigidPaths, number: Ints, movers: Movers) -> Movers:
    """Update the velocities of the movers that are found in this frame; ``number (N,)`` as from `numbers_of`."""
    is_found = movers.n_missed == 0
    track = np.flatnonzero(np.append(False, is_found)[number])
    if not len(track):
        return movers
    last, points = movers.last, views.points(track, number[track] - 1)
    v_hz, info = recent_velocities(points, scene.cam_R_past[0], last.v_hz, _STEPS)
    v_hz, info = np.where(is_found[:, None], v_hz, last.v_hz), np.where(is_found[:, None, None], info, last.info)
    return replace(movers, last=replace(last, v_hz=v_hz, info=info))


def _chi2_as_hidden(views: BodyViews, seen: SeenScene, members: Ints, hidden: Movers) -> Floats:
    """How much the velocity of some tracks differs from those of hidden movers: (K,), infinite where these are not.

    In units of what is unsure: of both by their tracks, and by how velocities change while a thing is not seen.
    """
    centre, chi2 = hidden.last.centre, np.full(len(hidden), np.inf)
    place, step, unseen_s = centre[:, :2] / centre[:, 2:], hidden.paths.path[:, -2], views.t_s[-1] - hidden.last.seen_s
    # How far they have gone in the plane z = 1 since they were seen, by their motion now.
    moved = np.linalg.norm(step[:, :2] - place * step[:, 2:], axis=1) / centre[:, 2]
    moved = moved * unseen_s / (views.t_s[-1] - views.t_s[-2])
    away = np.linalg.norm(np.mean(views.xy[members], axis=0) - place, axis=1)
    limit = _WITHIN_EXTENTS * hidden.last.extent / centre[:, 2] + views.link_px / views.focal_px + _UNSURE_PART * moved
    for mover in np.flatnonzero(away < limit):
        before = hidden.last.v_hz[mover]
        now, info = recent_velocities(views.points(members), seen.scene.cam_R_past[0], before[None], STEPS_TO_VELOCITY)
        both = np.stack([hidden.last.info[mover], info[0]]) / seen.median_redchi
        cov = np.linalg.inv(both + np.eye(3) / UNSURE_HZ**2).sum(axis=0)
        cov += (SHIFT_RATE_HZ * unseen_s[mover]) ** 2 * (before @ before) * np.eye(3)
        chi2[mover] = (now[0] - before) @ np.linalg.solve(cov, now[0] - before)
    return chi2
