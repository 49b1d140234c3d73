"""The focal length found in a clip without a camera: simulated views, rendered scenes, real clips that have a camera.

python benchmarks/focal_length.py [--clips N] [--only PART] [--write-docs] [--check]

PART is one of views, scenes, clips. What is found stands beside the truth, in sigmas too.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from accuracy import PLATFORMS, SCENES
from focal_drives import KINDS, SIZE, focal_drive
from report import Bar, Report
from runs import TTCVID, data_folder, timed

from ttcvid.jobs.analyze.found_focal import with_found_focal
from ttcvid.jobs.clip import open_clip, read_calibration
from ttcvid.jobs.settings.configuration import configure_from_arguments
from ttcvid.simulate.loading import load_scene
from ttcvid.simulate.scene import camera_of
from ttcvid.stages.egomotion.focal_length import find_focal_length

N_CLIPS = 120
FAR_OFF = 0.1
"""A focal length that is wrong by more than this part misleads."""
FAR_OFF_BAR = Bar(1.0)


@dataclass(frozen=True)
class Finding:
    """One clip: its true focal length (None: nobody knows), the one found and its sigma in px (None: none)."""

    name: str
    true_px: float | None
    assumed_px: float
    found_px: float | None
    sigma_px: float | None
    cpu_s: float

    def row(self) -> list[str]:
        """The line of the table."""
        true = "?" if self.true_px is None else f"{self.true_px:.0f}"
        found, error, sigmas = "-", "-", "-"
        if self.found_px is not None and self.sigma_px is not None:
            found = f"{self.found_px:.0f} +- {self.sigma_px:.0f}"
            if self.true_px is not None:
                error = f"{100.0 * (self.found_px / self.true_px - 1.0):+.1f}"
                sigmas = f"{(self.found_px - self.true_px) / self.sigma_px:+.1f}"
        assumed = "?" if self.true_px is None else f"{100.0 * (self.assumed_px / self.true_px - 1.0):+.0f}"
        return [self.name, true, found, error, sigmas, assumed, f"{self.cpu_s:.1f}"]


HEADER = ["clip", "true, px", "found, px", "error, %", "in sigmas", "error of 55 deg, %", "processor time, s"]


def measure_views(report: Report, n_clips: int) -> None:
    """Simulated views of cameras of all kinds."""
    report.heading(f"Simulated views of {n_clips} cameras, with up to four cars before each")
    report.say(
        "Fields of view from 34 to 98 deg, noise of 0.05 to 0.3 px, clips of 1.3 to 4 s, turns of up to 23 deg/s, cars "
        "on up to half of all points (benchmarks/focal_drives.py). A straight drive has to tell nothing."
    )
    errors: dict[str, list[tuple[float, float]]] = {kind: [] for kind in KINDS}
    counts = dict.fromkeys(KINDS, 0)
    for seed in range(n_clips):
        drive = focal_drive(seed)
        counts[drive.kind] += 1
        found = find_focal_length(drive.frames, SIZE)
        if found is not None:
            error = float(np.log(found.focal_px / drive.focal_px))
            errors[drive.kind].append((error, error / found.sigma))
    rows = [_row_of_kind(kind, counts[kind], np.array(errors[kind]).reshape(-1, 2)) for kind in KINDS]
    report.table(["camera", "clips", "found", "median error, %", "largest, %", "rms in sigmas", "largest"], rows)
    found_all = np.concatenate([np.array(errors[kind]).reshape(-1, 2) for kind in KINDS])
    far_off = 100.0 * float(np.mean(np.abs(found_all[:, 0]) > FAR_OFF)) if len(found_all) else float("nan")
    report.figure(f"found, but off by more than {100 * FAR_OFF:g} %", far_off, "%", FAR_OFF_BAR)
    report.figure("found on straight drives", float(len(errors["straight"])), "", Bar(0.0))


def _row_of_kind(kind: str, n: int, errors: np.ndarray) -> list[str]:
    if not len(errors):
        return [kind, str(n), "0", "-", "-", "-", "-"]
    part, sigmas = np.abs(errors).T
    figures = (100 * np.median(part), 100 * part.max(), np.sqrt(np.mean(sigmas**2)), sigmas.max())
    return [kind, str(n), str(len(errors)), *(f"{value:.1f}" for value in figures)]


def found_in(name: str, path: Path, true_px: float | None, options: dict[str, object]) -> Finding:
    """What `ttcvid analyze` finds in a clip, camera withheld."""
    configuration = configure_from_arguments(options, None)
    with open_clip(str(path), configuration.options) as source:
        calibration = read_calibration(configuration.options, source.info.image_size)
    start_s = time.process_time()
    camera = with_found_focal(str(path), calibration, configuration).camera
    cpu_s = time.process_time() - start_s
    found_px = camera.fx_px if camera.is_found else None
    return Finding(name, true_px, calibration.camera.fx_px, found_px, camera.focal_sigma_px, cpu_s)


def measure_scenes(report: Report) -> None:
    """The rendered scenes, analysed without their cameras."""
    report.heading("Rendered scenes, without their cameras")
    findings = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for path in sorted(SCENES.glob("*.yaml")):
            scene = folder / path.stem
            timed([str(TTCVID), "simulate", str(path), "-q", "-o", str(scene)], folder)
            platform = PLATFORMS.get(path.stem, "vehicle")
            true_px = camera_of(load_scene(path)).fx_px
            findings.append(found_in(path.stem, scene / "clip.mp4", true_px, {"platform": platform}))
    report.table(HEADER, [finding.row() for finding in findings])


def measure_clips(report: Report) -> None:
    """Real clips, analysed as if their cameras were unknown; those whose camera nobody knows, for the cost."""
    report.heading("Real clips, as if nobody knew their cameras")
    data = data_folder()
    kitti_px, odometry_px = 721.5377, 707.0912
    known: list[tuple[str, str, float | None, dict[str, object]]] = [
        ("kitti_sfnd_ttc", "kitti_sfnd_ttc/image_02", kitti_px, {"fps": 9.6525, "platform": "vehicle"}),
        ("kitti_odom_straight50", "kitti_odom_straight50/image_0", odometry_px, {"fps": 10, "platform": "vehicle"}),
    ]
    for table in sorted((data / "kt3dmoseg").glob("*.tracks.parquet")):
        name = table.name.removesuffix(".tracks.parquet")
        known.append((name, f"kt3dmoseg/{table.name}", kitti_px, {"image_size": "1242x375", "platform": "vehicle"}))
    known += [
        ("davis_car_shadow", "davis_car_shadow/JPEGImages/480p/car-shadow", None, {"fps": 24}),
        ("solidWhiteRight", "driving_clips/solidWhiteRight.mp4", None, {"platform": "vehicle"}),
        ("V_AIRPLANE_041", "airborne/V_AIRPLANE_041.mp4", None, {}),
        ("street_multidir", "static_traffic/street_multidir_905f.mp4", None, {}),
        ("tud_stadtmitte", "tud_stadtmitte/TUD-Stadtmitte.mp4", None, {}),
    ]
    report.table(HEADER, [found_in(name, data / path, true, options).row() for name, path, true, options in known])


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", metavar="N", type=int, default=N_CLIPS, help="number of simulated cameras")
    parser.add_argument("--only", choices=("views", "scenes", "clips"), help="this part alone")
    parser.add_argument("--write-docs", action="store_true", help="write docs/focal_length.md")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    if arguments.only in (None, "views"):
        measure_views(report, arguments.clips)
    if arguments.only in (None, "scenes"):
        measure_scenes(report)
    if arguments.only in (None, "clips"):
        measure_clips(report)
    if arguments.write_docs:
        report.write_docs("focal_length.md", "Focal lengths found in clips")
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
