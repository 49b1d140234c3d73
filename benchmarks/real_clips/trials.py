"""Real clips by which rules are tried: short cuts of clips and tables of tracks, each with something to count.

Tables of tracks (KT3DMoSeg) have the groups given by hand: the share of tracks in a wrong one. Of cuts the boxes drawn
by eye are counted, and the objects on none of them; nothing hits the camera, so that every warning is false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from clustering_error import NOWHERE, clustering_error, label_of_tracks
from scenario_suite.figures import TEN_MINUTES_S, Share

from real_clips.clips import CLIPS, Clip, ClipDone
from real_clips.judging import boxes_of, duration_s, judge_boxes
from ttcvid.jobs.evaluate import read_run_tables

WINDOW_S = 1.0
"""Warnings are counted in windows of this length: what the bootstrap draws."""
CUTS = {
    "city_traffic": (0, 95),
    "motorway_traffic": (195, 265),
    "highway": (140, 200),
    "solidWhiteRight": (0, 95),
    "street_multidir_905f": (0, 85),
    "TUD-Stadtmitte": (0, 65),
}
"""First frame and the one after the last: as few as show the boxes of a frame or two, and of two drives a place with a
warning."""
TABLES = ("Seq009_Clip01", "Seq013_Clip01", "Seq020_Clip01", "Seq028_Clip01", "Seq038_Clip01")
FIGURES = (
    ("error", "tracks in the right group, points", 100.0, -1.0),
    ("found", "boxes found, points", 100.0, 1.0),
    ("false", "objects on no box, in 100 frames", 100.0, -1.0),
    ("warnings", "false warnings in 10 min", 1.0, -1.0),
)
"""Figures, their names on the page, scale, and whether more is better (1) or less (-1)."""


@dataclass(frozen=True)
class Unit:
    """Something counted in a table, a frame with boxes or a window: ``part`` of ``whole``."""

    figure: str
    part: float
    whole: float


def table_clips(data: Path) -> list[Clip]:
    """The tables of tracks."""
    camera = {"camera": str(data / "kt3dmoseg" / "calib.txt"), "image_size": "1242x375", "platform": "vehicle"}
    return [Clip(name, f"kt3dmoseg/{name}.tracks.parquet", "tracks", camera) for name in TABLES]


def cut_clips() -> list[Clip]:
    """The cuts of the clips of the page, as it gives their platform."""
    whole = {clip.name: clip for clip in reversed(CLIPS)}
    return [
        replace(whole[name], options={**whole[name].options, "start": str(first), "end": str(end)})
        for name, (first, end) in CUTS.items()
    ]


def units_of(done: ClipDone) -> list[Unit]:
    """What is counted in an analysed table or cut."""
    clip = done.task.clip
    if clip.setting == "tracks":
        truth = pd.read_parquet(done.task.data / clip.path.replace(".tracks.", ".labels.")).set_index("track_id").label
        found = label_of_tracks(done.run().collision_times).reindex(truth.index, fill_value=NOWHERE)
        return [Unit("error", clustering_error(truth.to_numpy(), found.to_numpy()), 1.0)]
    run = read_run_tables(done.run())
    boxes = boxes_of(clip.name)
    units: list[Unit] = []
    for _, of_frame in boxes[boxes.frame.isin(run.frames.frame)].groupby("frame"):
        judged = judge_boxes(run, of_frame)
        units += [Unit("found", float(judged.n_found.sum()), float(judged.n.sum())), Unit("false", judged.n_false, 1.0)]
    length_s = duration_s(run)
    edges_s = float(run.frames.t_s.iloc[0]) + WINDOW_S * np.arange(np.ceil(length_s / WINDOW_S) + 1)
    begun, _ = np.histogram(run.events.start_s.to_numpy(float), edges_s)
    shares = np.diff(np.minimum(edges_s, edges_s[0] + length_s)) / TEN_MINUTES_S
    return units + [Unit("warnings", float(n), float(share)) for n, share in zip(begun, shares, strict=True)]


def shares_of(units: Sequence[Unit]) -> dict[str, Share]:
    """The figures over units, as those over scenes."""
    of_name = {name: [unit for unit in units if unit.figure == name] for name, *_ in FIGURES}
    return {
        name: Share(np.array([unit.part for unit in some]), np.array([unit.whole for unit in some]))
        for name, some in of_name.items()
        if some
    }
