"""From movers to straight motions, each with epipole and covariance; curved and non-rigid ones are rejected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.estimation.moving_body import BodyTracks, direction_from_lines
from ttcvid.geometry.estimation.translation import Translation, fit_translation
from ttcvid.geometry.paper.epipole import SIGNIFICANCE_SIGMAS
from ttcvid.model import Camera, Ints
from ttcvid.stages.horizon.movers import group_movers, moving_tracks
from ttcvid.stages.horizon.outlines import outline_motions
from ttcvid.stages.horizon.straight_motion import Motion, certainty
from ttcvid.stages.horizon.whole_tracks import Observations
from ttcvid.stages.tracking.silhouettes import Silhouettes

# Initial standard deviation of a coordinate, px; it is estimated from the residuals.
_SIGMA_START_PX = 0.2
# Prior of the turn rate in the first fit, rad/s: nearly free.
_FREE_TURN_RAD_S = 1.0
# A track with residuals this many times the median of its body is an outlier.
_FOREIGN_RESIDUAL = 3.0
_MAX_ROUNDS = 5
# Outliers are a mover of their own if they are at least this share of the tracks.
_OTHERS_PART = 0.25
# Largest ratio of its noise to that of the first mover.
_LEFTOVER_NOISE = 2.0
# With more observations than this a body is thinned out frame by frame: neighbouring frames tell little that is new.
_ENOUGH_OBSERVATIONS = 3000
# Points that scatter about a body by more than this part of its size are not those of a rigid one: cars are found to
# scatter by 0.1 to 0.5 %, people by 0.6 to 3 %.
_LOOSE_PART = 0.005
# Least number of tracks on an outline.
_OUTLINE_TRACKS = 3


def find_motions(
    rows: Observations,
    camera: Camera,
    config: HorizonCalibrationConfig,
    clip: int = 0,
    silhouettes: Silhouettes | None = None,
) -> list[Motion]:
    """The motions of all movers of a clip with a resting camera, from all its tracks.

    ``clip`` is a number for the results; ``silhouettes`` are the outlines of what moves, where there are pictures.
    """
    rays = rays_from_pixels(camera, rows.xy_px)
    is_seen = np.isfinite(rays[:, 0])
    source, rows = rows.take(is_seen), replace(rows, xy_px=rays[:, :2] * camera.fx_px).take(is_seen)
    moves = moving_tracks(rows, config)
    source, rows = source.take_tracks(moves), rows.take_tracks(moves)  # rows: undistorted, about the principal point
    mover = group_movers(rows, config.link_part * camera.image_size.width_px)
    motions: list[Motion] = []
    for number in np.unique(mover):
        tracks = rows.take_tracks(mover == number)
        by_tracks, by_outline = _motions_of(tracks, camera.fx_px, config), list[Motion]()
        if silhouettes is not None and len(tracks.starts) >= _OUTLINE_TRACKS:
            whole = source.take_tracks(mover == number)
            is_straight = any(motion.status == "used" and motion.looseness == 1.0 for motion in by_tracks)
            by_outline = outline_motions(whole, silhouettes, camera, config, may_bend=not is_straight)
            if not any(motion.status == "used" for motion in by_outline):
                # Points that scatter more than those of a rigid body: no outline says that they are of one body at all.
                by_tracks = [replace(m, status="not_rigid") if m.looseness > 1.0 else m for m in by_tracks]
        motions += [replace(motion, clip=clip, mover=int(number)) for motion in (*by_outline, *by_tracks)]
    return motions


def _motions_of(rows: Observations, focal_px: float, config: HorizonCalibrationConfig) -> list[Motion]:
    """The motions of a mover; one that bends is looked at again in halves, as long as they are long enough.

    Long motions are cut into pieces: tracks of people who follow each other are connected. Tracks that
    do not go with the others are tried by themselves: two who walk side by side, and part.
    """
    duration_s = float(np.ptp(rows.t_s)) if len(rows.t_s) else 0.0
    if len(rows.starts) < config.min_tracks or duration_s < config.min_motion_s:
        return []
    if duration_s > config.max_motion_s:
        pieces = _pieces(rows, int(np.ceil(duration_s / config.max_motion_s)), config)
        return [motion for piece in pieces for motion in _motions_of(piece, focal_px, config)]
    motion = _fitted(rows, focal_px, config)
    if motion.status == "curved" and duration_s >= 2 * config.min_motion_s:
        halves = [half for part in _pieces(rows, 2, config) for half in _motions_of(part, focal_px, config)]
        return halves if any(half.status not in ("curved", "not_rigid") for half in halves) else [motion]
    others = rows.take_tracks(~np.isin(rows.track_id[rows.starts], motion.track_id))
    if motion.status == "not_rigid" or len(others.starts) < _OTHERS_PART * len(rows.starts):
        return [motion]
    # The others are refused if noisier: then they are where one mover hides another.
    return [
        motion,
        *(
            replace(other, status="not_rigid")
            if other.status == "used" and other.noise_px > _LEFTOVER_NOISE * motion.noise_px
            else other
            for other in _motions_of(others, focal_px, config)
        ),
    ]


def _pieces(rows: Observations, count: int, config: HorizonCalibrationConfig) -> list[Observations]:
    """The tracks cut into ``count`` pieces of equal duration, each with what still moves in it."""
    borders_s = np.linspace(rows.t_s.min(), rows.t_s.max(), count + 1)[1:-1]
    number = np.searchsorted(borders_s, rows.t_s, side="right")
    pieces = [rows.take(number == place) for place in range(count)]
    return [piece.take_tracks(moving_tracks(piece, config)) for piece in pieces if len(piece.frame)]


def _fitted(rows: Observations, focal_px: float, config: HorizonCalibrationConfig) -> Motion:
    """The tracks of a mover as one translating body, less the tracks that do not go with the others."""
    tracks, track_id = _body(rows, focal_px)
    span, no_direction = (int(rows.frame.min()), int(rows.frame.max())), (np.full(3, np.nan), np.full((3, 3), np.nan))
    nothing = Motion("not_rigid", track_id, *span, float(np.ptp(rows.t_s)), *no_direction)
    free: Translation | None = None
    for _ in range(_MAX_ROUNDS):
        if tracks.n_tracks < config.min_tracks:
            return nothing
        start = direction_from_lines(tracks) if free is None else free.direction
        free = fit_translation(tracks, start, config.speed_change_hz, _FREE_TURN_RAD_S, config.error_memory_s)
        if free is None:
            return nothing
        belongs = (free.residual < _FOREIGN_RESIDUAL * max(1.0, float(np.median(free.residual)))) & (free.rate_hz > 0)
        if belongs.all():
            break
        tracks, track_id = tracks.take(belongs), track_id[belongs]
    if free is None or tracks.n_tracks < config.min_tracks:
        return nothing
    turned_rad = free.turn_rad_s * float(np.ptp(tracks.t_s))
    found = replace(nothing, track_id=track_id, turned_rad=turned_rad)
    is_sure = abs(free.turn_rad_s) > SIGNIFICANCE_SIGMAS * free.turn_sigma_rad_s
    if is_sure and abs(turned_rad) > np.radians(config.max_turn_deg):
        return replace(found, status="curved")
    turn_sigma = np.radians(config.turn_sigma_deg_s)
    straight = fit_translation(tracks, free.direction, config.speed_change_hz, turn_sigma, config.error_memory_s)
    if straight is None:
        return nothing
    noise_px, size_px = straight.noise * _SIGMA_START_PX, _size(tracks) * focal_px
    return replace(
        found,
        status=certainty(straight.covariance, config),
        direction=straight.direction,
        covariance=straight.covariance,
        noise_px=noise_px,
        looseness=max(1.0, noise_px / max(config.rigid_noise_px, _LOOSE_PART * size_px)),
        correlation=straight.correlation,
    )


def _size(tracks: BodyTracks) -> float:
    """How far the points of a body are apart: the diagonal about them, at most times."""
    order = np.argsort(tracks.t_s, kind="stable")
    _, first = np.unique(tracks.t_s[order], return_index=True)
    xy = tracks.xy[order]
    sides = np.maximum.reduceat(xy, first) - np.minimum.reduceat(xy, first)
    return float(np.median(np.linalg.norm(sides, axis=1)))


def _body(rows: Observations, focal_px: float) -> tuple[BodyTracks, Ints]:
    """The rows as tracks of one body, thinned out where there are very many, and the number of each track."""
    step = int(np.ceil(len(rows.frame) / _ENOUGH_OBSERVATIONS))
    rows = rows.take(np.isin(rows.frame, np.unique(rows.frame)[::step]))
    rows = rows.take_tracks(rows.lengths >= 3)
    number = np.repeat(np.arange(len(rows.starts)), rows.lengths)
    body = BodyTracks(number, rows.t_s, rows.xy_px / focal_px, _SIGMA_START_PX / focal_px)
    return body, rows.track_id[rows.starts]
