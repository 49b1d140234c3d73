"""From movers to straight motions, each with its epipole and covariance; what bends or falls apart is refused."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.geometry.camera import rays_from_pixels
from ttcvid.geometry.translation import BodyTracks, Translation, direction_from_lines, fit_translation
from ttcvid.model import Bools, Camera, Floats, Ints
from ttcvid.stages.movers import group_movers, moving_tracks
from ttcvid.stages.whole_tracks import Observations

# Noise of a coordinate that the fit starts with, px; it is estimated from the residuals.
_SIGMA_START_PX = 0.2
# A free turn is looked for first: as good as no prior, rad/s.
_FREE_TURN_RAD_S = 1.0
# A track whose residuals are so many times the usual ones of its body is no part of it.
_FOREIGN_RESIDUAL = 3.0
_MAX_ROUNDS = 4
# With more observations than this a body is thinned out frame by frame: neighbouring frames tell little that is new.
_ENOUGH_OBSERVATIONS = 6000
# Turns are believed from so many standard deviations on.
_SURE_SIGMAS = 3.0


@dataclass(frozen=True)
class Motion:
    """One straight motion of one mover in one clip.

    ``status``: ``used`` (of the horizon), ``off_horizon``, ``curved``, ``not_rigid`` (the tracks do not move as one),
    ``uncertain`` (the epipole could be anywhere). ``track_id`` are its tracks; ``direction (3,)`` and ``covariance
    (3, 3)`` NaN where there are none; ``turned_rad`` by how much its path bends; ``noise_px``, ``correlation`` as in
    `Translation`.
    """

    clip: int
    mover: int
    status: str
    track_id: Ints
    first_frame: int
    last_frame: int
    duration_s: float
    direction: Floats
    covariance: Floats
    turned_rad: float = np.nan
    noise_px: float = np.nan
    correlation: float = np.nan


def find_motions(
    rows: Observations, camera: Camera, nominal_dt_s: float, config: HorizonCalibrationConfig, clip: int = 0
) -> list[Motion]:
    """The motions of all movers of a clip with a resting camera.

    Parameters
    ----------
    rows : all tracks of the clip.
    nominal_dt_s : usual time between two frames.
    clip : number of the clip, for the results.
    """
    rays = rays_from_pixels(camera, rows.xy_px)
    rows = replace(rows, xy_px=rays[:, :2] * camera.fx_px)  # undistorted from here on, about the principal point
    rows = rows.take(np.isfinite(rows.xy_px[:, 0]))
    if not len(rows.frame):
        return []
    rows = rows.take_tracks(moving_tracks(rows, config))
    mover = group_movers(rows, nominal_dt_s, config.link_part * camera.image_size.width_px)
    motions: list[Motion] = []
    for number in np.unique(mover):
        tracks = rows.take_tracks(mover == number)
        motions += _motions_of(tracks, camera.fx_px, config, clip, int(number))
    return motions


def _motions_of(
    rows: Observations, focal_px: float, config: HorizonCalibrationConfig, clip: int, mover: int
) -> list[Motion]:
    """The motion of a mover; one that bends is looked at again in halves, as long as they are long enough."""
    duration_s = float(np.ptp(rows.t_s)) if len(rows.t_s) else 0.0
    if len(rows.starts) < config.min_tracks or duration_s < config.min_motion_s:
        return []
    motion = _fitted(rows, focal_px, config, clip, mover)
    if motion.status != "curved" or duration_s < 2 * config.min_motion_s:
        return [motion]
    middle_s = 0.5 * (rows.t_s.min() + rows.t_s.max())
    halves: list[Motion] = []
    for part in (rows.t_s < middle_s, rows.t_s >= middle_s):
        half = rows.take(part)
        if len(half.frame):
            half = half.take_tracks(moving_tracks(half, config))
        halves += _motions_of(half, focal_px, config, clip, mover)
    return halves if any(half.status not in ("curved", "not_rigid") for half in halves) else [motion]


def _fitted(rows: Observations, focal_px: float, config: HorizonCalibrationConfig, clip: int, mover: int) -> Motion:
    """The tracks of a mover as one translating body, less the tracks that do not go with the others."""
    tracks, track_id = _body(rows, focal_px)
    nothing = _bare(rows, clip, mover, "not_rigid", track_id)
    free: Translation | None = None
    n_before = tracks.n_tracks
    for _ in range(_MAX_ROUNDS):
        if tracks.n_tracks < max(config.min_tracks, n_before // 2):
            return nothing
        start = direction_from_lines(tracks) if free is None else free.direction
        free = fit_translation(tracks, start, config.speed_change_hz, _FREE_TURN_RAD_S, config.error_memory_s)
        if free is None:
            return nothing
        belongs = (free.residual < _FOREIGN_RESIDUAL * max(1.0, float(np.median(free.residual)))) & (free.rate_hz > 0)
        if belongs.all():
            break
        tracks, track_id = tracks.take(belongs), track_id[belongs]
    else:
        return nothing
    turned_rad = free.turn_rad_s * float(np.ptp(tracks.t_s))
    found = replace(nothing, track_id=track_id, turned_rad=turned_rad)
    is_sure = abs(free.turn_rad_s) > _SURE_SIGMAS * free.turn_sigma_rad_s
    if is_sure and abs(turned_rad) > np.radians(config.max_turn_deg):
        return replace(found, status="curved")
    turn_sigma = np.radians(config.turn_sigma_deg_s)
    straight = fit_translation(tracks, free.direction, config.speed_change_hz, turn_sigma, config.error_memory_s)
    if straight is None:
        return nothing
    sigma_rad = float(np.sqrt(np.linalg.norm(straight.covariance, 2)))
    return replace(
        found,
        status="uncertain" if sigma_rad > np.radians(config.max_sigma_deg) else "used",
        direction=straight.direction,
        covariance=straight.covariance,
        noise_px=straight.noise * _SIGMA_START_PX,
        correlation=straight.correlation,
    )


def _bare(rows: Observations, clip: int, mover: int, status: str, track_id: Ints) -> Motion:
    frames, seen_s = rows.frame, float(np.ptp(rows.t_s))
    nothing = np.full(3, np.nan)
    return Motion(
        clip, mover, status, track_id, int(frames.min()), int(frames.max()), seen_s, nothing, np.full((3, 3), np.nan)
    )


def _body(rows: Observations, focal_px: float) -> tuple[BodyTracks, Ints]:
    """The rows as tracks of one body, thinned out where there are very many, and the number of each track."""
    rows = rows.take(_thinned(rows.frame))
    rows = rows.take_tracks(rows.lengths >= 3)
    number = np.repeat(np.arange(len(rows.starts)), rows.lengths)
    body = BodyTracks(number, rows.t_s, rows.xy_px / focal_px, _SIGMA_START_PX / focal_px)
    return body, rows.track_id[rows.starts]


def _thinned(frame: Ints) -> Bools:
    step = int(np.ceil(len(frame) / _ENOUGH_OBSERVATIONS))
    frames = np.unique(frame)
    return np.isin(frame, frames[::step])
