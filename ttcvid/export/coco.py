"""Boxes and tracks of objects in COCO's JSON, with videos and tracks as TAO and other video sets have them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ttcvid.export.exported import TIMES, ExportedRun, box_of, records

CATEGORY, VIDEO = 1, 1
HALF_PX = 0.5
"""COCO's (0, 0) is the corner of the first pixel, not its centre."""


def write_coco(path: Path, run: ExportedRun) -> None:
    """Write all frames as images and all boxes as annotations; OSError where that cannot be done.

    An image has the number of its frame as ``id``, an annotation the number of its object as ``track_id``, and the
    object's times with their intervals (null where there are none).
    """
    size, rows, frames = run.camera.image_size, run.boxed, run.tables["frames"]
    images = [
        {
            "id": int(frame),
            "video_id": VIDEO,
            "frame_id": int(frame),
            "file_name": f"{frame:06d}.png",
            "width": size.width_px,
            "height": size.height_px,
            "t_s": float(t_s),
        }
        for frame, t_s in zip(frames.frame, frames.t_s, strict=True)
    ]
    boxes = box_of(rows) + np.array([HALF_PX, HALF_PX, 0.0, 0.0])
    times = [{name: None if np.isnan(row[name]) else row[name] for name in TIMES} for row in records(rows)]
    annotations = [
        {
            "id": number,
            "image_id": int(frame),
            "video_id": VIDEO,
            "category_id": CATEGORY,
            "track_id": int(cluster_id),
            "bbox": np.round(box, 3).tolist(),
            "area": round(float(box[2] * box[3]), 3),
            "iscrowd": 0,
            **of_row,
        }
        for number, (frame, cluster_id, box, of_row) in enumerate(
            zip(rows.frame, rows.cluster_id, boxes, times, strict=True), start=1
        )
    ]
    tracks = [
        {"id": int(number), "video_id": VIDEO, "category_id": CATEGORY} for number in sorted(set(rows.cluster_id))
    ]
    content: dict[str, Any] = {
        "info": {"description": f"objects found by ttcvid in {run.name}"},
        "videos": [{"id": VIDEO, "name": run.name, "width": size.width_px, "height": size.height_px}],
        "images": images,
        "annotations": annotations,
        "tracks": tracks,
        "categories": [{"id": CATEGORY, "name": "object", "supercategory": ""}],
    }
    path.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
