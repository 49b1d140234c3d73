"""The noise of tracks, estimated from how well the scene fits and from how rough their paths are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttcvid.geometry.medians import median
from ttcvid.geometry.rotation import turned_into_plane
from ttcvid.model import Bools, Floats
from ttcvid.stages.tracking.history import TrackHistory

# Number of observations in a third difference; fewer tracks than that say nothing of what is typical.
_DIFFERENCE_FRAMES, _LEAST_MEASURED = 4, 4
# A track's noise is a mean over about 1 / (1 - 0.9) = 10 frames of its own, drawn towards the noise of all
# tracks with the weight of 4 of them.
_FORGETTING, _PRIOR_WEIGHT = 0.9, 4.0
# The noise of all tracks follows its new measurements with this weight a frame.
_POOL_GAIN = 0.2
# Squared third difference of independent noise, two components, over its variance.
_PX2_PER_VARIANCE = 40.0
# Time steps that differ by more than this part make a third difference meaningless.
_EVEN_STEPS = 0.1
# Median of a chi-square variable with two degrees of freedom, divided by two.
_MEDIAN_CHI2_2 = 0.6931


def with_noise(
    history: TrackHistory, residual_spread: float | None, sigma_floor_px: float, is_slow: bool = False
) -> TrackHistory:
    """Update the noise of all tracks from the scene's residuals, and of each from the roughness of its path.

    The level comes from how well the scene fits (``residual_spread``, the robust standard deviation of its residuals in
    units of the noise assumed so far; None where there is none). How much noisier one track is than the others
    comes from the third difference of its derotated path: a constant relative velocity leaves none worth mentioning
    (6 rho / k^3 per frame^3, rho px from the epipole and k frames before the collision), independent noise leaves 20
    times its variance, two components make two degrees of freedom a frame. (The third difference alone would put the
    level too low: the errors of Lucas-Kanade follow the picture's texture and change slowly from frame to frame.)
    Where a step is short, ``is_slow``, its fit may follow the noise of what shows no translation at all, the blobs of a
    plain sky: there the level is not less than what the paths are rough by, to which so short a flow adds nothing if it
    is steady. (What trembles looks noisier than it is: 5 mm at 8 Hz, 3 to 40 m before a lens, 0.38 px, not 0.33.)

    Call after `ttcvid.stages.tracking.history.with_egomotion`.
    """
    pool = history.pool_sigma_px
    fresh, is_measured, typical_px2 = _relative_roughness(history, sigma_floor_px)
    if residual_spread is not None:
        rough = np.sqrt(typical_px2 / _PX2_PER_VARIANCE) / pool if is_slow else 0.0
        pool = max(sigma_floor_px, pool * max(residual_spread, rough) ** _POOL_GAIN)
    noise_sum = _FORGETTING * history.noise_sum + 2.0 * fresh
    noise_weight = _FORGETTING * history.noise_weight + 2.0 * is_measured
    relative_variance = (_PRIOR_WEIGHT + noise_sum) / (_PRIOR_WEIGHT + noise_weight)
    return replace(
        history,
        sigma_px=np.maximum(pool * np.sqrt(relative_variance), sigma_floor_px),
        noise_sum=noise_sum,
        noise_weight=noise_weight,
        pool_sigma_px=pool,
    )


def _relative_roughness(history: TrackHistory, sigma_floor_px: float) -> tuple[Floats, Bools, float]:
    """Squared third difference of each track over its peers', 0 where unknown; where it is known; the typical, px^2.

    Peers are at least as rough as the least noise that a tracker has makes them. A background without noise (rendered,
    denoised, blocks that a codec skips) would make whatever moves look noisy.
    """
    nothing = np.zeros(history.n_tracks), np.zeros(history.n_tracks, dtype=bool), 0.0
    if len(history.frame) < _DIFFERENCE_FRAMES:
        return nothing
    steps_s = np.diff(history.t_s[-_DIFFERENCE_FRAMES:]).tolist()
    if max(steps_s) - min(steps_s) > _EVEN_STEPS * abs(sum(steps_s) / len(steps_s)):
        return nothing
    recent = slice(-_DIFFERENCE_FRAMES, None)
    plane = turned_into_plane(history.rays[recent], history.cam_R_seen[recent])
    third = np.diff(plane, n=_DIFFERENCE_FRAMES - 1, axis=0)[0] / history.plane_per_px[:, None]
    roughness = np.einsum("ni,ni->n", third, third)
    is_measured = np.isfinite(roughness)
    if np.count_nonzero(is_measured) < _LEAST_MEASURED:
        return nothing
    typical = median(roughness[is_measured]) / _MEDIAN_CHI2_2
    peers = max(typical, _PX2_PER_VARIANCE * sigma_floor_px * sigma_floor_px)
    return np.where(is_measured, roughness, 0.0) / peers, is_measured, typical
