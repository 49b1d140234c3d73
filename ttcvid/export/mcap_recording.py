"""A run as an MCAP file with Foxglove's own schemas, which its viewer and other tools of robotics show as they are.

=====================  =============================================================================
topic
=====================  =============================================================================
``/camera/video``      ``foxglove.CompressedVideo``: the annotated video, H.264
``/camera/calibration``  ``foxglove.CameraCalibration``, once
``/annotations``       ``foxglove.ImageAnnotations``, a message a frame: boxes, tracks, epipoles
``/objects/N``         JSON: the times of object N with their intervals, as its row in the table
``/warnings``          ``foxglove.Log``: where a warning begins and ends
=====================  =============================================================================
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ttcvid.export.exported import BOX, TIMES, ExportedRun, extra, label_of, records
from ttcvid.model import SCENE_CLUSTER

EXTRA = "mcap"
FRAME_ID = "camera"
_LOG = logging.getLogger(__name__)
_SCHEMAS = "foxglove_schemas_protobuf"
_LENSES = {"none": "", "plumb_bob": "plumb_bob", "rational": "rational_polynomial", "fisheye": "kannala_brandt"}
"""Foxglove's names of the distortion models."""
BOX_PX, TRACK_PX, EPIPOLE_PX, FONT_PX = 2.0, 3.0, 12.0, 14.0


def write_mcap(path: Path, run: ExportedRun) -> None:
    """Write the file; OSError where that cannot be done, UsageError where a library is missing."""
    writing = extra("mcap.writer", EXTRA)
    extra(_SCHEMAS, EXTRA)
    extra("mcap_protobuf", EXTRA)
    with path.open("wb") as stream:
        file = _File(writing.Writer(stream))
        file.writer.start(profile="", library="ttcvid")
        file.add("/camera/calibration", int(run.time_ns[0]), _calibration(run, int(run.time_ns[0])))
        for time_ns, message in _video(run):
            file.add("/camera/video", time_ns, message)
        for time_ns, message in _annotations(run):
            file.add("/annotations", time_ns, message)
        _add_objects(file, run)
        for time_ns, message in _warnings(run):
            file.add("/warnings", time_ns, message)
        file.writer.finish()


def _message(schema: str, **fields: Any) -> Any:
    return getattr(extra(f"{_SCHEMAS}.{schema}_pb2", EXTRA), schema)(**fields)


def _stamp(time_ns: int) -> Any:
    stamp = extra("google.protobuf.timestamp_pb2", EXTRA).Timestamp()
    stamp.FromNanoseconds(time_ns)
    return stamp


class _File:
    """An MCAP file that makes the channel of a topic when its first message comes."""

    def __init__(self, writer: Any) -> None:
        self.writer = writer
        self._channels: dict[str, int] = {}

    def add(self, topic: str, time_ns: int, message: Any) -> None:
        """Write a message of Foxglove's schemas."""
        if topic not in self._channels:
            schema = extra("mcap_protobuf.schema", EXTRA).register_schema(self.writer, type(message))
            self._channels[topic] = self.writer.register_channel(topic, "protobuf", schema)
        self._write(topic, time_ns, message.SerializeToString())

    def add_json(self, topic: str, time_ns: int, content: dict[str, Any], schema: int) -> None:
        """Write a message of our own, in JSON."""
        if topic not in self._channels:
            self._channels[topic] = self.writer.register_channel(topic, "json", schema)
        self._write(topic, time_ns, json.dumps(content, allow_nan=False).encode())

    def _write(self, topic: str, time_ns: int, data: bytes) -> None:
        self.writer.add_message(self._channels[topic], log_time=time_ns, data=data, publish_time=time_ns)


def _calibration(run: ExportedRun, time_ns: int) -> Any:
    camera = run.camera
    K = [camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1]
    return _message(
        "CameraCalibration",
        timestamp=_stamp(time_ns),
        frame_id=FRAME_ID,
        width=camera.image_size.width_px,
        height=camera.image_size.height_px,
        distortion_model=_LENSES[camera.distortion_model],
        D=camera.distortion,
        K=K,
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=[*K[:3], 0, *K[3:6], 0, *K[6:], 0],
    )


def _video(run: ExportedRun) -> Iterator[tuple[int, Any]]:
    """The pictures of the video as they are encoded, each a message: Annex B, no picture that looks ahead."""
    if run.video is None:
        return
    import av

    with av.open(str(run.video)) as container:
        stream = container.streams.video[0]
        if stream.codec_context.has_b_frames:
            _LOG.warning(
                "%s: some pictures look ahead (B-frames), which foxglove.CompressedVideo cannot hold, so the file has "
                "no video: analyse with --set overlay.preset=ultrafast",
                run.video,
            )
            return
        plain = av.bitstream.BitStreamFilterContext("h264_mp4toannexb", stream)
        packets = [packet for one in container.demux(stream) for packet in plain.filter(one if one.size else None)]
        for time_ns, packet in zip(run.time_ns.tolist(), packets, strict=True):
            stamp = _stamp(time_ns)
            yield (
                time_ns,
                _message("CompressedVideo", timestamp=stamp, frame_id=FRAME_ID, data=bytes(packet), format="h264"),
            )


def _annotations(run: ExportedRun) -> Iterator[tuple[int, Any]]:
    names = ("tracks", "boxes", "epipoles")
    tables = dict(zip(names, (run.tables["collision_times"], run.boxed, run.tables["epipoles"]), strict=True))
    by_frame = {name: dict(iter(rows.groupby("frame"))) for name, rows in tables.items()}
    for frame, time_ns in zip(run.frame.tolist(), run.time_ns.tolist(), strict=True):
        tracks, boxes, epipoles = (by_frame[name].get(frame, tables[name].iloc[:0]) for name in names)
        stamp = _stamp(time_ns)
        yield (
            time_ns,
            _message(
                "ImageAnnotations",
                points=[_points(run, tracks, stamp), *(_box(run, row, stamp) for row in records(boxes))],
                texts=[_text(run, row, stamp) for row in records(boxes)],
                circles=[_circle(run, row, stamp) for row in records(epipoles) if np.isfinite(row["x_px"])],
            ),
        )


def _colour(run: ExportedRun, cluster_id: int) -> Any:
    red, green, blue = (part / 255 for part in run.colours[cluster_id])
    return _message("Color", r=red, g=green, b=blue, a=1.0)


def _point(x_px: float, y_px: float) -> Any:
    return _message("Point2", x=x_px, y=y_px)


def _points(run: ExportedRun, tracks: pd.DataFrame, stamp: Any) -> Any:
    kind = extra(f"{_SCHEMAS}.PointsAnnotation_pb2", EXTRA).PointsAnnotation.Type
    return _message(
        "PointsAnnotation",
        timestamp=stamp,
        type=kind.POINTS,
        points=[_point(x, y) for x, y in zip(tracks.x_px, tracks.y_px, strict=True)],
        outline_colors=[_colour(run, number) for number in tracks.cluster_id],
        thickness=TRACK_PX,
    )


def _box(run: ExportedRun, row: Mapping[str, Any], stamp: Any) -> Any:
    kind = extra(f"{_SCHEMAS}.PointsAnnotation_pb2", EXTRA).PointsAnnotation.Type
    x0, y0, x1, y1 = (row[name] for name in BOX)
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return _message(
        "PointsAnnotation",
        timestamp=stamp,
        type=kind.LINE_LOOP,
        points=[_point(*corner) for corner in corners],
        outline_color=_colour(run, row["cluster_id"]),
        thickness=BOX_PX,
    )


def _text(run: ExportedRun, row: Mapping[str, Any], stamp: Any) -> Any:
    return _message(
        "TextAnnotation",
        timestamp=stamp,
        position=_point(row["x0_px"], row["y0_px"]),
        text=label_of(row),
        font_size=FONT_PX,
        text_color=_colour(run, row["cluster_id"]),
    )


def _circle(run: ExportedRun, row: Mapping[str, Any], stamp: Any) -> Any:
    return _message(
        "CircleAnnotation",
        timestamp=stamp,
        position=_point(row["x_px"], row["y_px"]),
        diameter=EPIPOLE_PX,
        thickness=BOX_PX,
        outline_color=_colour(run, row["cluster_id"]),
    )


def _add_objects(file: _File, run: ExportedRun) -> None:
    names = ("cluster_id", "frame", "t_s", *TIMES, "state", "status")
    kinds = {"cluster_id": "integer", "frame": "integer", "state": "string", "status": "string"}
    properties = {name: {"type": kinds.get(name, "number")} for name in names}
    schema = {"title": "ttcvid.Object", "type": "object", "properties": properties}
    number = file.writer.register_schema("ttcvid.Object", "jsonschema", json.dumps(schema).encode())
    clusters = run.tables["clusters"]
    rows = clusters[clusters.cluster_id != SCENE_CLUSTER]
    # What is null in the table is left out: a number in JSON is none.
    for time_ns, row in zip(run.times_ns_of(rows).tolist(), records(rows[list(names)]), strict=True):
        content = {name: value for name, value in row.items() if not pd.isna(value)}
        file.add_json(f"/objects/{row['cluster_id']}", time_ns, content, number)


def _warnings(run: ExportedRun) -> Iterator[tuple[int, Any]]:
    level = extra(f"{_SCHEMAS}.Log_pb2", EXTRA).Log.Level.WARNING
    for _, time_ns, text in run.notices:
        yield time_ns, _message("Log", timestamp=_stamp(time_ns), level=level, message=text, name="ttcvid")
