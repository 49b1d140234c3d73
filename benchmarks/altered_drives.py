"""False warnings on real drives, and on the same drives altered a little: what a driver would call the same.

python benchmarks/altered_drives.py [--jobs 2] [--out FOLDER] [--only NAME] [--write-docs]

On the drives as they are the analysis was looked at again and again; altered, they are new to it. Nothing collides in
any, so every warning is a false one.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

# One thread of linear algebra in each process: set before numpy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import av
import cv2
import numpy as np
from real import done_in_order
from real_clips.clips import DASHCAM, Clip, ClipDone, ClipTask, do_clip
from real_clips.judging import duration_s, warnings_told
from report import REPOSITORY, Bar, Report
from runs import data_folder, until_stopped
from scenario_suite.figures import TEN_MINUTES_S, at_most

from ttcvid.jobs.evaluate import read_run_tables
from ttcvid.model import Picture

FALSE_WARNINGS_BAR = Bar(1.0)


@dataclass(frozen=True)
class Alteration:
    """What is done to each picture, the quality it is then encoded in, and how many pictures are left out first."""

    change: Callable[[Picture], Picture] | None = None
    crf: int = 18
    n_skipped: int = 0


def _mirrored(picture: Picture) -> Picture:
    return picture[:, ::-1]


def _cropped(picture: Picture) -> Picture:
    """Without 6 % at the top and on the left, as by a camera that is mounted a little otherwise."""
    return picture[picture.shape[0] * 6 // 100 :, picture.shape[1] * 6 // 100 :]


def _smaller(picture: Picture) -> Picture:
    return np.asarray(cv2.resize(picture, None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA), dtype=np.uint8)


ALTERATIONS = {
    "as it is": None,
    "mirrored": Alteration(_mirrored),
    "cropped": Alteration(_cropped),
    "smaller": Alteration(_smaller),
    "coarser": Alteration(crf=28),
    "later": Alteration(n_skipped=11),
}
"""Of each drive; None: the clip itself."""


def write_altered(source: Path, target: Path, alteration: Alteration) -> None:
    """Write a clip altered, with its frame rate; complete or not at all."""
    unfinished = target.with_suffix(".part.mp4")
    with av.open(str(source)) as clip, av.open(str(unfinished), "w") as out:
        video = clip.streams.video[0]
        stream = out.add_stream("libx264", rate=video.average_rate)
        stream.pix_fmt, stream.options = "yuv420p", {"crf": str(alteration.crf), "preset": "veryfast"}
        for number, frame in enumerate(clip.decode(video)):
            if number < alteration.n_skipped:
                continue
            picture = frame.to_ndarray(format="bgr24")
            picture = picture if alteration.change is None else alteration.change(picture)
            # Half of the colours are left out: both sides have to be even.
            height, width = (side // 2 * 2 for side in picture.shape[:2])
            if not stream.codec_context.is_open:
                stream.width, stream.height = width, height
            even = np.ascontiguousarray(picture[:height, :width])
            out.mux(stream.encode(av.VideoFrame.from_ndarray(even, format="bgr24")))
        out.mux(stream.encode())
    unfinished.replace(target)


def do_drive(task: ClipTask, source: Path) -> ClipDone:
    """Alter a drive, unless it is taken as it is, and analyse it, unless that is done."""
    path, alteration = task.data / task.clip.path, ALTERATIONS[task.clip.setting]
    if alteration is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_altered(source / f"{task.clip.name}.mp4", path, alteration)
    return do_clip(task)


def report_drives(report: Report, done: Sequence[ClipDone]) -> None:
    """Warnings of each drive, as it is and altered, and how many these are in ten minutes."""
    runs = {one.task.folder: read_run_tables(one.run()) for one in done if one.error is None}
    rows: dict[str, list[str]] = {}
    for one in done:
        run = runs.get(one.task.folder)
        told = (warnings_told(run.events) or "0") if run else str(one.error)
        rows.setdefault(one.task.clip.name, []).append(told)
    report.table(["drive", *ALTERATIONS], [[name, *told] for name, told in rows.items()])
    for is_altered, name in ((False, "as they are"), (True, "altered")):
        tasks = [one.task for one in done if (ALTERATIONS[one.task.clip.setting] is not None) == is_altered]
        of_kind = [runs[task.folder] for task in tasks if task.folder in runs]
        span_s, n_warnings = sum(map(duration_s, of_kind)), sum(len(run.events) for run in of_kind)
        report.figure(f"drives {name}: time", span_s, "s")
        if of_kind:
            units = span_s / TEN_MINUTES_S
            report.figure(f"drives {name}: false warnings in 10 min", n_warnings / units, "", FALSE_WARNINGS_BAR)
            report.figure(f"drives {name}: 95 % bound on that (Poisson)", at_most(n_warnings) / units)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2, help="processes side by side")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "out" / "altered", help="where the folders belong")
    parser.add_argument("--only", default="", help="drives whose name contains this")
    parser.add_argument("--write-docs", action="store_true", help="into docs/altered_drives.md")
    arguments = parser.parse_args()
    source, tasks = data_folder() / "dashcam", []
    for name in (name for name in DASHCAM if arguments.only in name):
        for setting, alteration in ALTERATIONS.items():
            folder = source if alteration is None else arguments.out / "clips" / setting
            clip = Clip(name, f"{name}.mp4", setting, {"platform": "vehicle"})
            tasks.append(ClipTask(clip, folder, arguments.out))
    done = done_in_order(tasks, arguments.jobs, partial(do_drive, source=source))
    report = Report()
    report.say(
        "Five drives of unknown cameras (`--platform vehicle`) without a collision: every warning is a false one. "
        "The rules were made while the drives as they are were looked at; mirrored, cropped by 6 % at the top and on "
        "the left, 0.8 times as large, encoded with crf 28, or begun 11 pictures later they are new to them, though "
        "not independent of each other. A warning is told with its smallest time, and when it came."
    )
    report_drives(report, done)
    if arguments.write_docs:
        report.write_docs("altered_drives.md", "Real drives, altered")


if __name__ == "__main__":
    until_stopped(main)
