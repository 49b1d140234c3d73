"""Self-calibration: the focal length of an unknown camera, from the first frames of its clip."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ttcvid.geometry.estimation.bundle import Views
from ttcvid.geometry.estimation.focal_length import FocalFit, fit_focal_length
from ttcvid.model import Floats, ImageSize, Ints, PointSet
from ttcvid.stages.tracking.groups import in_common

# A frame is looked at when the picture has moved by this part of its width since the last one that was, or when so
# many of its points are gone; so many of these make a window, and fewer than the least say nothing.
_STEP_PART, _KEPT_POINTS, _WINDOW_FRAMES, _LEAST_FRAMES = 0.02, 0.75, 12, 6
# So many windows that tell something are enough.
_ENOUGH_WINDOWS = 4
# Points of a window: at most, at least, and the least number of frames that each is seen in; they are spread over cells
# with this side in picture widths, of which so many have to be filled.
_MOST_POINTS, _LEAST_POINTS, _LEAST_VIEWS, _CELL_PART, _LEAST_CELLS = 300, 60, 3, 1.0 / 16.0, 25
# A point that moves by less than this in a window, while the picture moves, is burned in or on the bonnet, px.
_STAYS_PX = 0.5
# Errors that the tracks of a window have in common, px: they pass for a wrong focal length. On KITTI's drives, at turns
# of 1 to 3 deg, it came out too short by 6 to 17 %, the static scene alone as well. A turn that is too small for a
# single window to tell the focal length to this part is not worth the search.
_COMMON_ERROR_PX, _HOPELESS = 0.4, 0.15
# No window tells it better than to this part: movers pull, and the lens is not quite what it is taken for.
_LEAST_SIGMA = 0.02
# Residuals beyond this part of the picture's width, more points than this behind the camera, or a lens more unusual
# than one in a thousand (chi-square with three degrees; one in twenty where no other window confirms it): not one
# static scene. Movers that are taken for scene bend it.
_MOST_SPREAD, _MOST_BEHIND, _MOST_LENS_CHI2, _MOST_LENS_CHI2_ALONE = 0.0003, 0.1, 16.3, 7.8
# The clip tells the focal length when it is known to this part; by a single window, which nothing confirms, to that.
_SURE, _SURE_ALONE = 0.08, 0.05


@dataclass(frozen=True)
class FocalLength:
    """An estimated focal length: ``focal_px`` with the relative standard deviation ``sigma``."""

    focal_px: float
    sigma: float


@dataclass(frozen=True)
class SeenPoints:
    """The points of a frame at ``t_s``; ``is_new`` where no track continues from the frame before (a cut)."""

    t_s: float
    points: PointSet
    is_new: bool = False


def find_focal_length(frames: Iterable[SeenPoints], image_size: ImageSize) -> FocalLength | None:
    """Estimate the focal length from all frames of a clip together.

    None where they do not determine it: the camera hardly turns, or the points do not fit one static scene.
    """
    fits: list[FocalFit] = []
    n_contradicting = 0
    for window in _windows(frames, image_size):
        fit = _fit(window, image_size)
        if fit is None:
            continue
        # One static scene, and a lens that there may be, explain the window.
        is_close = fit.spread_px < _MOST_SPREAD * image_size.width_px
        if is_close and fit.behind < _MOST_BEHIND and fit.lens_chi2 < _MOST_LENS_CHI2:
            fits.append(fit)
        else:
            n_contradicting += 1
        if len(fits) == _ENOUGH_WINDOWS:
            break
    return None if n_contradicting > len(fits) else _together(fits, image_size)


def _windows(frames: Iterable[SeenPoints], image_size: ImageSize) -> Iterator[list[SeenPoints]]:
    """Frames that are far enough apart, some at a time; the last of a window is the first of the next one."""
    window: list[SeenPoints] = []
    for frame in frames:
        if not window or frame.is_new:
            if len(window) >= _LEAST_FRAMES:
                yield window
            window = [frame]
        elif _has_moved(window[-1].points, frame.points, image_size):
            window.append(frame)
            if len(window) == _WINDOW_FRAMES:
                yield window
                window = [frame]
    if len(window) >= _LEAST_FRAMES:
        yield window


def _has_moved(one: PointSet, other: PointSet, image_size: ImageSize) -> bool:
    before_px, now_px = in_common(one, other)
    if len(now_px) < _KEPT_POINTS * len(one.track_id):
        return True
    if not len(now_px):
        return len(other.track_id) > 0
    return bool(np.median(np.linalg.norm(now_px - before_px, axis=1)) > _STEP_PART * image_size.width_px)


def _fit(window: list[SeenPoints], image_size: ImageSize) -> FocalFit | None:
    """The focal length by one window; None with few points, or where the camera turns too little for it."""
    xy_px = _observed(window, image_size)
    # What is seen often enough and does not stay on its pixel.
    often = np.isfinite(xy_px[..., 0]).sum(axis=0) >= _LEAST_VIEWS
    moved_px = np.max(np.nanmax(xy_px, axis=0) - np.nanmin(xy_px, axis=0), axis=1)
    xy_px = xy_px[:, often & (moved_px > _STAYS_PX)]
    xy_px = xy_px[:, _spread(xy_px, image_size)]
    cells, region = np.unique(_cell(xy_px, image_size), return_inverse=True)
    if xy_px.shape[1] < _LEAST_POINTS or len(cells) < _LEAST_CELLS:
        return None
    point, frame = map(np.ascontiguousarray, np.nonzero(np.isfinite(xy_px[..., 0]).T))
    views = Views(xy_px[frame, point], frame, point, region)
    width_px = float(image_size.width_px)
    least_turn_rad = _common_sigma(image_size, 1.0) / _HOPELESS
    return fit_focal_length(views, np.array([frame.t_s for frame in window]), width_px, least_turn_rad)


def _observed(window: list[SeenPoints], image_size: ImageSize) -> Floats:
    """Places from the centre of the picture, px: (J, N, 2), NaN where a point is not seen."""
    track_id = np.unique(np.concatenate([frame.points.track_id for frame in window]))
    xy_px = np.full((len(window), len(track_id), 2), np.nan)
    centre = np.array([image_size.width_px - 1.0, image_size.height_px - 1.0]) / 2.0
    for j, frame in enumerate(window):
        xy_px[j, np.searchsorted(track_id, frame.points.track_id)] = frame.points.xy_px - centre
    return xy_px


def _cell(xy_px: Floats, image_size: ImageSize) -> Ints:
    """Number of the cell of a grid over the picture in which each point (N,) is on the mean."""
    cell = np.floor(np.nanmean(xy_px, axis=0) / (_CELL_PART * image_size.width_px)).astype(np.int64)
    return np.asarray(cell[:, 0] * 4096 + cell[:, 1])


def _spread(xy_px: Floats, image_size: ImageSize) -> Ints:
    """Points all over the picture, from each cell those that are seen longest: as many as are to be used."""
    cell = _cell(xy_px, image_size)
    n_views = np.isfinite(xy_px[..., 0]).sum(axis=0)
    first = np.nanmin(xy_px, axis=0)
    order = np.lexsort((first[:, 1], first[:, 0], -n_views, cell))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - np.searchsorted(cell[order], cell[order])
    return np.sort(np.argsort(rank, kind="stable")[:_MOST_POINTS])


def _together(fits: list[FocalFit], image_size: ImageSize) -> FocalLength | None:
    """The weighted mean of the windows, less sure where they disagree; None where it is not sure enough."""
    if not fits:
        return None
    log_focal = np.array([fit.log_focal for fit in fits])
    common = np.array([_common_sigma(image_size, fit.turned_rad) for fit in fits])
    precision = 1.0 / (np.array([fit.sigma for fit in fits]) ** 2 + common**2 + _LEAST_SIGMA**2)
    mean = float(np.sum(precision * log_focal) / np.sum(precision))
    disagreement = float(np.sum(precision * (log_focal - mean) ** 2)) / max(1, len(fits) - 1)
    sigma = float(np.sqrt(max(1.0, disagreement) / np.sum(precision)))
    is_sure = sigma < _SURE
    if len(fits) == 1:
        is_sure = sigma < _SURE_ALONE and fits[0].lens_chi2 < _MOST_LENS_CHI2_ALONE
    return FocalLength(float(np.exp(mean)), sigma) if is_sure else None


def _common_sigma(image_size: ImageSize, turned_rad: float) -> float:
    """Relative error of the focal length by errors common to all points, for a camera that turns by ``turned_rad``.

    A focal length that is off by the part e displaces a point at x by 2 e turned x^2 / f once the rotation has been
    adapted; at x = width / 4 and f = width that is e turned width / 8.
    """
    return 8.0 * _COMMON_ERROR_PX / (image_size.width_px * turned_rad)
