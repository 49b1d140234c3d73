"""The pictures of docs/gallery.md: frames of real clips as the annotated video has them, and drawings of their tables.

python benchmarks/gallery.py [--runs DIR] [--out DIR] [--only NAME]

The clips are not ours to give away: frames with their pictures go to ``--out`` (default out/gallery; git ignores it).
docs/gallery/ gets what the tables say of the same frames, drawn by the same painter on a plain ground: boxes, tracks,
directions and times, and nothing of the clip.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pandas as pd
from PIL import Image
from report import REPOSITORY
from runs import analyze_command, data_folder, shown, timed

from ttcvid import Run
from ttcvid.draw import OverlayPainter
from ttcvid.jobs.evaluate import read_run_tables
from ttcvid.jobs.runs.manifest import camera_of
from ttcvid.model import (
    ClusterRow,
    CollisionTimes,
    Event,
    FrameResult,
    FrameStatus,
    MotionState,
    Status,
    TrackRows,
)

DRAWINGS = REPOSITORY / "docs" / "gallery"
TRAIL_FRAMES = 8
PLAIN_GREY = 225
DRAWING_WIDTH_PX = 640
"""Drawings are scaled down to this width, which keeps them small."""
N_COLOURS = 32
KITTI = ("--camera", "DATA/kitti_sfnd_ttc/calib.txt", "--platform", "vehicle")


@dataclass(frozen=True)
class Exhibit:
    """A clip with the options of its analysis, and the frames that are shown."""

    clip: str
    options: tuple[str, ...]
    frames: tuple[int, ...]


EXHIBITS = {
    "lead_car": Exhibit("kitti_sfnd_ttc/image_02", (*KITTI, "--fps", "9.6525"), (12, 40, 70)),
    "motorway": Exhibit("driving_clips/solidWhiteRight.mp4", ("--platform", "vehicle"), (20, 50, 90)),
    "pan": Exhibit("davis_car_shadow/JPEGImages/480p/car-shadow", ("--fps", "24"), (10, 20, 35)),
    "street": Exhibit("static_traffic/street_multidir_905f.mp4", ("--platform", "static"), (30, 80, 110)),
    "walkers": Exhibit("tud_stadtmitte/TUD-Stadtmitte.mp4", ("--platform", "static"), (30, 70, 95)),
    "aircraft": Exhibit("airborne/V_AIRPLANE_041.mp4", ("--platform", "free"), (20, 50, 80)),
    "empty_motorway": Exhibit("dashcam/motorway_empty.mp4", ("--platform", "vehicle"), (20, 90, 120)),
    "city": Exhibit("dashcam/city_traffic.mp4", ("--platform", "vehicle"), (20, 60, 95)),
}


def main() -> int:
    """Analyse each clip up to the last frame that is shown, and write its pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, metavar="DIR", help="keep the runs here for the next time")
    parser.add_argument("--out", type=Path, metavar="DIR", default=REPOSITORY / "out" / "gallery")
    parser.add_argument("--only", metavar="NAME", choices=EXHIBITS, help="one clip only")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.runs or Path(temporary)
        for name in [arguments.only] if arguments.only else EXHIBITS:
            run = _analyzed(folder.resolve(), name)
            _write_pictures(run, name, arguments.out)
            _write_drawings(run, name)
    return 0


def _analyzed(folder: Path, name: str) -> Run:
    """The run of a clip, kept or new."""
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / name).exists():
        exhibit, data = EXHIBITS[name], data_folder()
        options = [word.replace("DATA", str(data)) for word in exhibit.options]
        words = analyze_command(data / exhibit.clip, Path(name), [*options, "--end", str(max(exhibit.frames) + 1)])
        print(" ".join(shown(words)), flush=True)
        timed(words, folder)
    return Run.open(folder / name)


def _write_pictures(run: Run, name: str, out: Path) -> None:
    """The frames with their pictures, to where git does not look."""
    out.mkdir(parents=True, exist_ok=True)
    assert run.overlay is not None
    with av.open(str(run.overlay)) as video:
        for n, picture in enumerate(video.decode(video=0)):
            if n in EXHIBITS[name].frames:
                cv2.imwrite(str(out / f"{name}_{n}.png"), picture.to_ndarray(format="bgr24"))


def _write_drawings(run: Run, name: str) -> None:
    """What the tables say of the same frames, without the pictures."""
    DRAWINGS.mkdir(parents=True, exist_ok=True)
    camera, tables = camera_of(run.manifest["camera"]), _Tables(run)
    size = camera.image_size
    painter = OverlayPainter(camera, size, TRAIL_FRAMES)
    for frame in range(max(EXHIBITS[name].frames) + 1):
        canvas = np.full((size.height_px, size.width_px, 3), PLAIN_GREY, np.uint8)
        drawing = painter.paint(canvas, tables.frame_result(frame))
        if frame in EXHIBITS[name].frames:
            scale = min(1.0, DRAWING_WIDTH_PX / size.width_px)
            small = cv2.resize(drawing, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            few_colours = Image.fromarray(small[..., ::-1]).quantize(N_COLOURS, dither=Image.Dither.NONE)
            few_colours.save(DRAWINGS / f"{name}_{frame}.png", optimize=True)


class _Tables:
    """The tables of a run, frame by frame, as the painter takes them; warnings stand while their condition holds."""

    def __init__(self, run: Run) -> None:
        tables = read_run_tables(run)
        self._frames = tables.frames.set_index("frame")
        self._tracks = dict(list(tables.collision_times.groupby("frame")))
        clusters = tables.clusters.merge(
            tables.epipoles[["frame", "cluster_id", *_EPIPOLE]].rename(columns=_EPIPOLE_NAMES),
            on=["frame", "cluster_id"],
        )
        self._clusters = dict(list(clusters.groupby("frame")))
        self._events = tables.events.to_dict("records")

    def frame_result(self, frame: int) -> FrameResult:
        """One frame."""
        row = self._frames.loc[frame]
        clusters = self._clusters.get(frame, pd.DataFrame())
        events = tuple(
            Event(**{name: values[name] for name in Event.__dataclass_fields__})
            for values in self._events
            if values["start_frame"] <= frame <= values["end_frame"]
        )
        return FrameResult(
            frame,
            float(row.t_s),
            None,
            FrameStatus(row.status),
            self._track_rows(frame),
            tuple(_cluster_row(values) for values in clusters.to_dict("records")),
            events=events,
        )

    def _track_rows(self, frame: int) -> TrackRows:
        table = self._tracks.get(frame)
        if table is None:
            nothing = np.zeros(0, np.int64)
            return TrackRows(
                nothing, nothing, np.zeros((0, 2)), nothing, np.zeros(0), CollisionTimes.missing(0), nothing
            )
        n = len(table)
        return TrackRows(
            table.track_id.to_numpy(np.int64),
            table.cluster_id.to_numpy(np.int64),
            table[["x_px", "y_px"]].to_numpy(float),
            table.n_frames.to_numpy(np.int64),
            np.full(n, np.nan),
            CollisionTimes.missing(n),
            np.zeros(n, np.int64),
        )


_AXES = ("xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz")
_EPIPOLE = ("method", "dir_x", "dir_y", "dir_z", *(f"cov_{axes}" for axes in dict.fromkeys(_AXES)), "x_px", "y_px")
_EPIPOLE_NAMES = {"x_px": "epipole_x_px", "y_px": "epipole_y_px"}


def _cluster_row(values: dict[Any, Any]) -> ClusterRow:
    """A row of ``clusters`` with that of ``epipoles``."""
    direction = np.array([values["dir_x"], values["dir_y"], values["dir_z"]])
    covariance = np.array([values[f"cov_{axes}"] for axes in _AXES]).reshape(3, 3)
    epipole_px = np.array([values["epipole_x_px"], values["epipole_y_px"]])
    rank = values["urgency_rank"]
    return ClusterRow(
        int(values["cluster_id"]),
        int(values["motion_id"]),
        int(values["n_tracks"]),
        (values["x0_px"], values["y0_px"], values["x1_px"], values["y1_px"]),
        Status[values["status"]],
        Status.ok,
        values["method"],
        MotionState(values["state"]),
        direction=direction if np.isfinite(direction).all() else None,
        direction_cov=covariance if np.isfinite(covariance).all() else None,
        epipole_px=epipole_px if np.isfinite(epipole_px).all() else None,
        ref_px=(values["ref_x_px"], values["ref_y_px"]),
        urgency_rank=int(rank) if np.isfinite(rank) else None,
        times=CollisionTimes(*(np.array([values[name]], float) for name in CollisionTimes.__dataclass_fields__)),
    )


if __name__ == "__main__":
    sys.exit(main())
