"""A scene with known truth, rendered and analysed: what was found beside what is true."""

from __future__ import annotations

import importlib.resources
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from ttcvid.errors import OutputError
from ttcvid.jobs.analyze import OnFrame, run_analysis
from ttcvid.jobs.configuration import configure_from_arguments
from ttcvid.jobs.run import Run
from ttcvid.jobs.simulate import Simulation, simulate
from ttcvid.model import Floats

SCENE_NAME, RESULT_NAME = "scene", "result"
MIN_IOU = 0.3
"""Overlap of an object's box with a true box from which on the two are taken for the same thing."""
_BOX = ["x0_px", "y0_px", "x1_px", "y1_px"]


@dataclass(frozen=True)
class Comparison:
    """Estimated beside true time to collision of one mover; ``matches`` has a row for every frame it was found in."""

    name: str
    n_visible: int
    matches: pd.DataFrame

    @property
    def median_error(self) -> float:
        """Median of abs(true / estimate - 1); NaN where it was never found."""
        return float((self.matches.true_s / self.matches.estimated_s - 1).abs().median())


@dataclass(frozen=True)
class Demo:
    """The rendered scene, its analysis, and how the two compare."""

    simulation: Simulation
    run: Run
    comparisons: tuple[Comparison, ...]


def demo(
    out: str | Path = "ttcvid_demo",
    *,
    overwrite: bool = False,
    n_frames: int | None = None,
    on_picture: Callable[[int, int], None] | None = None,
    on_frame: OnFrame | None = None,
) -> Demo:
    """Render the scene of the package into ``out/scene``, analyse it into ``out/result``, and compare.

    ``on_picture`` and ``on_frame`` are told of each picture rendered and analysed. OutputError where ``out`` exists
    and ``overwrite`` is not given, or holds other things.
    """
    out = Path(out)
    if out.exists() and not overwrite:
        raise OutputError(f"{out}: exists already: give --overwrite to replace the demo in it, or use -o")
    scene = importlib.resources.files("ttcvid.jobs") / "demo_scene.yaml"
    with importlib.resources.as_file(scene) as scene_path:
        simulation = simulate(scene_path, out / SCENE_NAME, n_frames=n_frames, overwrite=overwrite, progress=on_picture)
    options = {
        "camera": simulation.folder / "camera.yaml",
        "platform": "vehicle",
        "overwrite": overwrite,
    }
    configuration = configure_from_arguments(options)
    run = run_analysis(str(simulation.input), out / RESULT_NAME, configuration, arguments=["demo"], on_frame=on_frame)
    truth = pq.read_table(simulation.folder / "truth_objects.parquet").to_pandas()
    return Demo(simulation, run, compare_movers(truth, run.clusters))


def compare_movers(truth: pd.DataFrame, clusters: pd.DataFrame) -> tuple[Comparison, ...]:
    """What moves on its own and approaches, nearest first, each with the clusters that lie over it frame by frame.

    ``truth`` has the columns of ``truth_objects``, ``clusters`` those of the table of that name.
    """
    movers = truth[truth.is_moving & (truth.ttc_z_s > 0)]
    nearest_first = movers.sort_values("ttc_z_s").object_id.unique()
    objects = clusters[(clusters.role == "object") & clusters.ttc_z_s.notna()]
    return tuple(_compare(movers[movers.object_id == object_id], objects) for object_id in nearest_first)


def _compare(mover: pd.DataFrame, objects: pd.DataFrame) -> Comparison:
    """One mover with the object that overlaps it most, in each frame where one does."""
    pairs = mover.merge(objects, on="frame", suffixes=("", "_found"))
    found_box = pairs[[f"{side}_found" for side in _BOX]].to_numpy(float)
    pairs["iou"] = iou(pairs[_BOX].to_numpy(float), found_box)
    best = pairs[pairs.iou >= MIN_IOU].sort_values("iou").groupby("frame").tail(1).sort_values("frame")
    columns = {
        "frame": best.frame,
        "true_s": best.ttc_z_s,
        "estimated_s": best.ttc_z_s_found.astype(float),
        "lo_s": best.ttc_z_lo_s.astype(float),
        "hi_s": best.ttc_z_hi_s.astype(float),
    }
    return Comparison(str(mover.name.iloc[0]), len(mover), pd.DataFrame(columns).reset_index(drop=True))


def iou(first: Floats, second: Floats) -> Floats:
    """Intersection over union ``(N,)`` of boxes ``(N, 4)``: x0, y0, x1, y1.

    >>> iou(np.array([[0.0, 0, 2, 2]]), np.array([[1.0, 0, 3, 2]])).round(3).tolist()
    [0.333]
    """
    low = np.maximum(first[:, :2], second[:, :2])
    high = np.minimum(first[:, 2:], second[:, 2:])
    common = np.prod(np.clip(high - low, 0, None), axis=1)
    areas = [np.prod(box[:, 2:] - box[:, :2], axis=1) for box in (first, second)]
    union = np.maximum(areas[0] + areas[1] - common, np.finfo(float).tiny)
    return np.asarray(common / union)
