"""What carries the camera, as each clip tells it by itself (``--platform auto``), beside what does.

python benchmarks/told_platform.py [--drawn FOLDER] [--check] [--write-docs]

The clips of $TTCVID_DATA, and with --drawn the scenes that `benchmarks/scenarios.py` has drawn into FOLDER (its
--pictures), which say what carries them. Processor time is that of the looks alone, in one process.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
from report import Bar, Report
from runs import data_folder
from scenario_suite.drawing import input_of
from scenario_suite.families import FAMILIES, scenario
from scenario_suite.running import options_of

from ttcvid.jobs.analyze.found_platform import with_told_platform
from ttcvid.jobs.clip import open_clip, read_calibration
from ttcvid.jobs.settings.configuration import configure_from_arguments

ANY_OF: dict[str, tuple[str, ...]] = {
    "vehicle": ("vehicle",),
    "static": ("static",),
    "free": ("free",),
    "aircraft": ("aircraft", "free"),
    "waits": ("vehicle", "static"),
}
"""What may be told of a camera that is carried so: nothing in a clip tells an aircraft from a hand."""
WRONG_BAR = Bar(0.0)


@dataclass(frozen=True)
class Clip:
    """A clip with what carries its camera, and the options that say what is known of it."""

    name: str
    input: str
    carried: str
    options: dict[str, Any]


def real_clips() -> Iterator[Clip]:
    """The clips of the data folder."""
    data = data_folder()
    for name in ("static_traffic/street_multidir_905f.mp4", "tud_stadtmitte/TUD-Stadtmitte.mp4"):
        yield Clip(name, str(data / name), "static", {})
    for path in sorted([*(data / "dashcam").glob("*.mp4"), *(data / "driving_clips").glob("*.mp4")]):
        yield Clip(f"{path.parent.name}/{path.name}", str(path), "vehicle", {})
    sfnd, odom, moseg = data / "kitti_sfnd_ttc", data / "kitti_odom_straight50", data / "kt3dmoseg"
    yield Clip(sfnd.name, str(sfnd / "image_02"), "vehicle", {"fps": 9.6525, "camera": sfnd / "calib.txt"})
    yield Clip(odom.name, str(odom / "image_0"), "vehicle", {"fps": 10.0, "camera": odom / "calib.txt"})
    for path in sorted(moseg.glob("*.tracks.parquet")):
        options = {"image_size": "1242x375", "camera": moseg / "calib.txt"}
        yield Clip(f"{moseg.name}/{path.name.split('.')[0]}", str(path), "vehicle", options)
    car_shadow = data / "davis_car_shadow/JPEGImages/480p/car-shadow"
    yield Clip("davis_car_shadow", str(car_shadow), "free", {"fps": 24.0})
    yield Clip("airborne/V_AIRPLANE_041", str(data / "airborne/V_AIRPLANE_041.mp4"), "aircraft", {})


def drawn_scenes(folder: Path) -> Iterator[Clip]:
    """The scenes that stand in ``FOLDER/FAMILY/SEED/truth``."""
    for truth in sorted(folder.glob("*/*/truth")):
        family, seed = truth.parent.parent.name, int(truth.parent.name)
        input_ = input_of(truth)
        chosen = scenario(family, seed, "tracks" if input_.suffix == ".parquet" else "video")
        options = options_of(chosen, truth)
        del options["platform"], options["overlay"]
        carried = "waits" if family == "waiting" else FAMILIES[family].platform
        yield Clip(f"{family}:{seed}, {chosen.kind}", str(input_), carried, options)


def measure(report: Report, clips: Iterator[Clip]) -> None:
    """A table of all clips, and how many are told wrong."""
    rows, n_wrong, n_open = [], 0, 0
    for clip in clips:
        configuration = configure_from_arguments(clip.options)
        with open_clip(clip.input, configuration.options) as source:
            size = source.info.image_size
        calibration = read_calibration(configuration.options, size)
        start_s = time.process_time()
        _, told = with_told_platform(clip.input, calibration, configuration)
        took_s = time.process_time() - start_s
        assert told is not None
        is_right = told.platform.value in ANY_OF[clip.carried]
        # Nothing is expected of a camera that is free: what is not told costs accuracy, but contradicts nothing.
        is_open = not is_right and told.platform.value == "free"
        n_open, n_wrong = n_open + is_open, n_wrong + (not is_right and not is_open)
        verdict = "right" if is_right else "not told" if is_open else "WRONG"
        rows.append([clip.name, clip.carried, told.platform.value, verdict, f"{took_s:.2f}", told.reason])
    report.table(["clip", "carried by", "told", "", "s", "why"], rows)
    report.figure("clips", float(len(rows)))
    report.figure("not told (taken as free)", float(n_open))
    report.figure("told wrong", float(n_wrong), "", WRONG_BAR)


def main() -> int:
    """Measure and print; with ``--check`` 1 when a clip is told wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drawn", type=Path, action="append", default=[], help="scenes of benchmarks/scenarios.py")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a clip is told wrong")
    parser.add_argument("--write-docs", action="store_true", help="into docs/platform.md")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    report = Report()
    report.heading("Real clips")
    measure(report, real_clips())
    for folder in arguments.drawn:
        report.heading("Drawn scenes")
        measure(report, drawn_scenes(folder))
    if arguments.write_docs:
        report.write_docs("platform.md", "What carries the camera, told by the clip")
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
