"""The horizon from things that move in straight lines: simulated cameras by the hundred, real clips, its use.

python benchmarks/horizon.py [--cameras N] [--pictures N] [--only PART] [--write-docs] [--check]

PART is one of cameras, one-direction, pictures, clips, planar. Each figure stands beside its bar.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from horizon_scenes import resting_scene
from report import REPOSITORY, Bar, Report
from runs import analyze_command, analyzed, data_folder, shown, timed

import ttcvid
from ttcvid.config import HorizonCalibrationConfig
from ttcvid.geometry.horizon.line import band_px
from ttcvid.geometry.horizon.plane import pitch_roll_rad
from ttcvid.simulate import TrackOptions, simulate_tracks
from ttcvid.simulate.poses import mean_horizon_px
from ttcvid.simulate.scene import camera_of
from ttcvid.stages.horizon.at_rest import calibrated_horizon
from ttcvid.stages.horizon.straight_motions import find_motions
from ttcvid.stages.horizon.whole_tracks import Observations, joined

N_CAMERAS = 200
SIGMA_PX, OUTLIERS = 0.3, 0.01
"""Noise of the simulated tracks, and the part of observations that are thrown off by up to 12 px."""
N_PICTURES, FIRST_PICTURE = 20, 100
"""Rendered cameras and the seed of the first one: those below were looked at when the method was made."""
OTHER_WINDOWS_PX = (21, 29)
"""Sides of the tracker's window that the result should not depend on."""
TTCVID = Path(sys.executable).with_name("ttcvid")
FAR_M = 20.0
"""Single points of movers farther away than this count as far."""


@dataclass(frozen=True)
class Calibrated:
    """One simulated camera: errors and half bands at left, centre and right in px, and the error of roll."""

    error_px: np.ndarray
    half_px: np.ndarray
    roll_error_deg: float
    n_used: int
    n_motions: int


def calibrate_camera(seed: int, one_direction: bool = False) -> Calibrated | None:
    """Calibrate the simulated camera of a seed from point tracks."""
    scene = resting_scene(seed, one_direction)
    camera, config = camera_of(scene), HorizonCalibrationConfig()
    tracks = simulate_tracks(scene, TrackOptions(sigma_px=SIGMA_PX, outlier_fraction=OUTLIERS))
    rows = joined([Observations(tracks.track_id, tracks.frame, tracks.t_s, tracks.xy_px)])
    motions = find_motions(rows, camera, config)
    result = calibrated_horizon(motions, camera, config)
    if result.fit is None:
        return None
    right_px = camera.image_size.width_px - 1.0
    y_px, half_px = band_px(camera, result.fit, np.array([0.0, right_px / 2, right_px]))
    left, right = mean_horizon_px(scene)
    roll_deg = float(np.degrees(pitch_roll_rad(result.fit.normal)[1]))
    n_used = int(result.fit.is_used.sum())
    truth_px = np.array([left, (left + right) / 2, right])
    return Calibrated(y_px - truth_px, half_px, roll_deg - scene.camera.roll_deg, n_used, len(motions))


def _one_direction(seed: int) -> Calibrated | None:
    return calibrate_camera(seed, one_direction=True)


def in_parallel(work: Callable[[int], Calibrated | None], count: int) -> list[Calibrated | None]:
    """Cameras 0 .. count - 1, on two processes."""
    with ProcessPoolExecutor(2) as pool:
        return list(pool.map(work, range(count)))


def measure_cameras(report: Report, count: int) -> None:
    """Errors and bands over many simulated resting cameras."""
    report.heading(f"{count} simulated resting cameras, point tracks")
    report.say(
        "Pitch -15 to 10 deg, roll -5 to 5 deg, 3 to 8 walkers and cars on straight ways of their own, 640x360, 4 s at "
        f"25 Hz, noise {SIGMA_PX} px, {OUTLIERS:.0%} outliers of up to 12 px."
    )
    found = [camera for camera in in_parallel(calibrate_camera, count) if camera is not None]
    error_px = np.abs([camera.error_px for camera in found])
    inside = error_px <= [camera.half_px for camera in found]
    report.figure("error at the centre, median", float(np.median(error_px[:, 1])), "px", Bar(3.0))
    report.figure("error at the centre, 95th percentile", float(np.percentile(error_px[:, 1], 95)), "px", Bar(10.0))
    roll_deg = float(np.median([abs(camera.roll_error_deg) for camera in found]))
    report.figure("error of the roll, median", roll_deg, "deg", Bar(0.3))
    for place, part in zip(("left", "centre", "right"), 100 * inside.mean(axis=0), strict=True):
        report.figure(f"95 % band holds the truth at the {place}", float(part), "%", Bar(90.0, at_least=True))
        if place == "centre":
            report.figure("and not too often", float(part), "%", Bar(98.0))
    half_px = float(np.median([camera.half_px[1] for camera in found]))
    report.figure("half the band at the centre, median", half_px, "px")
    report.figure("undetermined", count - len(found), "cameras")


def measure_one_direction(report: Report, count: int) -> None:
    """Scenes in which all move along one line have to be undetermined."""
    report.heading(f"{count} simulated cameras before which all move along one line, forth or back")
    wrong = sum(camera is not None for camera in in_parallel(_one_direction, count))
    report.figure("not called undetermined", wrong, "cameras", Bar(0.0))


def measure_pictures(report: Report, count: int) -> None:
    """The sample scene and some of the random ones, rendered and tracked."""
    report.heading(f"Simulated cameras, rendered pictures: the sample scene and {count} random ones")
    report.say(
        "As above, but rendered (noise of one grey level, H.264) and followed by our own tracker: a car is some 50 px "
        "long, a walker some 8 px wide. The seeds are others than those that the method was made with."
    )
    found: list[tuple[np.ndarray, np.ndarray, float]] = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        scenes = {"resting_six_movers": REPOSITORY / "sample_configs/scenes/resting_six_movers.yaml"}
        for seed in range(FIRST_PICTURE, FIRST_PICTURE + count):
            path = folder / f"resting_{seed}.yaml"
            scene = resting_scene(seed).model_dump(mode="json", exclude_none=True)
            path.write_text(yaml.safe_dump(scene), encoding="utf-8")
            scenes[path.stem] = path
        for name, path in scenes.items():
            camera = calibrate_rendered(path, folder / name)
            if camera is None:
                report.say(f"{name}: undetermined")
                continue
            error_px, half_px, _ = camera
            report.say(f"{name}: {error_px[1]:+.1f} px at the centre, band +-{half_px[1]:.1f} px")
            found.append(camera)
    report.figure("undetermined", len(scenes) - len(found), "cameras")
    error_px = np.abs([camera[0] for camera in found])
    report.figure("error at the centre, median", float(np.median(error_px[:, 1])), "px", Bar(3.0))
    report.figure("error at the centre, 95th percentile", float(np.percentile(error_px[:, 1], 95)), "px", Bar(10.0))
    roll_deg = float(np.median([abs(camera[2]) for camera in found]))
    report.figure("error of the roll, median", roll_deg, "deg", Bar(0.3))
    inside = error_px <= [camera[1] for camera in found]
    report.figure("95 % band holds the truth", 100 * float(inside.mean()), "%", Bar(90.0, at_least=True))
    half_px = float(np.median([camera[1][1] for camera in found]))
    report.figure("half the band at the centre, median", half_px, "px")


def calibrate_rendered(scene: Path, folder: Path) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Errors and half bands at left, centre and right in px, and the error of roll in deg; None: undetermined."""
    ttcvid.simulate(scene, folder)
    found = calibrated(folder / "clip.mp4", folder / "out/horizon.yaml", ["--camera", str(folder / "camera.yaml")])
    if found is None:
        return None
    truth = yaml.safe_load((folder / "horizon.yaml").read_text())["horizon"]
    left, right = (found["horizon"][side] - truth[side] for side in ("y_left_px", "y_right_px"))
    half_px = np.array([found["band_95_px"][place] for place in ("left", "centre", "right")])
    true_roll_deg = yaml.safe_load(scene.read_text())["camera"].get("roll_deg", 0.0)
    return np.array([left, (left + right) / 2, right]), half_px, found["roll_deg"] - true_roll_deg


def calibrated(clip: Path, out: Path, options: list[str], window_px: int | None = None) -> dict | None:
    """The horizon file of a clip as ``ttcvid calibrate-horizon`` writes it; None where it is undetermined."""
    tracking = {} if window_px is None else {"tracking": {"window_px": window_px}}
    result = ttcvid.calibrate_horizon(clip, out, **keywords(options), **tracking)
    return None if result.horizon is None else yaml.safe_load(out.read_text())


def keywords(options: list[str]) -> dict:
    """Options of the command line as arguments in Python."""
    words, result = iter(options), {}
    for word in words:
        name = word.removeprefix("--").replace("-", "_")
        result[name] = True if name in ("moving", "roll_zero", "overwrite") else next(words)
    if "fps" in result:
        result["fps"] = float(result["fps"])
    return result


def report_centre(report: Report, name: str, found: dict | None, true_px: float, bar: Bar) -> None:
    """Error at the centre of the picture and the band there."""
    if found is None:
        report.figure(f"{name}: error at the centre", float("nan"), "px", bar)
        return
    line, half_px = found["horizon"], found["band_95_px"]["centre"]
    error_px = abs(0.5 * (line["y_left_px"] + line["y_right_px"]) - true_px)
    report.figure(f"{name}: error at the centre", error_px, "px", bar)
    report.figure(f"{name}: error over half the band", error_px / half_px, "", Bar(1.0))


def measure_clips(report: Report, keep: Path | None) -> None:
    """The real clips."""
    report.heading("Real clips")
    data = data_folder()
    tud, street = data / "tud_stadtmitte/TUD-Stadtmitte.mp4", data / "static_traffic/street_multidir_905f.mp4"
    kitti = data / "kitti_odom_straight50"
    with tempfile.TemporaryDirectory() as temporary:
        folder = keep or Path(temporary)
        report.command(shown([str(TTCVID), "calibrate-horizon", str(tud), "-o", "tud/horizon.yaml"]))
        found = calibrated(tud, folder / "tud/horizon.yaml", ["--overwrite"])
        report_centre(report, "tud_stadtmitte", found, 108.2, Bar(15.0))
        if found is not None:
            true_px = {"left": 113.2, "centre": 108.2, "right": 103.2}
            line = found["horizon"]
            mine_px = {"left": line["y_left_px"], "right": line["y_right_px"]}
            mine_px["centre"] = 0.5 * (mine_px["left"] + mine_px["right"])
            ratio = max(abs(mine_px[place] - true_px[place]) / found["band_95_px"][place] for place in true_px)
            report.figure("tud_stadtmitte: largest error over half the band", ratio, "", Bar(1.0))
            report.figure("tud_stadtmitte: half the band, widest", max(found["band_95_px"].values()), "px", Bar(40.0))
        for window_px in OTHER_WINDOWS_PX:
            other = calibrated(tud, folder / f"tud_{window_px}/horizon.yaml", ["--overwrite"], window_px)
            report_centre(report, f"tud_stadtmitte, tracked with windows of {window_px} px", other, 108.2, Bar(15.0))
        # Nearly all that moves there follows one road: its slope has to be given.
        for name, level in {"street_multidir_905f": [], "street_multidir_905f --roll-zero": ["--roll-zero"]}.items():
            words = [str(TTCVID), "calibrate-horizon", str(street), *level, "-o", "street/horizon.yaml"]
            report.command(shown(words))
            found = calibrated(street, folder / "street/horizon.yaml", [*level, "--overwrite"])
            report.say(f"{name}: {described(found)} (no truth known)")
        options = ["--camera", str(kitti / "calib.txt"), "--fps", "10", "--moving"]
        words = [str(TTCVID), "calibrate-horizon", str(kitti / "image_0"), *options, "-o", "kitti/horizon.yaml"]
        report.command(shown(words))
        found = calibrated(kitti / "image_0", folder / "kitti/horizon.yaml", [*options, "--overwrite"])
        truth = pd.read_csv(kitti / "foe_truth.csv", comment="#")
        report_row(report, found, float(truth.foe_u.median()), float(truth.foe_v.median()))


def described(found: dict | None) -> str:
    """The line of a horizon file in words."""
    if found is None:
        return "undetermined"
    line, half_px = found["horizon"], found["band_95_px"]["centre"]
    return f"y = {line['y_left_px']:.0f} px left, {line['y_right_px']:.0f} px right, +-{half_px:.0f} px at the centre"


def report_row(report: Report, found: dict | None, x_px: float, true_px: float) -> None:
    """Distance of the line from the epipole's row, at its column."""
    error_px = float("nan")
    if found is not None:
        line, width = found["horizon"], found["image_size"][0]
        y_px = line["y_left_px"] + (line["y_right_px"] - line["y_left_px"]) * x_px / (width - 1)
        error_px = abs(y_px - true_px)
    report.figure("kitti_odom_straight50 --moving: distance from the epipole's row", error_px, "px", Bar(8.0))


def measure_planar(report: Report) -> None:
    """Times of far single points: with the horizon found in the drive, and by the general case of three frames."""
    report.heading("What the horizon brings: far single points of the simulated roundabout")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        scene = REPOSITORY / "sample_configs/scenes/roundabout.yaml"
        ttcvid.simulate(scene, folder / "scene", tracks=TrackOptions())
        clip, camera = folder / "scene/tracks.parquet", ["--camera", str(folder / "scene/camera.yaml")]
        words = [
            str(TTCVID),
            "calibrate-horizon",
            str(clip),
            *camera,
            "--moving",
            "-q",
            "-o",
            str(folder / "horizon.yaml"),
        ]
        timed(words, folder)
        options = [*camera, "--platform", "vehicle", "--no-overlay"]
        planar = [*options, "--estimator", "two-frame", "--horizon", str(folder / "horizon.yaml")]
        general = [*options, "--estimator", "three-frame"]
        truth = pd.read_parquet(folder / "scene/truth_tracks.parquet")
        errors = {}
        for name, chosen in (("planar", planar), ("general", general)):
            report.command(
                [word.replace(f"{folder}/", "") for word in shown(analyze_command(clip, folder / name, chosen))]
            )
            errors[name] = errors_of_far_points(analyzed(clip, folder / name, chosen).run, truth)
        both = pd.concat(errors, axis=1, join="inner")
        report.say(f"{len(both)} times of points of movers more than {FAR_M:g} m away, that both give.")
        for name in errors:
            report.figure(f"{name}: median error of the time to closest approach", 100 * both[name].median(), "%")
        ratio = both["planar"].median() / both["general"].median()
        report.figure("planar over general", ratio, "", Bar(1.0))


def errors_of_far_points(run: ttcvid.Run, truth: pd.DataFrame) -> pd.Series:
    """abs(true / estimated - 1) of 1/tcpa, relative, of far points of movers, by (frame, track)."""
    far = truth[(truth.object_id > 0) & (truth.z_m > FAR_M) & ~truth.is_outlier]
    found = run.collision_times[["frame", "track_id", "tcpa_s"]].dropna().astype(float)
    rows = found.merge(far[["frame", "track_id", "tcpa_s"]], on=["frame", "track_id"], suffixes=("", "_true")).dropna()
    error = (rows.tcpa_s_true / rows.tcpa_s - 1.0).abs()
    return pd.Series(error.to_numpy(), index=pd.MultiIndex.from_frame(rows[["frame", "track_id"]]))


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, default=N_CAMERAS, metavar="N", help="simulated cameras")
    parser.add_argument("--pictures", type=int, default=N_PICTURES, metavar="N", help="rendered cameras")
    parts = ("cameras", "one-direction", "pictures", "clips", "planar")
    parser.add_argument("--only", choices=parts, help="one part alone")
    parser.add_argument("--keep", metavar="FOLDER", type=Path, help="leave the files of the real clips here")
    parser.add_argument("--write-docs", action="store_true", help="write docs/horizon_accuracy.md")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    work: dict[str, Callable[[], None]] = {
        "cameras": lambda: measure_cameras(report, arguments.cameras),
        "one-direction": lambda: measure_one_direction(report, arguments.cameras // 4),
        "pictures": lambda: measure_pictures(report, arguments.pictures),
        "clips": lambda: measure_clips(report, arguments.keep),
        "planar": lambda: measure_planar(report),
    }
    for part in parts:
        if arguments.only in (None, part):
            work[part]()
    if arguments.write_docs:
        report.write_docs("horizon_accuracy.md", "Accuracy of calibrate-horizon")
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
