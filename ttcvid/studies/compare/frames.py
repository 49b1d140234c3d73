"""Which frames of two results are the same ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from ttcvid.model import Ints
from ttcvid.studies.compare.pictures import join_by_picture, times_fit
from ttcvid.studies.compare.tolerance import FrameTolerance
from ttcvid.studies.compare.tracks import Placed


@dataclass(frozen=True)
class JoinedFrames:
    """Frames that are the same in both results, and those that have no counterpart.

    ``baseline`` and ``run`` (N,) are frame numbers, ascending, one beside the other; ``missing`` is in the baseline
    only, ``additional`` in the run only. ``is_by_picture`` says that the times of the frames did not tell.
    """

    baseline: Ints
    run: Ints
    missing: Ints
    additional: Ints
    is_by_picture: bool = False

    def of(self, frames: Ints) -> JoinedFrames:
        """The joined pairs of some frames of the baseline."""
        is_meant = np.isin(self.baseline, frames)
        return replace(self, baseline=self.baseline[is_meant], run=self.run[is_meant])


def join_frames(
    baseline: pd.DataFrame, run: pd.DataFrame, placed: tuple[Placed, Placed], tolerance: FrameTolerance
) -> JoinedFrames:
    """Join the frames of two results by time, or where their tracks say otherwise, by what the pictures show.

    A clip that was encoded again without one of its frames has the same times as before, but one picture less: from
    there on every picture is early, which only its content tells.

    Parameters
    ----------
    baseline, run : ``frame`` and ``t_s`` of all frames.
    placed : Where the tracks of the baseline and of the run are, by frame; for the baseline, some frames are enough.
    """
    frames = baseline.frame.to_numpy(), run.frame.to_numpy()
    first, second = _by_time(baseline, run, tolerance)
    by_picture = None if times_fit(first, second, frames, placed) else join_by_picture(first, second, frames, placed)
    if by_picture is not None:
        first, second = by_picture
    missing, additional = np.setdiff1d(frames[0], first), np.setdiff1d(frames[1], second)
    return JoinedFrames(first, second, missing, additional, by_picture is not None)


def _by_time(baseline: pd.DataFrame, run: pd.DataFrame, tolerance: FrameTolerance) -> tuple[Ints, Ints]:
    before, now = baseline.t_s.to_numpy(float), run.t_s.to_numpy(float)
    if len(before) == 0 or len(now) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    longer = now if len(now) >= len(before) else before
    step_s = float(np.median(np.diff(longer))) if len(longer) > 1 else np.inf
    right = np.clip(np.searchsorted(now, before), 1, max(len(now) - 1, 1))
    nearest = np.where(np.abs(now[right - 1] - before) <= np.abs(now[right % len(now)] - before), right - 1, right)
    nearest %= len(now)
    is_same = np.abs(now[nearest] - before) <= tolerance.max_dt * step_s
    # Two frames at one time (duplicated packets) have one partner between them: the first.
    _, once = np.unique(nearest[is_same], return_index=True)
    rows = np.flatnonzero(is_same)[once]
    return baseline.frame.to_numpy()[rows], run.frame.to_numpy()[nearest[rows]]
