"""How well own motion is found: the epipole of the scene and the rotation, against truth.

python benchmarks/epipole.py [--tracker klt] [--tracker akaze] [--check]

``kitti_odom_straight50`` is a real, straight drive (truth: GPS and inertial, good to 3 px): a constant scores 1.4 px
there. So a simulated drive whose direction swings by 10 deg counts with it. A frame without an epipole counts as an
infinite error; the first frame, which can have none, does not count.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from plain_epipole import plain_epipoles_px
from report import REPOSITORY, Bar, Report
from runs import TTCVID, analyze_command, analyzed, data_folder, shown, timed

from ttcvid import Run

TRACKERS = ("klt", "akaze")
MEDIAN_PX_BAR, P90_PX_BAR, ROTATION_DEG_BAR, SWINGING_DEG_BAR = Bar(3.0), Bar(6.0), Bar(0.03), Bar(0.2)
SCENE = REPOSITORY / "sample_configs" / "scenes" / "swinging_drive.yaml"


def scene_epipoles(run: Run) -> pd.DataFrame:
    """A row for every frame but the first: direction and pixel of the scene's epipole, NaN where there is none."""
    of_scene = run.epipoles[run.epipoles.cluster_id == 0].set_index("frame")
    columns = ["dir_x", "dir_y", "dir_z", "x_px", "y_px"]
    return of_scene[columns].reindex(run.frames.frame[1:]).astype(float)


def median_and_p90(errors: np.ndarray) -> tuple[float, float]:
    """Of absolute errors; NaN counts as infinite."""
    errors = np.where(np.isnan(errors), np.inf, np.abs(errors))
    return float(np.median(errors)), float(np.percentile(errors, 90, method="higher"))


def measure_straight(report: Report, tracker: str, folder: Path) -> None:
    """``kitti_odom_straight50``: row i against the truth of the motion from frame i - 1 to i."""
    place = data_folder() / "kitti_odom_straight50"
    options = ["--fps", "10", "--camera", str(place / "calib.txt"), "--platform", "vehicle", "--tracker", tracker]
    report.heading(f"kitti_odom_straight50 with {tracker}")
    report.command(shown(analyze_command(place / "image_0", Path("run"), options)))
    run = analyzed(place / "image_0", folder / f"straight_{tracker}", options).run
    truth = pd.read_csv(place / "foe_truth.csv", comment="#")
    found = scene_epipoles(run)
    truth = truth.set_index(truth.frame + 1).loc[found.index]
    error_px = np.hypot(found.x_px - truth.foe_u, found.y_px - truth.foe_v).to_numpy()
    median_px, p90_px = median_and_p90(error_px)
    report.figure(f"{tracker}: epipole of the scene, median error", median_px, "px", MEDIAN_PX_BAR)
    report.figure(f"{tracker}: its 90th percentile", p90_px, "px", P90_PX_BAR)
    report.figure(f"{tracker}: mean error in x (what is common to all frames)", (found.x_px - truth.foe_u).mean(), "px")
    report.figure(f"{tracker}: mean error in y", (found.y_px - truth.foe_v).mean(), "px")
    constant = np.hypot(truth.foe_u - truth.foe_u.median(), truth.foe_v - truth.foe_v.median())
    report.figure("for comparison, the median of all truth as a constant, median error", float(constant.median()), "px")
    rotation_deg = np.degrees(np.linalg.norm(run.frames[["rot_x_rad", "rot_y_rad", "rot_z_rad"]].astype(float), axis=1))
    median_deg, p90_deg = median_and_p90(rotation_deg[1:] - truth.rot_deg.to_numpy())
    report.figure(f"{tracker}: magnitude of the rotation, median error", median_deg, "deg", ROTATION_DEG_BAR)
    report.figure(f"{tracker}: its 90th percentile", p90_deg, "deg")
    report.figure("for comparison, no rotation at all, median error", float(truth.rot_deg.median()), "deg")


def compare_plainly(report: Report) -> None:
    """``kitti_odom_straight50`` without ttcvid, over one and over ten frames: is what is off common to all methods?"""
    place = data_folder() / "kitti_odom_straight50"
    images = sorted((place / "image_0").glob("*.png"))
    poses = np.loadtxt(place / "poses.txt").reshape(-1, 3, 4)
    calibration = np.loadtxt(place / "calib.txt", usecols=(0, 2, 6), max_rows=1)
    report.heading("kitti_odom_straight50 by plain least squares, nothing of ttcvid (benchmarks/plain_epipole.py)")
    for gap in (1, 10):
        found = plain_epipoles_px(images, calibration[0], calibration[1:], gap)
        ends = poses[gap::gap]
        moved = np.einsum("nji,nj->ni", ends[:, :, :3], ends[:, :, 3] - poses[:-gap:gap, :, 3])
        errors = found - (calibration[1:] + calibration[0] * moved[:, :2] / moved[:, 2:])
        report.figure(f"{gap} frames: median error", float(np.median(np.hypot(*errors.T))), "px")
        report.figure(f"{gap} frames: mean error in x", float(errors[:, 0].mean()), "px")
        report.figure(f"{gap} frames: mean error in y", float(errors[:, 1].mean()), "px")


def render(folder: Path) -> tuple[Path, list[str]]:
    """Render the swinging drive; its folder and the command line."""
    words = [str(TTCVID), "simulate", str(SCENE), "-o", str(folder / "swinging")]
    timed(words, folder)
    return folder / "swinging", words


def measure_swinging(report: Report, tracker: str, folder: Path, scene: Path, render_command: list[str]) -> None:
    """The simulated drive: row i against the truth of frame i, which is about the motion up to i as well."""
    options = ["--camera", str(scene / "camera.yaml"), "--platform", "vehicle", "--tracker", tracker]
    report.heading(f"Swinging drive with {tracker}")
    report.command([word.replace(f"{folder}/", "") for word in shown(render_command)])
    words = shown(analyze_command(scene / "clip.mp4", Path("run"), options))
    report.command([word.replace(f"{folder}/", "") for word in words])
    run = analyzed(scene / "clip.mp4", folder / f"swinging_{tracker}", options).run
    found = scene_epipoles(run)[["dir_x", "dir_y", "dir_z"]].to_numpy()
    truth = pq.read_table(scene / "truth_frames.parquet").to_pandas().set_index("frame").loc[run.frames.frame[1:]]
    true_dir = truth[["dir_x", "dir_y", "dir_z"]].to_numpy()
    angle_deg = angles_deg(found, true_dir)
    median_deg, p90_deg = median_and_p90(angle_deg)
    report.figure(f"{tracker}: direction of the scene, median error", median_deg, "deg", SWINGING_DEG_BAR)
    report.figure(f"{tracker}: its 90th percentile", p90_deg, "deg")
    straight, _ = median_and_p90(angles_deg(np.broadcast_to([0.0, 0.0, -1.0], true_dir.shape), true_dir))
    report.figure("for comparison, the optical axis as a constant, median error", straight, "deg")
    columns = ["rot_x_rad", "rot_y_rad", "rot_z_rad"]
    turned = np.degrees(np.linalg.norm(run.frames[columns].to_numpy(float)[1:] - truth[columns].to_numpy(), axis=1))
    report.figure(f"{tracker}: rotation vector, median error", median_and_p90(turned)[0], "deg")


def angles_deg(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angle between unit vectors (N, 3) each; exact also where it is small."""
    return np.degrees(2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.linalg.norm(one - other, axis=1))))


def measure(report: Report, trackers: tuple[str, ...] = TRACKERS) -> None:
    """Both drives with each tracker."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        compare_plainly(report)
        scene, render_command = render(folder)
        for tracker in trackers:
            measure_straight(report, tracker, folder)
            measure_swinging(report, tracker, folder, scene, render_command)


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tracker", choices=TRACKERS, action="append", help="repeatable; default: both")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    arguments = parser.parse_args()
    report = Report()
    measure(report, tuple(arguments.tracker or TRACKERS))
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
