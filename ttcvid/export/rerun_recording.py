"""A run as a recording for the Rerun viewer: video, tracks, boxes, epipoles and times on one timeline.

==================================  ==================================================================
entity
==================================  ==================================================================
``camera/image/video``              the annotated video
``camera/image/tracks``             points in the colours of their objects
``camera/image/boxes``              boxes of objects
``camera/image/epipoles``           where the line along dir meets the picture plane
``times/object_N/ttc_z_s`` ...      the times of object N, and the ends of their intervals
``own_motion/rotation_x_rad`` ...   own rotation since the frame before
``warnings``                        a line where a warning begins and ends
==================================  ==================================================================
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ttcvid.export.exported import NS_PER_S, TIMES, ExportedRun, box_of, extra, label_of, records
from ttcvid.model import NO_CLUSTER, SCENE_CLUSTER

EXTRA = "rrd"
IMAGE = "camera/image"
TIMELINE, FRAMES = "time", "frame"
NO_CLUSTER_CLASS = 65_535
"""Rerun's classes are whole numbers from 0 to this one."""
BOX_PX, TRACK_PX, EPIPOLE_PX = 1.5, 2.0, 6.0


def write_rerun(path: Path, run: ExportedRun) -> None:
    """Write the recording; OSError where that cannot be done, UsageError where the library is missing."""
    rr = extra("rerun", EXTRA)
    recording = rr.RecordingStream("ttcvid", recording_id=run.name)
    recording.save(path, default_blueprint=_blueprint(run))
    try:
        _log_classes(rr, recording, run)
        _log_video(rr, recording, run)
        _log_picture(rr, recording, run)
        _log_numbers(rr, recording, run)
        _log_warnings(rr, recording, run)
        recording.flush()
    finally:
        recording.disconnect()


def _blueprint(run: ExportedRun) -> Any:
    rrb = extra("rerun.blueprint", EXTRA)
    plots = rrb.TimeSeriesView(origin="times", name="times, s")
    turning = rrb.TimeSeriesView(origin="own_motion", name="own motion")
    picture = rrb.Spatial2DView(origin=IMAGE, name=run.name)
    return rrb.Blueprint(rrb.Vertical(picture, rrb.Horizontal(plots, turning), row_shares=[2, 1]))


def _at(rr: Any, run: ExportedRun, rows: pd.DataFrame | None = None) -> list[Any]:
    """The timelines of some rows; of every frame where none are given."""
    frame = run.frame if rows is None else rows.frame.to_numpy(np.int64)
    time_ns = run.time_ns if rows is None else run.times_ns_of(rows)
    durations = time_ns.astype("timedelta64[ns]")
    return [rr.TimeColumn(TIMELINE, duration=durations), rr.TimeColumn(FRAMES, sequence=frame)]


def _classes(numbers: pd.Series[int]) -> np.ndarray[Any, np.dtype[np.uint16]]:
    return np.asarray(numbers.replace(NO_CLUSTER, NO_CLUSTER_CLASS), dtype=np.uint16)


def _log_classes(rr: Any, recording: Any, run: ExportedRun) -> None:
    names = {SCENE_CLUSTER: "scene", NO_CLUSTER: "no cluster"}
    classes = [
        (NO_CLUSTER_CLASS if number == NO_CLUSTER else number, names.get(number, f"object {number}"), rgb)
        for number, rgb in run.colours.items()
    ]
    recording.log(IMAGE, rr.AnnotationContext(classes), static=True)


def _log_video(rr: Any, recording: Any, run: ExportedRun) -> None:
    if run.video is None:
        return
    recording.log(f"{IMAGE}/video", rr.AssetVideo(path=run.video), static=True)
    shown = rr.VideoFrameReference.columns_nanos(run.time_ns - run.time_ns[0])
    recording.send_columns(f"{IMAGE}/video", _at(rr, run), shown)


def _log_picture(rr: Any, recording: Any, run: ExportedRun) -> None:
    tracks, boxes, epipoles = run.tables["collision_times"], run.boxed, run.tables["epipoles"]
    epipoles = epipoles[epipoles[["x_px", "y_px"]].notna().all(axis=1)]
    for name, rows, radius_px in (("tracks", tracks, TRACK_PX), ("epipoles", epipoles, EPIPOLE_PX)):
        points = rr.Points2D.columns(
            positions=rows[["x_px", "y_px"]].to_numpy(np.float32),
            class_ids=_classes(rows.cluster_id),
            radii=np.full(len(rows), -radius_px, dtype=np.float32),  # negative: in points of the screen
        )
        # A row for every frame, empty ones too: what was there before goes.
        recording.send_columns(f"{IMAGE}/{name}", _at(rr, run), points.partition(run.per_frame(rows)))
    left_top, size = np.split(box_of(boxes), 2, axis=1)
    rectangles = rr.Boxes2D.columns(
        centers=left_top + size / 2,
        half_sizes=size / 2,
        class_ids=_classes(boxes.cluster_id),
        labels=[label_of(row) for row in records(boxes)],
        radii=np.full(len(boxes), -BOX_PX, dtype=np.float32),
    )
    recording.send_columns(f"{IMAGE}/boxes", _at(rr, run), rectangles.partition(run.per_frame(boxes)))


def _log_numbers(rr: Any, recording: Any, run: ExportedRun) -> None:
    for number, rows in run.boxed.groupby("cluster_id"):
        for name in TIMES:
            told = rows[rows[name].notna()]
            if len(told):
                scalars = rr.Scalars.columns(scalars=told[name].to_numpy(float))
                recording.send_columns(f"times/object_{number}/{name}", _at(rr, run, told), scalars)
    frames = run.tables["frames"]
    for axis in "xyz":
        told = frames[frames[f"rot_{axis}_rad"].notna()]
        if len(told):
            scalars = rr.Scalars.columns(scalars=told[f"rot_{axis}_rad"].to_numpy(float))
            recording.send_columns(f"own_motion/rotation_{axis}_rad", _at(rr, run, told), scalars)


def _log_warnings(rr: Any, recording: Any, run: ExportedRun) -> None:
    for frame, time_ns, text in run.notices:
        recording.set_time(TIMELINE, duration=time_ns / NS_PER_S)
        recording.set_time(FRAMES, sequence=frame)
        recording.log("warnings", rr.TextLog(text, level="WARN"))
