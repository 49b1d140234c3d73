"""What belongs to a thing that would lie under the road, above its part that shows that.

A car ahead that keeps its distance looks infinitely far away. Below the horizon that would be under the road; its
windows and its roof, at the horizon and above, could as well be clouds. But they stand above the rest, at its depth,
and end where it ends: what goes on to the sides is background that happens to be as far away as the car appears to be.
"""

from __future__ import annotations

import numpy as np

from ttcvid.geometry.estimation.rigid_motion import PathFit
from ttcvid.model import Bools, Floats, Ints
from ttcvid.stages.tracking.neighbours import linked_parts

# Points of a thing hang together within this part of their rates, and of the standard deviations of these.
_ONE_THING, _SIGMAS = 0.12, 2.0
# So many points under the road are a thing. Of its points before the road so few may lie on or over it: what stands on
# the road has as many of them as are seen.
_LEAST_UNDER, _MOST_OVER = 3, 0.25
# A thing stands above its foot: its upper part reaches farther to the side by this part of its width at the most, as
# mirrors do. Where more than the part above goes on beyond, it is background.
_OVERHANG, _MOST_BESIDE = 0.1, 0.25


def above_under(
    xy_px: Floats, link_px: float, fit: PathFit, key: Ints, is_under: Bools, road_hz: Floats, most_sigma_hz: float
) -> Bools:
    """Points (N,) of things that would lie under the road, where the road is not seen behind them.

    Parameters
    ----------
    xy_px : (N, 2) where tracks are seen; points of a thing are nearer to each other than ``link_px``.
    fit : of the tracks on the path of the scene.
    key : (N,) body of each track by now.
    is_under, road_hz : (N,) tracks that would lie under the road, and its rate where each is seen, NaN where none is.
    most_sigma_hz : rates that are less well known, 1/s, say nothing.
    """
    found = np.zeros(len(key), dtype=bool)
    if np.count_nonzero(is_under) < _LEAST_UNDER:
        return found
    index = np.flatnonzero(fit.rate_sigma_hz < most_sigma_hz)
    rate_hz = fit.rate_hz[index]
    tolerance = 0.5 * (_ONE_THING * rate_hz + _SIGMAS * fit.rate_sigma_hz[index])
    label = linked_parts(xy_px[index], link_px, key[index], rate_hz, tolerance)
    has_road = np.isfinite(road_hz[index])
    under = np.bincount(label, is_under[index], label.max(initial=-1) + 1)
    over = np.bincount(label, has_road & ~is_under[index], len(under))
    x = xy_px[index, 0]
    for number in np.flatnonzero((under >= _LEAST_UNDER) & (over <= _MOST_OVER * under)):
        is_thing = label == number
        foot = x[is_thing & is_under[index]]
        aside_px = _OVERHANG * np.ptp(foot)
        is_high, is_over = is_thing & ~has_road, (x >= foot.min() - aside_px) & (x <= foot.max() + aside_px)
        above, beside = is_high & is_over, is_high & ~is_over
        if np.count_nonzero(beside) <= _MOST_BESIDE * np.count_nonzero(above):
            found[index[above]] = True
    return found
