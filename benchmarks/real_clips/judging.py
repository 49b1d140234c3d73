"""What is warned of where nothing collides, and what is found of the boxes that were drawn by eye.

``boxes.csv`` has a row per box: ``clip, frame, name, is_mover, x0_px, y0_px, x1_px, y1_px``. Movers (1) should be
found. The others (0) are people and cars that rest, are far off or can hardly be told: found or not, both is right.
In these frames an object on none of the boxes is false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from report import Report
from scenario_suite.figures import TEN_MINUTES_S, at_most
from scenario_suite.page import NONE, number

from real_clips.clips import DASHCAM, ClipDone
from ttcvid.jobs.evaluate import read_run_tables
from ttcvid.studies.evaluation.matching import match_objects
from ttcvid.studies.evaluation.truth import BOX, RunTables

BOXES = Path(__file__).with_name("boxes.csv")
SIZES_PX = (24.0, 60.0)
"""Borders between small, middle and large boxes, in the geometric mean of their sides."""


@dataclass(frozen=True)
class BoxesJudged:
    """Movers and those found ``(3,)``, small, middle and large; objects on none of the boxes; frames with boxes."""

    n: np.ndarray
    n_found: np.ndarray
    n_false: int
    n_frames: int


def boxes_of(clip: str) -> pd.DataFrame:
    """The boxes of a clip; none for one of which none were drawn."""
    boxes = pd.read_csv(BOXES)
    return boxes[boxes["clip"] == clip].reset_index(drop=True)


def judge_boxes(run: RunTables, boxes: pd.DataFrame) -> BoxesJudged:
    """Hold the objects of a run against boxes drawn by eye, in the frames that have some."""
    boxes = boxes[boxes.frame.isin(run.frames.frame)].reset_index(drop=True)
    boxes["object_id"] = pd.factorize(boxes.name)[0] + 1
    found = run.clusters[(run.clusters.role == "object") & run.clusters.frame.isin(boxes.frame)].reset_index(drop=True)
    matches = match_objects(boxes, found)
    is_found = np.isin(np.arange(len(boxes)), matches.pairs.truth_row)
    is_mover = boxes.is_mover.to_numpy(bool)
    x0, y0, x1, y1 = boxes[BOX].to_numpy(float).T
    size = np.searchsorted(SIZES_PX, np.sqrt((x1 - x0) * (y1 - y0)))
    return BoxesJudged(
        n=np.bincount(size[is_mover], minlength=3),
        n_found=np.bincount(size[is_mover & is_found], minlength=3),
        n_false=int((matches.verdict == "false").sum()),
        n_frames=int(boxes.frame.nunique()),
    )


def duration_s(run: RunTables) -> float:
    """Time that the frames of a run span, the last one's own included."""
    t_s = run.frames.t_s.to_numpy(float)
    return float(t_s[-1] - t_s[0] + np.median(np.diff(t_s)))


def report_clips(report: Report, done: Sequence[ClipDone]) -> None:
    """False warnings of real drives first, then the other clips, then who is found."""
    drives = [one for one in done if one.task.clip.name in DASHCAM]
    report.heading("Real drives: false warnings")
    report.say(
        "Five drives of unknown cameras without a collision or anything near one: every warning is a false one. "
        "In brackets the 95 % Poisson bound."
    )
    _warnings(report, drives)
    others = [one for one in done if one.task.clip.name not in DASHCAM]
    report.heading("Other real clips in which nothing hits the camera")
    _warnings(report, others)
    report.heading("Real clips: who should be found")
    report.say(
        "Boxes drawn by eye (`benchmarks/real_clips/boxes.csv`): walkers and cars that move; found of all, by size "
        f"(geometric mean of the sides: under {SIZES_PX[0]:g} px, to {SIZES_PX[1]:g} px, larger). "
        "False: objects on none of the boxes, those that are said to move with the scene left out."
    )
    rows = []
    for one in done:
        boxes = boxes_of(one.task.clip.name)
        if one.error is not None or boxes.empty:
            continue
        judged = judge_boxes(read_run_tables(one.run()), boxes)
        shares = [f"{k} of {n}" if n else NONE for k, n in zip(judged.n_found, judged.n, strict=True)]
        all_ = f"{judged.n_found.sum()} of {judged.n.sum()} ({100 * judged.n_found.sum() / judged.n.sum():.0f} %)"
        false = number(judged.n_false / judged.n_frames)
        rows.append([one.task.clip.name, one.task.clip.setting, str(judged.n_frames), *shares, all_, false])
    header = ["clip", "platform", "frames", "small", "middle", "large", "all", "false objects a frame"]
    report.table(header, rows)


def _warnings(report: Report, done: Sequence[ClipDone]) -> None:
    rows: list[list[str]] = []
    for setting in dict.fromkeys(one.task.clip.setting for one in done):
        total_s, total = 0.0, 0
        for one in done:
            if one.task.clip.setting != setting:
                continue
            if one.error is not None:
                rows.append([one.task.clip.name, setting, NONE, NONE, NONE, NONE, one.error])
                continue
            run = read_run_tables(one.run())
            span_s, n = duration_s(run), len(run.events)
            total_s, total = total_s + span_s, total + n
            objects = run.clusters[run.clusters.role == "object"]
            ids_a_minute = 60.0 * objects.cluster_id.nunique() / span_s
            rows.append(
                [
                    one.task.clip.name,
                    setting,
                    f"{span_s:.0f}",
                    str(n),
                    _rate(n, span_s),
                    number(ids_a_minute),
                    warnings_told(run.events) or NONE,
                ]
            )
        if total_s:
            rows.append(["all", setting, f"{total_s:.0f}", str(total), _rate(total, total_s), "", ""])
    header = ["clip", "platform", "s", "warnings", "in 10 min", "objects in 1 min", "smallest time told, and when"]
    report.table(header, rows)


def warnings_told(events: pd.DataFrame) -> str:
    """The smallest time of each warning, and when it came; empty without any."""
    return ", ".join(f"{row.min_ttc_z_s:.1f} s at {row.start_s:.1f} s" for row in events.itertuples())


def _rate(n: int, span_s: float) -> str:
    units = span_s / TEN_MINUTES_S
    return f"{number(n / units)} (<= {number(at_most(n) / units)})"
