"""The truths of the real clips, each as the truth that ``ttcvid evaluate`` takes, and the figures that have a bar.

Nothing of the clips is kept here: the files are read from the data folder.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from clustering_error import clustering_error, label_of_tracks
from report import Bar
from runs import data_folder

from ttcvid import Run
from ttcvid.geometry.rotation import normalize, vector_from_rotation
from ttcvid.jobs.evaluate import read_run_tables
from ttcvid.studies.evaluation.evaluate import Evaluation, judge_run
from ttcvid.studies.evaluation.truth import BOX, DIRECTION, ROTATION, RunTables, Truth, object_at


@dataclass(frozen=True)
class Figure:
    """One number of a clip, in the measure that its truth is known for."""

    name: str
    value: float
    unit: str = ""
    bar: Bar | None = None


@dataclass(frozen=True)
class Judged:
    """A run beside its truth: the metrics of ``ttcvid evaluate``, and the figures with a bar."""

    evaluation: Evaluation
    figures: list[Figure]


@dataclass(frozen=True)
class RealClip:
    """A clip of the data folder: input and options (paths relative to that folder), and how its run is judged."""

    name: str
    path: str
    options: tuple[str, ...]
    judge: Callable[[Run], Judged]

    def arguments(self) -> list[str]:
        """The options with full paths."""
        return [str(data_folder() / word) if word.endswith(".txt") else word for word in self.options]


LEAD_CAR_FRAMES, STANDSTILL_FRAMES = (8, 48), (56, 77)
"""Lidar is worse in the first and last six frames of the approach; from frame 54 on nothing moves."""


def judge_lead_car(run: Run) -> Judged:
    """``kitti_sfnd_ttc``: the time of the car ahead, from lidar, and quiet at the red light."""
    return _judged_lead_car(run, median_bar=Bar(5.0), p90_bar=Bar(13.0))


def judge_smoothed_lead_car(run: Run) -> Judged:
    """The same with frames on both sides."""
    return _judged_lead_car(run, median_bar=Bar(3.0), p90_bar=Bar(8.0))


def _judged_lead_car(run: Run, median_bar: Bar, p90_bar: Bar) -> Judged:
    tables = read_run_tables(run)
    truth = pd.read_csv(data_folder() / "kitti_sfnd_ttc" / "lead_car_truth.csv")
    truth = truth[truth.frame.between(*LEAD_CAR_FRAMES)].rename(columns={"ttc_s_at_0.1036s": "ttc_z_s"})
    objects = _objects(truth[["frame", *BOX, "ttc_z_s"]], "lead car", tables)
    evaluation = judge_run(tables, Truth(objects=objects, has_all_objects=False))
    still = tables.clusters[tables.clusters.frame.between(*STANDSTILL_FRAMES)]
    n_approaching = int(((still.role == "object") & (still.state == "approaching")).sum())
    first, last = STANDSTILL_FRAMES
    n_events = int(((tables.events.end_frame >= first) & (tables.events.start_frame <= last)).sum())
    return Judged(
        evaluation,
        [
            _percent("ttc_z, median error", evaluation, "ttc_z.median", median_bar),
            _percent("ttc_z, p90", evaluation, "ttc_z.p90", p90_bar),
            _percent("found", evaluation, "objects.share", Bar(95.0, at_least=True)),
            _percent("one cluster_id", evaluation, "objects.one_id", Bar(95.0, at_least=True)),
            _percent("90 % intervals hold the truth", evaluation, "ttc_z.coverage", Bar(80.0, True, 97.0)),
            _percent("their median half-width", evaluation, "ttc_z.half_width", Bar(25.0)),
            Figure("objects said to approach at the red light", n_approaching, "rows", Bar(0.0)),
            Figure("warnings at the red light", n_events, "", Bar(0.0)),
        ],
    )


def judge_focus_of_expansion(run: Run) -> Judged:
    """``kitti_odom_straight50``: own direction and rotation from poses; row i is the motion from frame i - 1 to i."""
    tables = read_run_tables(run)
    folder = data_folder() / "kitti_odom_straight50"
    evaluation = judge_run(tables, Truth(frames=frames_of_poses(np.loadtxt(folder / "poses.txt"), tables)))
    truth = pd.read_csv(folder / "foe_truth.csv", comment="#").assign(frame=lambda rows: rows.frame + 1)
    scene = tables.epipoles[tables.epipoles.cluster_id == 0]
    both = truth.merge(scene, on="frame", how="left")
    error_px = np.hypot(both.x_px - both.foe_u, both.y_px - both.foe_v).fillna(np.inf)
    return Judged(
        evaluation,
        [
            Figure("epipole, median error", float(error_px.median()), "px", Bar(3.0)),
            Figure("epipole, p90", float(error_px.quantile(0.9, interpolation="higher")), "px", Bar(6.0)),
        ],
    )


def frames_of_poses(poses: np.ndarray, run: RunTables) -> pd.DataFrame:
    """``truth_frames`` of camera poses ``(N, 12)``: rows of (R | t) that take a point of the camera into the world."""
    world_T_cam = poses.reshape(-1, 3, 4)
    world_R_cam, place = world_T_cam[:, :, :3], world_T_cam[:, :, 3]
    cam_R_prev = np.einsum("nji,njk->nik", world_R_cam[1:], world_R_cam[:-1])
    moved = np.einsum("nji,nj->ni", world_R_cam[1:], np.diff(place, axis=0))
    frames = pd.DataFrame({"frame": np.arange(len(poses))})
    frames[ROTATION] = np.vstack([np.full(3, np.nan), vector_from_rotation(cam_R_prev)])
    frames[DIRECTION] = np.vstack([np.full(3, np.nan), normalize(-moved)])
    return frames.merge(run.frames[["frame", "t_s"]], on="frame")


def judge_bodies(run: Run) -> Judged:
    """``kt3dmoseg``: the clustering error against groups given by hand."""
    tables = read_run_tables(run)
    path = Path(str(run.manifest["input"]["path"]).replace(".tracks.", ".labels."))
    truth = pd.read_parquet(data_folder() / "kt3dmoseg" / path.name).set_index("track_id").label
    found = label_of_tracks(run.collision_times).reindex(truth.index, fill_value=-1)
    error_percent = 100.0 * clustering_error(truth.to_numpy(), found.to_numpy())
    return Judged(judge_run(tables, Truth()), [Figure("clustering error", error_percent, "%")])


SETTLED_FRAME = 4
"""Of ``davis_car_shadow``, rows from this frame on are judged: a motion has to be seen before it can be told."""


def judge_car_mask(run: Run) -> Judged:
    """``davis_car_shadow``: which tracks are on the car, F1 of being in an object against lying on the mask."""
    tables = read_run_tables(run)
    masks = sorted((data_folder() / "davis_car_shadow" / "Annotations" / "480p").rglob("*.png"))
    tracks = tables.collision_times
    track_object = np.full(len(tracks), -1)
    on_mask = np.zeros(len(tracks), bool)
    boxes = []
    for frame, path in enumerate(masks):
        mask = (cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 0).astype(np.uint16)
        rows = (tracks.frame == frame).to_numpy()
        xy_px = tracks.loc[rows, ["x_px", "y_px"]].to_numpy()
        track_object[rows] = object_at(mask, xy_px)
        column, row = np.rint(xy_px).astype(int).T
        on_mask[rows] = mask[row, column] > 0
        y, x = np.nonzero(mask)
        boxes.append((frame, x.min(), y.min(), x.max(), y.max()))
    objects = _objects(pd.DataFrame(boxes, columns=["frame", *BOX]), "car", tables)
    truth = Truth(objects=objects, track_object=track_object, has_all_objects=False)
    settled = (tracks.frame >= SETTLED_FRAME).to_numpy()
    said, true = (tracks.cluster_id > 0).to_numpy()[settled], on_mask[settled]
    f1 = 2.0 * (said & true).sum() / max(said.sum() + true.sum(), 1)
    bar = Bar(0.85, at_least=True)
    return Judged(judge_run(tables, truth), [Figure("F1 of tracks on the car", float(f1), "", bar)])


def judge_aircraft(run: Run) -> Judged:
    """``airborne``: boxes drawn by hand and the time from their growth, good to 10 to 30 %."""
    tables = read_run_tables(run)
    paths = sorted((data_folder() / "airborne").glob("*_boxes.csv"))
    truth = pd.concat([pd.read_csv(path, comment="#") for path in paths], ignore_index=True)
    dt_s = float(run.manifest["input"]["nominal_dt_s"])
    truth = truth.assign(
        x0_px=truth.x, y0_px=truth.y, x1_px=truth.x + truth.w, y1_px=truth.y + truth.h, ttc_z_s=truth.k_frames * dt_s
    )
    objects = _objects(truth[["frame", *BOX, "ttc_z_s"]], "aircraft", tables)
    evaluation = judge_run(tables, Truth(objects=objects, has_all_objects=False))
    return Judged(evaluation, [_percent("found", evaluation, "objects.share")])


def judge_quiet(run: Run) -> Judged:
    """A clip in which nothing is on collision course: every warning is false."""
    tables = read_run_tables(run)
    nothing = pd.DataFrame({"frame": [], "t_s": [], "object_id": [], **{side: [] for side in BOX}})
    nothing = nothing.assign(name=pd.Series(dtype=object), is_counted=pd.Series(dtype=bool))
    encounters = pd.DataFrame({"object_id": [], "is_collision": [], "t_contact_s": []})
    evaluation = judge_run(tables, Truth(objects=nothing, encounters=encounters, has_all_objects=False))
    return Judged(evaluation, [Figure("warnings", evaluation.metrics["events.false"] or 0.0, "", Bar(0.0))])


def real_clips() -> list[RealClip]:
    """All clips that have a truth, and the quiet one."""
    of_kitti = ("--camera", "kitti_sfnd_ttc/calib.txt", "--fps", "9.6525", "--platform", "vehicle")
    straight = ("--camera", "kitti_odom_straight50/calib.txt", "--fps", "10", "--platform", "vehicle")
    of_tracks = ("--camera", "kt3dmoseg/calib.txt", "--image-size", "1242x375", "--platform", "vehicle")
    tables = sorted((data_folder() / "kt3dmoseg").glob("*.tracks.parquet"))
    groups = [
        RealClip(path.name.removesuffix(".tracks.parquet"), f"kt3dmoseg/{path.name}", of_tracks, judge_bodies)
        for path in tables
    ]
    car_shadow = "davis_car_shadow/JPEGImages/480p/car-shadow"
    return [
        RealClip("kitti_sfnd_ttc", "kitti_sfnd_ttc/image_02", of_kitti, judge_lead_car),
        RealClip("kitti_sfnd_ttc_smooth", "kitti_sfnd_ttc/image_02", (*of_kitti, "--smooth"), judge_smoothed_lead_car),
        RealClip("kitti_odom_straight50", "kitti_odom_straight50/image_0", straight, judge_focus_of_expansion),
        *groups,
        RealClip("davis_car_shadow", car_shadow, ("--fps", "24"), judge_car_mask),
        RealClip("V_AIRPLANE_041", "airborne/V_AIRPLANE_041.mp4", ("--platform", "free"), judge_aircraft),
        RealClip("solidWhiteRight", "driving_clips/solidWhiteRight.mp4", ("--platform", "vehicle"), judge_quiet),
    ]


def _objects(rows: pd.DataFrame, name: str, run: RunTables) -> pd.DataFrame:
    """One object per frame as ``truth_objects``."""
    rows = rows.merge(run.frames[["frame", "t_s"]], on="frame")
    return rows.assign(object_id=1, name=name, is_counted=True)


def _percent(name: str, evaluation: Evaluation, metric: str, bar: Bar | None = None) -> Figure:
    value = evaluation.metrics[metric]
    return Figure(name, float("nan") if value is None else 100.0 * value, "%", bar)
