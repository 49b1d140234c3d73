"""Folders of runs made without any analysis, as large or as odd as a test wants them."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from perfect_runs import manifest_of_run, write_run

from ttcvid.model import ImageSize
from ttcvid.sinks.manifest import write_manifest
from ttcvid.sinks.video import OverlayVideo
from ttcvid.studies.evaluation.truth import RunTables

DT_S = 0.1
SIZE = ImageSize(64, 48)
WARNED_FROM = 20
"""Object 1 is warned of from this frame on, to the end."""
_BOX = {"x0_px": 20.0, "y0_px": 15.0, "x1_px": 40.0, "y1_px": 30.0, "ref_x_px": 30.0, "ref_y_px": 24.0}
_COVARIANCE = {"cov_xx": 1e-4, "cov_xy": 0.0, "cov_xz": 0.0, "cov_yy": 4e-4, "cov_yz": 0.0, "cov_zz": 0.0}


def made_run(folder: Path, n_frames: int = 40, n_objects: int = 2, has_video: bool = False, **manifest: Any) -> Path:
    """A run whose object 1 comes nearer and is warned of; of object 2, if there is one, that is not sure; others rest.

    ``manifest`` are fields of the manifest that differ from `manifest_of_run`.
    """
    frame = np.arange(n_frames)
    frames = pd.DataFrame({"frame": frame, "t_s": frame * DT_S, "dt_s": DT_S, "n_tracks": 50, "status": "ok"})
    frames = frames.assign(rot_x_rad=0.001, rot_y_rad=-0.002, rot_z_rad=0.0, rot_sigma_rad=1e-4)
    frames.loc[0, ["dt_s", "rot_x_rad", "rot_y_rad", "rot_z_rad", "status"]] = [np.nan, np.nan, np.nan, np.nan, "first"]
    clusters = pd.concat([_cluster(number, frames) for number in range(n_objects + 1)])
    clusters = clusters.sort_values(["frame", "cluster_id"], ignore_index=True)
    is_scene = clusters.cluster_id == 0
    epipoles = clusters[["frame", "t_s", "cluster_id"]].assign(**_COVARIANCE, method="whole-tracks", status="ok")
    epipoles = epipoles.assign(x_px=25.0, y_px=20.0)
    epipoles = epipoles.assign(dir_x=np.where(is_scene, 0.0, 0.6), dir_y=0.0, dir_z=np.where(is_scene, -1.0, -0.8))
    tracks = pd.DataFrame({"frame": frame, "t_s": frame * DT_S, "track_id": 7, "cluster_id": 1, "status": "ok"})
    tracks = tracks.assign(x_px=30.0, y_px=24.0)
    end_frame = n_frames - 1
    events = {"event_id": 1, "kind": "collision_course", "cluster_id": 1, "start_frame": WARNED_FROM}
    events |= {"end_frame": end_frame, "start_s": WARNED_FROM * DT_S, "end_s": end_frame * DT_S, "confidence": 0.99}
    n_events = int(n_objects > 0 and n_frames > WARNED_FROM)
    write_run(folder, RunTables(frames, clusters, epipoles, tracks, pd.DataFrame([events] * n_events, columns=events)))
    counts = {"frames": n_frames, "track_rows": len(tracks), "objects": n_objects, "events": n_events}
    content = manifest_of_run((SIZE.width_px, SIZE.height_px)) | {"counts": {**counts, "skipped_packets": 0}} | manifest
    camera: Any = content["camera"]
    camera.update(fx_px=60.0, fy_px=60.0, cx_px=31.5, cy_px=23.5)
    files = {f"{name}.parquet": 1 for name in ("frames", "clusters", "epipoles", "collision_times", "events")}
    if has_video:
        files["overlay.mp4"] = _write_video(folder / "overlay.mp4", n_frames)
    write_manifest(folder / "manifest.json", {**content, "files": files})
    return folder


def smallest_ttc_s(n_frames: int) -> float:
    """What the time of object 1 falls to."""
    return _ttc_s(np.array([n_frames - 1.0]), n_frames)[0]


def _ttc_s(frame: np.ndarray, n_frames: int) -> np.ndarray:
    return np.asarray((n_frames - frame) * DT_S + 0.5)


def _cluster(number: int, frames: pd.DataFrame) -> pd.DataFrame:
    rows = frames[["frame", "t_s"]].assign(cluster_id=number, n_tracks=20, status="ok", state="unknown", **_BOX)
    if number == 0:
        return rows.assign(role="scene")
    ttc_s = _ttc_s(frames.frame.to_numpy(float), len(frames))
    rows = rows.assign(role="object", miss_s=0.2, miss_lo_s=0.1, miss_hi_s=0.3)
    rows = rows.assign(ttc_z_s=ttc_s, ttc_z_lo_s=0.9 * ttc_s, ttc_z_hi_s=1.2 * ttc_s)
    rows = rows.assign(tcpa_s=ttc_s, tcpa_lo_s=0.9 * ttc_s, tcpa_hi_s=1.2 * ttc_s)
    if number == 2:
        return rows.assign(ttc_z_hi_s=-50.0)
    return rows.assign(state="approaching" if number == 1 else "no_relative_motion")


def _write_video(path: Path, n_frames: int) -> int:
    with OverlayVideo(path, SIZE, DT_S, "ultrafast", 24) as video:
        for frame in range(n_frames):
            picture = np.full((SIZE.height_px, SIZE.width_px, 3), 3 * frame % 256, dtype=np.uint8)
            video.write(picture, frame * DT_S)
    return path.stat().st_size
