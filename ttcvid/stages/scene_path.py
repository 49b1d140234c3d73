"""The path of the static scene relative to the camera, improved by all views of its tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.geometry.shared_path import PathBeliefs, SharedPaths, believed_paths, fit_shared_paths
from ttcvid.geometry.whole_track_on_path import NO_PATH
from ttcvid.model import Bools, Floats
from ttcvid.stages.egomotion import Egomotion
from ttcvid.stages.history import TrackHistory

# The direction comes from part of the views that the path is fitted to: it is believed this much less, so that these
# count once, and to no better than this angle.
_BELIEF_FACTOR, _BELIEF_FLOOR_RAD = 9.0, float(np.radians(0.15))
# Own acceleration over own speed: 2 m/s^2 at 10 m/s. Across, the single steps have turned already.
_OWN_ALONG_HZ, _OWN_ACROSS_HZ = 0.2, 0.02
# Views that a track needs to say something, and tracks that the path needs.
_LEAST_VIEWS, _LEAST_TRACKS = 4, 12


def with_scene_path(history: TrackHistory, is_free: Bools, egomotion: Egomotion) -> tuple[TrackHistory, Egomotion]:
    """Improve direction, past rotations and speed of own motion by the whole tracks of the scene.

    Three things that two views cannot tell, or only with the errors that their matching has in common, are left in the
    sum of the single steps: a wrong direction at its end, an acceleration, and a rotation rate. All tracks share them.

    Parameters
    ----------
    is_free : (N,) tracks that are not frozen to their pixel.
    egomotion : of the last step. Without a direction there is no path, and nothing changes.
    """
    if egomotion.direction is None or egomotion.direction_cov is None:
        return history, egomotion
    n_views = np.count_nonzero(np.isfinite(history.xy[..., 0]), axis=0)
    is_used = is_free & (n_views >= _LEAST_VIEWS) & np.isfinite(history.xy[-1, :, 0])
    if np.count_nonzero(is_used) < _LEAST_TRACKS:
        return history, egomotion
    belief = _belief(history, egomotion.direction, egomotion.direction_cov)
    path_of = np.where(is_used, 0, NO_PATH)
    scene = fit_shared_paths(history.xy, history.since_s, history.sigma_norm, belief, path_of)
    improved = replace(egomotion, direction=scene.direction[0], direction_cov=scene.cov[0, :3, :3])
    scene_direction = history.scene_direction.copy()
    scene_direction[-1] = scene.direction[0]
    return replace(history, scene=scene, scene_direction=scene_direction), improved


def scene_path(history: TrackHistory, direction: Floats, direction_cov: Floats) -> SharedPaths:
    """The path of the scene: as its tracks see it together, or as the single steps add up to."""
    if history.scene is not None:
        return history.scene
    return believed_paths(_belief(history, direction, direction_cov))


def _belief(history: TrackHistory, direction: Floats, direction_cov: Floats) -> PathBeliefs:
    across = np.eye(3) - np.outer(direction, direction)
    cov = _BELIEF_FACTOR * direction_cov + _BELIEF_FLOOR_RAD**2 * across
    sigma_rad_s = history.rotation_rate_sigma_rad_s
    return PathBeliefs(
        history.scene_steps[None], direction[None], cov[None], _OWN_ALONG_HZ, _OWN_ACROSS_HZ, sigma_rad_s
    )
