"""The pictures of a verdict: errors over distance and size, and a frame of each of the worst scenes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import av
import cv2
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scenario_suite.scoring import SceneScore
from ttcvid.studies.evaluation.truth import BOX

DISTANCE_M = np.geomspace(3.0, 200.0, 8)
SIZE_PX = np.geomspace(10.0, 400.0, 8)
LEAST_PER_BIN = 15
_TILE_PX, _COLUMNS, _QUALITY = (384, 216), 2, 78
_TRUE_BGR, _FOUND_BGR = (255, 255, 255), (0, 140, 255)


def write_errors(scores: Sequence[SceneScore], path: Path) -> None:
    """Small multiples, a row a group: share found, and median error of ttc_z and tcpa, over distance and over size."""
    groups = sorted({one.facts["group"] for one in scores if len(one.object_frames)})
    figure = Figure(figsize=(9.0, 1.7 * len(groups) + 0.6), layout="constrained")
    axes = figure.subplots(len(groups), 4, squeeze=False, sharey="col")
    for row, group in zip(axes, groups, strict=True):
        of_group = [one.object_frames for one in scores if one.facts["group"] == group and len(one.object_frames)]
        rows = pd.concat(of_group, ignore_index=True)
        # Smaller ones too: what size does is what these panels show.
        rows = rows[rows.is_wanted.astype(bool)]
        over = (("distance_m", DISTANCE_M, "distance, m"), ("size_px", SIZE_PX, "size, px"))
        for k, (column, edges, label) in enumerate(over):
            _found(row[2 * k], rows, column, edges)
            _errors(row[2 * k + 1], rows[rows.is_found.astype(bool)], column, edges)
            for axis in row[2 * k : 2 * k + 2]:
                axis.set_xscale("log")
                axis.set_xlim(edges[0], edges[-1])
                axis.set_xlabel(label, fontsize=7)
                axis.tick_params(labelsize=7)
                axis.grid(alpha=0.3)
        row[0].set_ylabel(group, fontsize=8)
    for k, title in enumerate(("found, %", "error, %", "found, %", "error, %")):
        axes[0, k].set_title(title, fontsize=8)
    handles, labels = axes[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=7, frameon=False)
    FigureCanvasAgg(figure).print_png(str(path), metadata={"Software": None})


def _found(axis: Axes, rows: pd.DataFrame, column: str, edges: np.ndarray) -> None:
    middle, share = _binned(rows[column], rows.is_found.astype(float), edges, np.mean)
    axis.plot(middle, 100 * share, "o-", color="tab:green", markersize=3)
    axis.set_ylim(0, 102)


def _errors(axis: Axes, rows: pd.DataFrame, column: str, edges: np.ndarray) -> None:
    for name, colour in (("ttc_z", "tab:blue"), ("tcpa", "tab:red")):
        judged = rows[rows[f"{name}_error"].notna()]
        error = 100 * judged[f"{name}_error"].abs()
        middle, median = _binned(judged[column], error, edges, np.median)
        axis.plot(middle, median, "o-", color=colour, markersize=3, label=f"{name}, median")
        middle, high = _binned(judged[column], error, edges, lambda values: np.quantile(values, 0.9))
        axis.plot(middle, high, ":", color=colour, label=f"{name}, p90")
    axis.set_yscale("log")
    axis.set_ylim(0.3, 300)


def _binned(
    place: pd.Series, values: pd.Series, edges: np.ndarray, summary: Callable[[np.ndarray], float]
) -> tuple[np.ndarray, np.ndarray]:
    """Middle of each bin that has enough rows, and the summary of these."""
    place, values = place.to_numpy(float), values.to_numpy(float)
    inside = [(place >= low) & (place < high) for low, high in pairwise(edges)]
    kept = [k for k, chosen in enumerate(inside) if chosen.sum() >= LEAST_PER_BIN]
    middle = np.sqrt(edges[:-1] * edges[1:])[kept]
    return middle, np.array([summary(values[inside[k]]) for k in kept])


def write_worst(worst: Sequence[SceneScore], path: Path) -> None:
    """A sheet with one frame of each scene, numbered from the worst: true boxes of what has to be found, found ones."""
    tiles = [_tile(one, place) for place, one in enumerate(worst, 1)]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % _COLUMNS)
    sheet = np.vstack([np.hstack(tiles[k : k + _COLUMNS]) for k in range(0, len(tiles), _COLUMNS)])
    cv2.imwrite(str(path), sheet, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])


def _tile(one: SceneScore, place: int) -> np.ndarray:
    frame = _telling_frame(one)
    picture = _picture(one.folder / "truth" / "clip.mp4", frame)
    scale = min(_TILE_PX[0] / picture.shape[1], _TILE_PX[1] / picture.shape[0])
    picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    truth = pd.read_parquet(one.folder / "truth" / "truth_objects.parquet")
    clusters = pd.read_parquet(one.folder / "run" / "clusters.parquet")
    rows = one.object_frames
    due = set(rows[(rows.frame == frame) & rows.is_due].object_id) if len(rows) else set()
    for box in truth[(truth.frame == frame) & truth.object_id.isin(due)][BOX].to_numpy(float):
        _draw(picture, scale * box, _TRUE_BGR)
    found = clusters[(clusters.frame == frame) & (clusters.role == "object")]
    for box in found[BOX].to_numpy(float):
        _draw(picture, scale * box, _FOUND_BGR)
    label = f"{place}  {one.name}  frame {frame}"
    for colour, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(picture, label, (5, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, width, cv2.LINE_AA)
    tile = np.zeros((_TILE_PX[1], _TILE_PX[0], 3), np.uint8)
    tile[: picture.shape[0], : picture.shape[1]] = picture
    return tile


def _telling_frame(one: SceneScore) -> int:
    """The frame with the most missed and false objects, the middle one of them."""
    wrong = one.frames.set_index("frame").n_false.astype(float)
    if len(one.object_frames):
        rows = one.object_frames
        missed = rows[rows.is_due & ~rows.is_found].groupby("frame").size()
        wrong = wrong.add(missed, fill_value=0.0)
    most = wrong.index[wrong == wrong.max()]
    return int(most[len(most) // 2])


def _picture(path: Path, frame: int) -> np.ndarray:
    with av.open(str(path)) as container:
        for number, picture in enumerate(container.decode(video=0)):
            if number == frame:
                return picture.to_ndarray(format="bgr24")
    raise ValueError(f"{path}: has no frame {frame}")


def _draw(picture: np.ndarray, box: np.ndarray, colour: tuple[int, int, int]) -> None:
    x0, y0, x1, y1 = np.rint(box).astype(int).tolist()
    cv2.rectangle(picture, (x0, y0), (x1, y1), colour, 1)
