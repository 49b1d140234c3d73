"""Errors of directions of motion and of rotations, as angles."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ttcvid.geometry.rotation import rotation_from_vector, vector_from_rotation
from ttcvid.model import Bools, Floats, Ints
from ttcvid.studies.evaluation.times import Numbers, quantile
from ttcvid.studies.evaluation.truth import DIRECTION, ROTATION, VELOCITY, columns_of


def angle_deg(first: Floats, second: Floats) -> Floats:
    """Angles ``(N,)`` between unit vectors ``(N, 3)`` in [0, 180]; exact for small ones. NaN where one is NaN.

    >>> angle_deg(np.array([[1.0, 0, 0]]), np.array([[0, 0, 1.0]])).tolist()
    [90.0]
    """
    apart, along = np.linalg.norm(first - second, axis=-1), np.linalg.norm(first + second, axis=-1)
    return np.asarray(np.degrees(2.0 * np.arctan2(apart, along)))


def judge_directions(truth: Floats, found: Floats, is_counted: Bools) -> Numbers:
    """Angles between true and found directions ``(N, 3)``; NaN where nothing was found or nothing is true."""
    is_counted = is_counted & np.isfinite(truth).all(axis=1)
    return summary_of(angle_deg(truth[is_counted], found[is_counted]))


def rotation_errors_deg(truth: pd.DataFrame, found: pd.DataFrame) -> pd.DataFrame:
    """Angle between true and found rotation since the previous analysed frame: ``frame, rotation_deg``, NaN: not found.

    ``truth`` has a row for every picture; where the run left some out, their rotations are taken together, and where
    the truth does, nothing is judged. ``found`` has a row per analysed frame, ascending; the first of them has no
    rotation to judge.
    """
    per_picture = rotation_from_vector(np.nan_to_num(columns_of(truth, ROTATION)))
    frames, first, end = _pictures_between(truth, found.frame.to_numpy())
    if not len(frames):
        return pd.DataFrame({"frame": frames, "rotation_deg": np.empty(0)})
    true = np.stack([_product(per_picture[a:b]) for a, b in zip(first, end, strict=True)])
    estimate = rotation_from_vector(columns_of(found, ROTATION)[np.searchsorted(found.frame, frames)])
    left_over = estimate @ np.swapaxes(true, 1, 2)
    is_known = np.isfinite(left_over).all(axis=(1, 2))
    error = np.full(len(left_over), np.nan)
    error[is_known] = np.degrees(np.linalg.norm(vector_from_rotation(left_over[is_known]), axis=1))
    return pd.DataFrame({"frame": frames, "rotation_deg": error})


def true_scene_directions(truth: pd.DataFrame, frames: Ints) -> pd.DataFrame:
    """Direction of the static scene since the previous analysed frame: ``frame`` and ``DIRECTION``, NaN at rest.

    ``truth`` has a row for every picture, with the direction since the picture before; where the run left some out,
    their ways are taken together in the camera of the last one. Without the own velocity, speed counts as constant.
    ``frames (N,)`` are the analysed ones, ascending; the first of them is left out, as are those to which the truth
    does not know the whole way.
    """
    analysed, first, end = _pictures_between(truth, frames)
    per_picture = rotation_from_vector(np.nan_to_num(columns_of(truth, ROTATION)))
    has_speed = set(VELOCITY) <= set(truth)
    velocity = -columns_of(truth, VELOCITY) if has_speed else columns_of(truth, DIRECTION)
    # A row without one before it, or after a gap, is as long as pictures are.
    step_s = np.diff(truth.t_s) / np.diff(truth.frame)
    way = np.nan_to_num(velocity) * np.concatenate([step_s[:1] if len(step_s) else [1.0], step_s])[: len(truth), None]
    true = np.full((len(analysed), 3), np.nan)
    for i, (a, b) in enumerate(zip(first, end, strict=True)):
        total = np.zeros(3)
        for picture in range(a, b):
            total = per_picture[picture] @ total + way[picture]
        if total.any():
            true[i] = total / np.linalg.norm(total)
    return pd.DataFrame(true, columns=DIRECTION).assign(frame=analysed)


def summary_of(error: Floats) -> Numbers:
    """Median, p90 and share with a value of errors ``(N,)``, NaN where there is none."""
    has_value = np.isfinite(error)
    return {
        "n": float(has_value.sum()),
        "share": float(has_value.mean()) if len(error) else float("nan"),
        "median": quantile(error[has_value], 0.5),
        "p90": quantile(error[has_value], 0.9),
    }


def _pictures_between(truth: pd.DataFrame, frames: Ints) -> tuple[Ints, Ints, Ints]:
    """Frames of a run to which ``truth`` has all pictures after the one before, ascending: (M,), and where these stand.

    The pictures of frame m are its rows ``first[m] : end[m]``.
    """
    rows = np.searchsorted(truth.frame.to_numpy(), frames, side="right")
    first, end = rows[:-1], rows[1:]
    is_known = end - first == np.diff(frames)
    return frames[1:][is_known], first[is_known], end[is_known]


def _product(rotations: Floats) -> Floats:
    """Rotations ``(M, 3, 3)`` one after the other, the first one first."""
    total = np.eye(3)
    for rotation in rotations:
        total = rotation @ total
    return total
