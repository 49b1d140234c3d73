"""Objects as rows of the MOT Challenge: what evaluations of multi-object tracking read.

``frame, id, bb_left, bb_top, bb_width, bb_height, conf, x, y, z`` without a head; frames and pixels count from 1, and
what is not known is -1 (Leal-Taixe et al., MOTChallenge 2015, section 3.2).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ttcvid.export.exported import ExportedRun, box_of

FIRST = 1
"""The number of the first frame, and of the first pixel."""


def write_mot(path: Path, run: ExportedRun) -> None:
    """Write the boxes of all objects; OSError where that cannot be done."""
    rows = run.boxed
    left, top, width, height = box_of(rows).T
    unknown = np.full((len(rows), 3), -1.0)
    numbers = np.column_stack([rows.frame + FIRST, rows.cluster_id, left + FIRST, top + FIRST, width, height])
    table = np.column_stack([numbers, np.ones(len(rows)), unknown])
    np.savetxt(path, table, fmt=["%d", "%d", *["%.2f"] * 4, *["%d"] * 4], delimiter=",")
