"""Own motion of a clip by plain means, to tell an error of ours from one of the truth.

Nothing of ttcvid is used: OpenCV's corners and Lucas-Kanade from frame to frame, SciPy's least squares on the
epipolar constraint with five free parameters, no prior. Where it errs as ttcvid does, on the same side, the truth
or the camera's calibration is what is off.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

_BACK_AND_FORTH_PX = 0.5
_LOSS_PX = 0.3  # a residual beyond is taken for something else than noise


def plain_epipoles_px(images: list[Path], focal_px: float, centre_px: np.ndarray, gap: int) -> np.ndarray:
    """Epipoles of the motions from frame i to i + gap, in the picture of i + gap; i = 0, gap, 2 gap...: (M, 2) px."""
    pictures = [cv2.imread(str(image), cv2.IMREAD_GRAYSCALE) for image in images]
    starts = range(0, len(pictures) - gap, gap)
    return np.array([_epipole_px(pictures[start : start + gap + 1], focal_px, centre_px) for start in starts])


def _epipole_px(pictures: list[np.ndarray], focal_px: float, centre_px: np.ndarray) -> np.ndarray:
    first, last = _followed(pictures)
    one = np.column_stack([(first - centre_px) / focal_px, np.ones(len(first))])
    two = np.column_stack([(last - centre_px) / focal_px, np.ones(len(last))])

    def residuals_px(parameters: np.ndarray) -> np.ndarray:
        """Sampson distance for a rotation vector and the epipole (x, y) / f."""
        rotation = Rotation.from_rotvec(parameters[:3]).as_matrix()
        x, y = parameters[3:]
        essential = np.array([[0.0, -1.0, y], [1.0, 0.0, -x], [-y, x, 0.0]]) @ rotation
        line_two, line_one = one @ essential.T, two @ essential
        gradient = np.sqrt((line_two[:, :2] ** 2).sum(1) + (line_one[:, :2] ** 2).sum(1))
        return np.asarray(focal_px * (two * line_two).sum(1) / gradient)

    found = least_squares(residuals_px, np.zeros(5), loss="cauchy", f_scale=_LOSS_PX).x
    return np.asarray(centre_px + focal_px * found[3:])


def _followed(pictures: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the first picture and where they are in the last, those alone that are found back in every step."""
    window = {"winSize": (15, 15), "maxLevel": 4}
    first = cv2.goodFeaturesToTrack(pictures[0], 1500, 0.005, 8).reshape(-1, 2)
    place, is_kept = first.copy(), np.ones(len(first), bool)
    for one, two in pairwise(pictures):
        moved, is_found, _ = cv2.calcOpticalFlowPyrLK(one, two, place, None, **window)
        back, is_back, _ = cv2.calcOpticalFlowPyrLK(two, one, moved, None, **window)
        is_kept &= (is_found[:, 0] > 0) & (is_back[:, 0] > 0)
        is_kept &= np.hypot(*(back - place).T) < _BACK_AND_FORTH_PX
        place = moved
    return first[is_kept].astype(float), place[is_kept].astype(float)
