"""Straight motions from the outlines of movers: the lines of their tops and of their feet meet at the epipole.

An outline is followed for as long as the mover is seen, whatever limbs and clothes do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.config import HorizonCalibrationConfig
from ttcvid.geometry.camera.pinhole import rays_from_pixels
from ttcvid.geometry.horizon.outline import fit_outline
from ttcvid.geometry.medians import median
from ttcvid.model import Camera, Floats, Ints
from ttcvid.stages.horizon.straight_motion import OUTLINE, Motion, certainty
from ttcvid.stages.horizon.whole_tracks import Observations
from ttcvid.stages.tracking.silhouettes import Silhouettes, extent_px

# Top and bottom are searched within this share of the mover's height to either side of its middle.
_WIDTH_PART = 0.12
_NARROW_PX = 2.0
# Constant error of the border of a mover, px: half a pixel of blur, a contact shadow.
_BORDER_PX = 0.5
# The outline of a rigid body scatters by less than this share of its height.
_MOST_SCATTER = 0.03
# So much of the variance along the way is that of a steady motion; what is hidden by and by does not go on steadily.
_LEAST_STEADINESS = 0.9
# An outline is followed for at least so many correlation times of its errors: a whole stride.
_LEAST_MEMORIES = 2.0
_LEAST_HEIGHT_PX = 12.0
_SURE_SIGMAS = 4.0


def outline_motions(
    rows: Observations, silhouettes: Silhouettes, camera: Camera, config: HorizonCalibrationConfig, *, may_bend: bool
) -> list[Motion]:
    """The motions of one mover, of these tracks in source pixels, from its outlines: two or more where its path bends.

    It does not where it may not (``may_bend``), since the points of a rigid body move straight: an outline that bends
    then changes its shape.
    """
    motions = _motions_of(_outline_of(rows, silhouettes, camera), camera, config, may_bend)
    return [replace(motion, track_id=np.unique(rows.track_id)) for motion in motions]


_Outline = tuple[Floats, Ints, Floats]
"""x, top and bottom in normalised coordinates ``(N, 3)``, frames and times ``(N,)`` where a mover is seen."""


def _outline_of(rows: Observations, silhouettes: Silhouettes, camera: Camera) -> _Outline:
    """The outline of a mover, of these tracks in source pixels."""
    order = np.argsort(rows.frame, kind="stable")
    frames, first = np.unique(rows.frame[order], return_index=True)
    middle_px = [np.median(part, axis=0) for part in np.split(rows.xy_px[order], first[1:])]
    masks = [silhouettes.mask(frame) for frame in frames.tolist()]
    half_px, nowhere = _NARROW_PX, (np.nan, np.nan)
    for _ in range(2):
        found = [
            nowhere if mask is None else extent_px(mask, at[0], at[1], half_px) or nowhere
            for mask, at in zip(masks, middle_px, strict=True)
        ]
        rows_px = np.array(found)
        # Where nothing stands, the median is NaN, which is not more than the least.
        half_px = max(_NARROW_PX, _WIDTH_PART * median(np.diff(rows_px)[np.isfinite(rows_px[:, 0]), 0]))
    is_seen = np.isfinite(rows_px[:, 0])
    x_px = np.array(middle_px)[is_seen, 0]
    top, bottom = (rays_from_pixels(camera, np.column_stack([x_px, rows_px[is_seen, side]])) for side in (0, 1))
    outline = np.column_stack([0.5 * (top[:, 0] + bottom[:, 0]), top[:, 1], bottom[:, 1]])
    return outline, frames[is_seen], rows.t_s[order][first][is_seen]


def _motions_of(seen: _Outline, camera: Camera, config: HorizonCalibrationConfig, may_bend: bool) -> list[Motion]:
    """The motion of one outline, in halves where its way bends; none of what is too short or too small."""
    outline, frame, t_s = seen
    duration_s = float(np.ptp(t_s)) if len(t_s) else 0.0
    least_s = max(config.min_motion_s, _LEAST_MEMORIES * config.error_memory_s)
    if duration_s < least_s:
        return []
    height_px = float(np.median(outline[:, 2] - outline[:, 1])) * camera.fy_px
    way_px = float(np.linalg.norm(np.ptp(outline, axis=0))) * camera.fx_px
    if height_px < _LEAST_HEIGHT_PX or way_px < config.min_path_px:
        return []
    blocks = max(5, int(duration_s / config.error_memory_s))
    block = np.minimum(((t_s - t_s[0]) / duration_s * blocks).astype(np.int64), blocks - 1)
    fit = fit_outline(outline, t_s, block, duration_s / config.error_memory_s, _BORDER_PX / camera.fy_px)
    if fit is None:
        return []
    if may_bend and fit.bend_sigmas > _SURE_SIGMAS and duration_s >= 2 * least_s:
        half = t_s < t_s[0] + 0.5 * duration_s
        return [
            m
            for part in (half, ~half)
            for m in _motions_of((outline[part], frame[part], t_s[part]), camera, config, may_bend)
        ]
    status = certainty(fit.covariance, config)
    noise_px = fit.noise * camera.fy_px
    if noise_px > _MOST_SCATTER * height_px or fit.steadiness < _LEAST_STEADINESS:
        status = "not_rigid"
    elif fit.bend_sigmas > _SURE_SIGMAS:
        status = "curved"
    return [
        Motion(
            status=status,
            track_id=np.empty(0, dtype=np.int64),
            first_frame=int(frame[0]),
            last_frame=int(frame[-1]),
            duration_s=duration_s,
            direction=fit.direction,
            covariance=fit.covariance,
            noise_px=noise_px,
            evidence=OUTLINE,
        )
    ]
