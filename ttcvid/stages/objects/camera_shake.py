"""Stabilisation: movers as seen by a camera that keeps its present velocity; the shake is the camera's, not theirs.

A handheld or flying camera shakes. An object that moves straight shifts with it, the more the nearer it is; a straight
trajectory through 20 views, or a parabola, then leads elsewhere. The scene tells how the camera shook, and how far the
tracks of the object follow that tells its depth in units of the scene.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.estimation.growth import growth_sums
from ttcvid.model import Floats, Ints
from ttcvid.stages.tracking.history import TrackHistory

# The tracks of a mover have to follow the shake with this significance, in sigmas.
_SURE_SIGMAS = 3.0
# Tracks with a reduced chi-square of more than so many times the median are rejected, in so many rounds.
_MISFIT, _ROUNDS = 4.0, 2
_LEAST_TRACKS = 3


def stabilised(history: TrackHistory, sway: Floats, members: Ints, thing: Ints) -> Floats:
    """Positions of the tracks in the plane z = 1, those of movers without camera shake.

    Parameters
    ----------
    history
        Views of all tracks.
    sway
        ``(L, 3)`` offset of the scene from a steady trajectory, in its units (`stages.segmentation.bodies.shake_of`).
    members, thing
        ``(M,)`` tracks of movers, and the mover of each.

    Returns
    -------
    ``(L, N, 2)``, NaN where not observed.
    """
    if not sway.any() or not len(members):
        return history.xy
    xy = history.xy.copy()
    for number in np.unique(thing):
        own = members[thing == number]
        found = _of_one(xy[:, own], history.since_s, history.sigma_norm[own], sway)
        if found is not None:
            xy[:, own] = found
    return xy


def _of_one(xy: Floats, since_s: Floats, sigma_norm: Floats, sway: Floats) -> Floats | None:
    """Views ``xy (L, M, 2)`` of the tracks of a thing without the sway; None where they do not tell of it."""
    sums = growth_sums(xy, since_s, sigma_norm, sway)
    fits = np.isfinite(xy).all(axis=2).sum(axis=0) > 1
    misfit = np.ones(len(fits))
    for _ in range(_ROUNDS):
        if np.count_nonzero(fits) < _LEAST_TRACKS:
            return None
        unknowns, cov = sums.unknowns(fits)
        misfit = sums.misfits(unknowns)
        fits &= misfit <= _MISFIT * max(float(np.median(misfit[fits])), 1.0)
    if not np.isfinite(unknowns).all():
        return None
    c, s = float(unknowns[2]), float(unknowns[3])
    if not s > _SURE_SIGMAS * np.sqrt(max(float(misfit[fits].mean()), 1.0) * cov[3, 3]):
        return None
    depth = (1.0 + c * since_s + s * sway[:, 2])[:, None]
    off = s * sway / depth
    if not (depth > 0.0).all():
        return None
    return np.asarray((xy - off[:, None, :2]) / (1.0 - off[:, None, 2:]))
