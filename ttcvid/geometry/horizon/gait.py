"""The steps of a pedestrian from the height of the head, which goes up and down once per step."""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from ttcvid.model import Floats

# Steps a second of people who walk: 1.8 to 2.0 on average (800 measurements of Pachi and Ji, The Structural Engineer
# 83(3), 2005), with a margin to either side for those who stroll and those who hurry.
_SLOWEST_HZ, _FASTEST_HZ = 1.2, 2.6
# Frequencies are tried so close that a whole window of them is off by a sixteenth of a wave at its ends.
_STEP_OF_WINDOW = 0.125
# Steps are believed where independent scatter would make as much of a wave in this part of the outlines. Scatter that
# hangs together over 0.1 s makes one in 1 % of them, over half a second in 7 %.
_CHANCE = 0.001
# The wave is compared with others at these frequencies: slower ones are the way's, faster ones the border's.
_BACKGROUND_HZ = (0.8, 4.0)
_LEAST_OTHERS = 3
# At least so many steps have to be seen, and so many pictures of the fastest wave.
_LEAST_STEPS, _LEAST_PICTURES = 2.5, 2.0


def find_steps(height: Floats, t_s: Floats, size: Floats, weight: Floats) -> Floats | None:
    """Sine and cosine ``(N, 2)`` of steps, in which the height of a head is linear; None where none are significant.

    An F test of the best frequency against the other frequencies around it, so that scatter that is correlated from
    picture to picture causes few false detections; corrected for the number of frequencies that the duration resolves.

    Parameters
    ----------
    height : ``(N,)`` height of the head, its trend removed.
    t_s : ``(N,)`` ascending times.
    size : ``(N,)`` height of the whole figure, in the same unit: the amplitude is proportional to it.
    weight : ``(N,)`` 0 to 1, small for outliers.
    """
    window_s = float(np.ptp(t_s))
    if window_s <= 0 or float(np.median(np.diff(t_s))) * _BACKGROUND_HZ[1] * _LEAST_PICTURES > 1.0:
        return None
    count = max(2, int(np.ceil((_FASTEST_HZ - _SLOWEST_HZ) * window_s / _STEP_OF_WINDOW)))
    tried_hz = np.linspace(_SLOWEST_HZ, _FASTEST_HZ, count)
    root = np.sqrt(weight)
    level = root[:, None] * np.column_stack([np.ones_like(t_s), (t_s - t_s.mean()) / window_s])
    left = [_left(np.column_stack([level, root[:, None] * _terms(hz, t_s, size)]), root * height) for hz in tried_hz]
    best = int(np.argmin([np.sum(one**2) for one in left]))
    steps_hz = float(tried_hz[best])
    others_hz = np.arange(np.ceil(_BACKGROUND_HZ[0] * window_s), _BACKGROUND_HZ[1] * window_s) / window_s
    others_hz = others_hz[np.abs(others_hz - steps_hz) * window_s >= 1.0]
    if steps_hz * window_s < _LEAST_STEPS or len(others_hz) < _LEAST_OTHERS:
        return None
    unexplained = float(np.sum(left[best] ** 2))
    of_wave = float(np.sum(_left(level, root * height) ** 2)) - unexplained
    by_others = [_left(root[:, None] * _terms(hz, t_s, size), left[best]) for hz in others_hz]
    of_others = unexplained - float(np.mean([np.sum(one**2) for one in by_others]))
    n_told_apart = max(1.0, (_FASTEST_HZ - _SLOWEST_HZ) * window_s)
    chance = float(fdtrc(2, 2 * len(others_hz), of_wave / of_others)) if of_others > 0.0 else 0.0
    return _terms(steps_hz, t_s, size) if chance * n_told_apart < _CHANCE and of_wave > 0.0 else None


def _terms(steps_hz: float, t_s: Floats, size: Floats) -> Floats:
    phase = 2.0 * np.pi * steps_hz * t_s
    return np.column_stack([np.cos(phase), np.sin(phase)]) * size[:, None]


def _left(terms: Floats, height: Floats) -> Floats:
    """What the best combination of the terms leaves."""
    return np.asarray(height - terms @ np.linalg.lstsq(terms, height, rcond=None)[0])
