"""The picture of a collision map, to be read at once: colour is time, hatching a likely collision, a dot for now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy import ndimage

from ttcvid.model import Bools, Floats
from ttcvid.studies.collision_map.contacts import POSSIBLE
from ttcvid.studies.collision_map.evasion import Evasion, EvasionStatus
from ttcvid.studies.collision_map.velocity_map import LIKELY, CollisionMap

KM_H = 3.6
_FREE = "#e9f1ee"
_TIMES: Colormap = LinearSegmentedColormap.from_list("times", ["#7a0010", "#d7301f", "#fc8d59", "#fdd49e", "#fff3d6"])
"""From now (dark red) to the end of the look-ahead (pale)."""
_PALE = 0.45
"""Share of a time's colour that is left where a collision is possible but not likely."""
_UNKNOWN = "#bdbdbd"
_ADVICE, _INK, _FAMILY = "#0b5fa5", "#1a1a1a", "#5b3a8c"
_MAX_NAMES = 7
_MIN_NAMED_CELLS = 12
_NAME_SHARE = 0.1
"""A name reaches this share of the map's width to either side of its middle."""
_HALO: list[patheffects.AbstractPathEffect] = [patheffects.withStroke(linewidth=3, foreground="white")]


@dataclass(frozen=True)
class MapCaption:
    """What the picture says in words: a title, and lines of notes under the map."""

    title: str
    notes: Sequence[str] = ()


def collision_map_figure(
    collision_map: CollisionMap,
    advice: Evasion,
    own_speed_m_s: float,
    units: str,
    caption: MapCaption,
    families: Sequence[tuple[str, Floats]] = (),
) -> Figure:
    """The picture of one map.

    Parameters
    ----------
    units : ``"km/h"``, or ``"own-speed"``: parts of own speed in percent.
    families : Objects of unknown speed: name, and the probability ``(K, F, R)`` of hitting each if it had one of K
        speeds.
    """
    scale = KM_H if units == "km/h" else 100.0 / own_speed_m_s
    label = "km/h" if units == "km/h" else "% of own speed"
    figure = Figure(figsize=(8.6, 7.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.add_gridspec(2, 1, height_ratios=[1.0, 0.045 + 0.03 * len(caption.notes)])
    axes, foot = figure.add_subplot(rows[0]), figure.add_subplot(rows[1])
    right, forward = collision_map.right_m_s * scale, collision_map.forward_m_s * scale
    extent = (*_edges(right), *_edges(forward))
    axes.imshow(_colours(collision_map), origin="lower", extent=extent, aspect="auto", interpolation="nearest")
    _hatch(axes, right, forward, collision_map.probability >= LIKELY)
    _draw_families(axes, right, forward, families)
    _name_objects(axes, collision_map, advice.object_index, scale)
    _draw_now_and_advice(axes, advice, scale)
    axes.axhline(0, color=_INK, lw=0.6, alpha=0.4, zorder=1.5)
    axes.axvline(0, color=_INK, lw=0.6, alpha=0.4, zorder=1.5)
    axes.set(xlim=extent[:2], ylim=extent[2:])
    axes.set_xlabel(f"← to the left      change of own velocity sideways, {label}      to the right →")
    axes.set_ylabel(f"← slower      change of own speed, {label}      faster →")
    axes.set_title(caption.title, fontsize=11, loc="left", wrap=True)
    colours = ScalarMappable(Normalize(0, collision_map.horizon_s), _TIMES)
    figure.colorbar(colours, ax=axes, label="time until contact, s", fraction=0.045, pad=0.02)
    handles = _legend(advice, bool(families), bool(np.isnan(collision_map.probability).any()))
    foot.set_axis_off()
    legend = foot.legend(
        handles=handles, loc="upper left", ncols=len(handles), frameon=False, fontsize=9, borderaxespad=0.0
    )
    # A long row of words must not narrow the map.
    legend.set_in_layout(False)
    foot.text(0.0, 0.0, "\n".join(caption.notes), fontsize=8.5, color="#444444", transform=foot.transAxes)
    return figure


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG or SVG, by the name; the same figure gives the same bytes."""
    metadata = {"Date": None} if path.suffix == ".svg" else {"Software": None}
    figure.savefig(path, metadata=metadata, bbox_inches="tight", pad_inches=0.15)


def _edges(values: Floats) -> tuple[float, float]:
    step = float(values[1] - values[0])
    return float(values[0] - 0.5 * step), float(values[-1] + 0.5 * step)


def _colours(collision_map: CollisionMap) -> Floats:
    """Colours ``(F, R, 3)``: by time where a collision is likely, paler where it is possible, else free or unknown."""
    colours = _TIMES(np.nan_to_num(collision_map.time_s) / collision_map.horizon_s)[..., :3]
    free = np.array(to_rgb(_FREE))
    p = collision_map.probability[..., None]
    share = np.where(p >= LIKELY, 1.0, _PALE)
    shown = (p >= POSSIBLE) & np.isfinite(collision_map.time_s)[..., None]
    free = np.where(np.isnan(p), np.array(to_rgb(_UNKNOWN)), free)
    return np.where(shown, share * colours + (1.0 - share) * free, free)


def _hatch(axes: Axes, x: Floats, y: Floats, is_likely: Bools) -> None:
    """Hatching where a collision is likely, with its outline."""
    if not is_likely.any():
        return
    value = is_likely.astype(float)
    axes.contourf(x, y, value, levels=[0.5, 1.5], colors="none", hatches=["////"], zorder=2)
    axes.contour(x, y, value, levels=[0.5], colors=[_INK], linewidths=0.9, zorder=2)


def _draw_families(axes: Axes, x: Floats, y: Floats, families: Sequence[tuple[str, Floats]]) -> None:
    """What would hit an object of unknown speed: an outline for each of its possible speeds."""
    for name, members in families:
        is_hit = members >= LIKELY
        for member in is_hit:
            if member.any() and not member.all():
                axes.contour(
                    x, y, member.astype(float), levels=[0.5], colors=[_FAMILY], linewidths=1.2, linestyles="--"
                )
        if is_hit.any():
            row, column = np.argwhere(is_hit.any(axis=0)).mean(axis=0).round().astype(int)
            text = axes.text(
                x[column], y[row], f"{name}: speed unknown", color=_FAMILY, fontsize=9, ha="center", zorder=5
            )
            text.set_path_effects(_HALO)


def _name_objects(axes: Axes, collision_map: CollisionMap, first: int, scale: float) -> None:
    """The names of what we would hit: ``first``, then what takes up most of the map; each inside its largest piece."""
    index = collision_map.object_index
    sizes = {k: int((index == k).sum()) for k in np.unique(index[index >= 0]).tolist()}
    big = [k for k in sizes if sizes[k] >= _MIN_NAMED_CELLS or k == first]
    big.sort(key=lambda k: (k != first, -sizes[k]))
    n_rows, n_columns = index.shape
    # The dot for now, and where the arrow leaves it, stay free of words.
    is_taken = np.zeros(index.shape, bool)
    dot = slice(int(0.44 * n_rows), int(0.56 * n_rows) + 1), slice(int(0.4 * n_columns), int(0.6 * n_columns) + 1)
    is_taken[dot] = True
    for k in big[:_MAX_NAMES]:
        inner = ndimage.distance_transform_edt(np.pad(index == k, 1))[1:-1, 1:-1]
        inner = np.where(is_taken & (index == k), 0.5, inner)
        row, column = divmod(int(inner.argmax()), n_columns)
        margin = int(_NAME_SHARE * n_columns)
        column = min(max(column, margin), n_columns - 1 - margin)
        text = axes.text(
            collision_map.right_m_s[column] * scale,
            collision_map.forward_m_s[row] * scale,
            collision_map.names[k],
            ha="center",
            va="center",
            fontsize=9.5 if collision_map.cluster_ids[k] else 8.5,
            fontweight="bold" if collision_map.cluster_ids[k] else "normal",
            color=_INK,
            clip_on=True,
            zorder=4,
        )
        text.set_path_effects(_HALO)


def _draw_now_and_advice(axes: Axes, advice: Evasion, scale: float) -> None:
    """A dot for the present velocity, an arrow to the advised one; where that is too near for an arrow, its head."""
    axes.plot(0, 0, "o", ms=10, mfc=_INK, mec="white", mew=1.5, zorder=6)
    if advice.status not in (EvasionStatus.advice, EvasionStatus.no_escape):
        return
    tip = (advice.right_m_s * scale, advice.forward_m_s * scale)
    arrow = {"arrowstyle": "-|>", "color": _ADVICE, "lw": 3.5, "mutation_scale": 24, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, (0, 0), arrowprops=arrow, zorder=5)
    axes.plot(*tip, "D", ms=7, mfc=_ADVICE, mec="white", mew=1.2, zorder=7)


def _legend(advice: Evasion, has_families: bool, has_unknown: bool) -> list[Patch | Line2D]:
    handles: list[Patch | Line2D] = [
        Line2D([], [], marker="o", ls="", ms=9, mfc=_INK, mec="white", label="now"),
        Patch(facecolor=_TIMES(0.3), hatch="////", edgecolor=_INK, label="collision likely"),
        Patch(facecolor="#f3d6cb", edgecolor="#999999", label="possible (uncertain)"),
        Patch(facecolor=_FREE, edgecolor="#999999", label="free"),
    ]
    if advice.status in (EvasionStatus.advice, EvasionStatus.no_escape):
        words = "advice" if advice.status is EvasionStatus.advice else "least bad (no way out)"
        handles.insert(1, Line2D([], [], color=_ADVICE, lw=3, marker="D", mec="white", ms=7, label=words))
    if has_unknown:
        handles.append(Patch(facecolor=_UNKNOWN, edgecolor="#999999", label="not in view: unknown"))
    if has_families:
        handles.append(Line2D([], [], color=_FAMILY, ls="--", label="speed unknown"))
    return handles
