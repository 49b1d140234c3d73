"""The curves of a sensitivity study: errors of direction and of time, a colour for each method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from ttcvid.model import Floats
from ttcvid.studies.sensitivity.study import Point

# Okabe and Ito's colours: told apart with any colour vision.
_COLOURS = ("#d55e00", "#e69f00", "#56b4e9", "#0072b2", "#004c78", "#009e73", "#cc79a7")
_STEREO = "#555555"
_RANGE_PERCENT = (0.03, 1000.0)
_RANGE_DEG = (0.003, 90.0)


def sensitivity_figure(points: Sequence[Point], label: str, is_geometric: bool, within: float, title: str) -> Figure:
    """Two panels over what is varied: lines by closed form, dots by Monte-Carlo, crosses the Cramer-Rao bound."""
    figure = Figure(figsize=(12.5, 6.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    keys = list(dict.fromkeys((point.method.name, point.method.n_frames) for point in points))
    for k, key in enumerate(keys):
        own = [point for point in points if (point.method.name, point.method.n_frames) == key]
        colour = _STEREO if key[0] == "stereo" else _COLOURS[k % len(_COLOURS)]
        _curve(left, own, "direction_rad", float(np.degrees(1.0)), colour)
        _curve(right, own, "ttc_z", 100.0, colour)
    _finish(left, "error of the direction of motion, deg", label, is_geometric, _RANGE_DEG)
    _finish(right, "error of the time to collision, %", label, is_geometric, _RANGE_PERCENT)
    right.axhline(100 * within, color="black", lw=1, ls="--")
    right.text(0.01, 110 * within, f"{100 * within:g} %", transform=right.get_yaxis_transform(), fontsize=9)
    handles = left.get_legend_handles_labels()[0] + [
        Line2D([], [], color="black", lw=1.8, label="closed form"),
        Line2D([], [], color="black", marker="x", ls="", ms=6, label="Cramér-Rao bound"),
        Line2D([], [], color="black", marker="o", ls="", ms=4, label="Monte-Carlo of the real functions"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False, fontsize=9.5)
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    return figure


def _curve(axes: Axes, points: Sequence[Point], quantity: str, unit: float, colour: str) -> None:
    values = np.array([point.value for point in points])

    def errors(way: str) -> Floats:
        found = np.array([getattr(getattr(point, way), quantity) for point in points]) * unit
        return np.where(np.isfinite(found), found, np.nan)

    width = 2.6 if points[0].method.name == "stereo" else 1.8
    style = "-." if points[0].method.name == "stereo" else "-"
    axes.plot(values, errors("formula"), color=colour, lw=width, ls=style, label=points[0].method.label)
    axes.plot(values, errors("bound"), "x", color=colour, ms=6, mew=1.0)
    axes.plot(values, errors("trials"), "o", color=colour, ms=4)


def _finish(axes: Axes, what: str, label: str, is_geometric: bool, limits: tuple[float, float]) -> None:
    axes.set(xlabel=label, ylabel=what, yscale="log", ylim=limits)
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_major_formatter(plain)
    if is_geometric:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(plain)
        axes.xaxis.set_minor_formatter(
            FuncFormatter(lambda value, _: f"{value:g}" if _leading(value) in (2, 5) else "")
        )
    axes.grid(True, which="major", color="#dddddd")
    axes.grid(True, which="minor", color="#f0f0f0")


def _leading(value: float) -> int:
    return round(value / 10 ** np.floor(np.log10(value))) if value > 0 else 0
