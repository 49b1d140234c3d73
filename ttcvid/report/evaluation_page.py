"""An evaluation as one HTML page: all metrics, and for each object true and estimated 1/time over the clip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ttcvid.model import Floats
from ttcvid.report.pages import render, script
from ttcvid.report.series import plain

MAX_ETA_HZ = 2.0
"""Curves are cut off at 1/time of 2/s: half a second before contact."""
_LEAST_TOP_HZ, _HEADROOM = 0.1, 1.2


@dataclass(frozen=True)
class Metric:
    """A figure as text, and what it means."""

    name: str
    value: str
    meaning: str


@dataclass(frozen=True)
class Curve:
    """1 / ttc_z of one object over the clip, in 1/s: the truth, and the estimates with their 90 % intervals.

    All are ``(N,)``; NaN where there is no value.
    """

    heading: str
    t_s: Floats
    true_hz: Floats
    found_hz: Floats
    low_hz: Floats
    high_hz: Floats


def evaluation_page(title: str, metrics: Sequence[Metric], curves: Sequence[Curve], report: str | None = None) -> str:
    """The page as text; it refers to nothing outside itself but the run's ``report``, an address."""
    return render(
        "evaluation.html.j2",
        {"curves": [_series(curve) for curve in curves]},
        title=title,
        metrics=metrics,
        curves=[{"heading": curve.heading, "is_shown": _limits(curve) is not None} for curve in curves],
        report=report,
        max_eta_hz=f"{MAX_ETA_HZ:g}",
        scripts=[script("plots.js"), script("evaluation.js")],
    )


def _series(curve: Curve) -> dict[str, Any]:
    """The numbers of a curve, as they are plotted."""
    order = np.argsort(curve.t_s, kind="stable")
    names = ("t_s", "true_hz", "found_hz", "low_hz", "high_hz")
    numbers: dict[str, Any] = {name: plain(getattr(curve, name)[order]) for name in names}
    return {**numbers, "range": _limits(curve)}


def _limits(curve: Curve) -> list[float] | None:
    """The least and the largest 1/time that a plot shows; None where there is nothing to show."""
    shown = np.concatenate([curve.true_hz, curve.found_hz])
    shown = shown[np.isfinite(shown)]
    if len(shown) == 0:
        return None
    low, high = min(0.0, shown.min()), max(_LEAST_TOP_HZ, _HEADROOM * shown.max())
    return [float(np.clip(end, -MAX_ETA_HZ, MAX_ETA_HZ)) for end in (low, high)]
