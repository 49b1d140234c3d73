"""Corners, well spread over the picture."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ttcvid.model import Bools, Floats, Ints, Picture

# Side of the gradient window of the corner response, px.
_BLOCK_PX = 3
# Least smaller eigenvalue of the gradient matrix (in cv2.cornerMinEigenVal's units, grey levels scaled to
# 0..1): below it a "corner" is sensor noise of a plain surface.
_MIN_RESPONSE = 2e-5


def occupied_cells(xy_px: Floats, shape: tuple[int, int], cell_px: float) -> Bools:
    """Grid cells of side ``cell_px`` that hold a point or touch the cell of one.

    Parameters
    ----------
    xy_px : (N, 2) points inside the picture, px.
    shape : rows and columns of the picture.
    """
    rows, columns = int(shape[0] / cell_px) + 1, int(shape[1] / cell_px) + 1
    cells = np.zeros((rows, columns), dtype=np.uint8)
    if len(xy_px):
        row = np.clip(xy_px[:, 1] / cell_px, 0, rows - 1).astype(np.intp)
        column = np.clip(xy_px[:, 0] / cell_px, 0, columns - 1).astype(np.intp)
        cells[row, column] = 1
    return np.asarray(cv2.dilate(cells, np.ones((3, 3), np.uint8)) > 0)


def find_corners(
    grey: Picture,
    allowed: Picture | None,
    xy_taken_px: Floats,
    n_wanted: int,
    min_distance_px: float,
    quality: float,
) -> Floats:
    """Strongest corners that keep their distance from each other and from the points already there.

    Each cell of a grid of side ``min_distance_px`` gives at most its strongest corner, and none where a point
    stands in it or next to it; so plain regions get the few corners they have instead of a tree getting all.

    Parameters
    ----------
    grey : (H, W) uint8.
    allowed : (H, W) uint8, 0 where nothing is to be looked at, or None.
    xy_taken_px : (N, 2) points already there, px.
    n_wanted : most corners to return.
    min_distance_px : grid cell, px.
    quality : least response relative to the 99.9th percentile of the picture.

    Returns
    -------
    (M, 2) float64 corners, px, strongest first, M <= n_wanted.
    """
    if n_wanted <= 0:
        return np.empty((0, 2))
    response = cv2.cornerMinEigenVal(grey, _BLOCK_PX)
    # A stride of 4 in both axes leaves the percentile as it is and takes a sixteenth of the time.
    threshold = max(_MIN_RESPONSE, quality * float(np.percentile(response[::4, ::4], 99.9)))
    is_peak = (response >= cv2.dilate(response, np.ones((3, 3), np.uint8))) & (response > threshold)
    margin = _BLOCK_PX + 1
    is_peak[:margin] = is_peak[-margin:] = False
    is_peak[:, :margin] = is_peak[:, -margin:] = False
    if allowed is not None:
        is_peak &= allowed > 0
    # As fast as np.nonzero of two axes is slow.
    y, x = np.divmod(np.flatnonzero(is_peak), grey.shape[1])
    taken = occupied_cells(xy_taken_px, (grey.shape[0], grey.shape[1]), min_distance_px)
    row, column = (y / min_distance_px).astype(np.intp), (x / min_distance_px).astype(np.intp)
    is_free = ~taken[row, column]
    x, y, cell = x[is_free], y[is_free], (row * taken.shape[1] + column)[is_free]
    order = np.argsort(-response[y, x], kind="stable")
    _, strongest = np.unique(cell[order], return_index=True)
    chosen = order[np.sort(strongest)]
    xy = _refined(response, x[chosen], y[chosen])
    return xy[_keeps_distance(xy, min_distance_px)][:n_wanted]


def _keeps_distance(xy: Floats, min_distance_px: float) -> Bools:
    """Points (M,), strongest first, without a stronger one closer than ``min_distance_px``."""
    keeps = np.ones(len(xy), dtype=bool)
    if len(xy):
        pairs = KDTree(xy).query_pairs(min_distance_px, output_type="ndarray")
        keeps[pairs.max(axis=1)] = False
    return keeps


def _refined(response: NDArray[Any], x: Ints, y: Ints) -> Floats:
    """Peaks (M,) to sub-pixel by a parabola through the response along each axis: (M, 2) px."""
    here = response[y, x].astype(np.float64)
    xy = np.stack([x, y], axis=1).astype(np.float64)
    for axis, (dy, dx) in enumerate(((0, 1), (1, 0))):
        before, after = response[y - dy, x - dx], response[y + dy, x + dx]
        curvature = 2.0 * here - before - after
        offset = np.divide(0.5 * (after - before), curvature, out=np.zeros_like(here), where=curvature > 1e-12)
        xy[:, axis] += np.clip(offset, -0.5, 0.5)
    return xy
