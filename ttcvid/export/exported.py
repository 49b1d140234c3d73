"""What an export is made of: the tables of one finished analysis, in ordinary types."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd

from ttcvid.draw.palette import colours_of_clip
from ttcvid.errors import UsageError
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER, Camera, Floats, Ints

NS_PER_S = 1_000_000_000
BOX = ["x0_px", "y0_px", "x1_px", "y1_px"]
TIMES = tuple(f"{name}{end}_s" for name in ("tcpa", "miss", "ttc_z") for end in ("", "_lo", "_hi"))
Rgb = tuple[int, int, int]
SCENE_RGB: Rgb = (140, 140, 140)


@dataclass(frozen=True)
class ExportedRun:
    """One run: null is NaN in its tables, and ``NO_CLUSTER`` in ``cluster_id``; ``video`` is the annotated one."""

    name: str
    tables: Mapping[str, pd.DataFrame]
    camera: Camera
    nominal_dt_s: float
    video: Path | None

    @cached_property
    def boxed(self) -> pd.DataFrame:
        """The rows of objects that have a box."""
        clusters = self.tables["clusters"]
        return clusters[(clusters.cluster_id != SCENE_CLUSTER) & clusters[BOX].notna().all(axis=1)]

    @cached_property
    def frame(self) -> Ints:
        """The numbers of the frames ``(F,)``, ascending."""
        return np.asarray(self.tables["frames"].frame, dtype=np.int64)

    @cached_property
    def time_ns(self) -> Ints:
        """Presentation times ``(F,)``; from the first frame on where that one is before 0."""
        t_s = self.tables["frames"].t_s.to_numpy(float)
        return np.asarray(np.round((t_s - min(0.0, t_s.min())) * NS_PER_S), dtype=np.int64)

    @cached_property
    def colours(self) -> dict[int, Rgb]:
        """Red, green, blue of each object as in the annotated video, of the scene, and of what has no cluster."""
        seen = pd.concat([self.tables[name][["frame", "cluster_id"]] for name in ("clusters", "collision_times")])
        objects = seen[seen.cluster_id > SCENE_CLUSTER].drop_duplicates()
        in_view: list[list[int]] = [rows.tolist() for _, rows in objects.groupby("frame").cluster_id]
        colours = {number: bgr[::-1] for number, bgr in colours_of_clip(in_view).items()}
        return {**colours, SCENE_CLUSTER: SCENE_RGB, NO_CLUSTER: SCENE_RGB}

    @cached_property
    def notices(self) -> list[tuple[int, int, str]]:
        """Where warnings begin and end: the frame, its time in ns, and the words."""
        found = []
        for event in records(self.tables["events"]):
            words = f"{event['kind'].replace('_', ' ')} of object {event['cluster_id']}"
            for frame, text in ((event["start_frame"], words), (event["end_frame"], f"end of {words}")):
                found.append((int(frame), int(self.time_ns[np.searchsorted(self.frame, frame)]), text))
        return sorted(found)

    def per_frame(self, rows: pd.DataFrame) -> Ints:
        """How many of some rows, sorted by frame, belong to each frame ``(F,)``."""
        place = np.searchsorted(self.frame, rows.frame.to_numpy(np.int64))
        return np.bincount(place, minlength=len(self.frame))

    def times_ns_of(self, rows: pd.DataFrame) -> Ints:
        """The times of some rows."""
        return self.time_ns[np.searchsorted(self.frame, rows.frame.to_numpy(np.int64))]


def records(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows as mappings from column to value."""
    return [{str(name): value for name, value in row.items()} for row in rows.to_dict("records")]


def label_of(row: Mapping[str, Any]) -> str:
    """What stands beside an object's box: its number, and its time to collision while it approaches."""
    time = f" {row['ttc_z_s']:.1f} s" if row["ttc_z_s"] > 0 else ""
    return f"{row['cluster_id']}{time}"


def box_of(rows: pd.DataFrame) -> Floats:
    """Left, top, width and height ``(N, 4)`` of boxes; (0, 0) is the centre of the first pixel."""
    x0, y0, x1, y1 = (rows[name].to_numpy(float) for name in BOX)
    return np.column_stack([x0, y0, x1 - x0, y1 - y0])


def extra(module: str, name: str) -> ModuleType:
    """A library that is not always installed; UsageError with how to get it where it is missing."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise UsageError(
            f"--to {name} needs the library {module.split('.')[0]}, which is not installed: "
            f"pip install 'ttcvid[{name}]'"
        ) from None
