"""Truths small enough to work out by hand, runs that say exactly what is true, and such runs as folders."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ttcvid.schema import TABLES, table_schema
from ttcvid.sinks.manifest import write_manifest
from ttcvid.studies.evaluation.truth import BOX, DIRECTION, ROTATION, RunTables, Truth

DT_S = 0.1
N_FRAMES = 20
TIMES = ("ttc_z_s", "tcpa_s", "miss_s")


def object_rows(object_id: int, box: tuple[float, ...], ttc_z_s: float, name: str = "") -> pd.DataFrame:
    """An object at rest in the picture in every frame, whose time to depth zero falls from ``ttc_z_s`` on."""
    frame = np.arange(N_FRAMES)
    rows = pd.DataFrame({"frame": frame, "t_s": frame * DT_S, "object_id": object_id, "is_counted": True})
    rows = rows.assign(name=name or f"object {object_id}", **dict(zip(BOX, box, strict=True)))
    direction = np.array([0.6, 0.0, -0.8])
    times = {"ttc_z_s": ttc_z_s - frame * DT_S, "tcpa_s": 0.5 * ttc_z_s + 2 - frame * DT_S, "miss_s": 0.5}
    return rows.assign(**times, **dict(zip(DIRECTION, direction, strict=True)))


def two_object_truth() -> Truth:
    """Object 1 collides with us 3 s after the start, object 2 does not; 20 frames of 0.1 s."""
    frame = np.arange(N_FRAMES)
    frames = pd.DataFrame({"frame": frame, "t_s": frame * DT_S})
    frames[ROTATION] = np.where(frame[:, None] > 0, [0.0, 0.01, 0.0], np.nan)
    frames[DIRECTION] = np.where(frame[:, None] > 0, [0.0, 0.0, -1.0], np.nan)
    encounters = pd.DataFrame(
        {"object_id": [1, 2], "name": ["a", "b"], "is_collision": [True, False], "t_contact_s": [3.0, np.nan]}
    )
    objects = pd.concat([object_rows(1, (0, 0, 10, 10), 3.0), object_rows(2, (50, 0, 70, 10), 6.0)], ignore_index=True)
    track_object = np.tile([0, 0, 1, 1, 1, 1, 2, 2, 2, 2], N_FRAMES)
    return Truth(objects, frames, encounters, None, track_object)


def perfect_run(truth: Truth, tracks: pd.DataFrame | None = None) -> RunTables:
    """The run that says exactly what is true, with intervals of 1 % around it; cluster_id is object_id.

    Without ``tracks``, each frame has the same tracks, which lie on ``truth.track_object``.
    """
    assert truth.objects is not None
    assert truth.frames is not None
    assert truth.encounters is not None
    assert truth.track_object is not None
    clusters = truth.objects.rename(columns={"object_id": "cluster_id"}).reset_index(drop=True)
    clusters = clusters.assign(role="object", motion_id=clusters.cluster_id)
    for name in TIMES:
        stem, reach = name.removesuffix("_s"), 0.01 * clusters[name].abs()
        clusters[f"{stem}_lo_s"], clusters[f"{stem}_hi_s"] = clusters[name] - reach, clusters[name] + reach
    scene = truth.frames[["frame", "t_s", *DIRECTION]].assign(cluster_id=0)
    epipoles = pd.concat([scene, clusters[["frame", "t_s", "cluster_id", *DIRECTION]]], ignore_index=True)
    clusters = clusters.drop(columns=[*DIRECTION, "name", "is_counted"])
    if tracks is None:
        n_tracks = len(truth.track_object) // len(truth.frames)
        frame = truth.frames.frame.repeat(n_tracks).to_numpy()
        tracks = pd.DataFrame({"frame": frame, "track_id": np.tile(np.arange(n_tracks), len(truth.frames))})
    tracks = tracks.assign(cluster_id=np.maximum(truth.track_object, 0))
    hits = truth.encounters[truth.encounters.is_collision.astype(bool)]
    events = pd.DataFrame(
        {
            "cluster_id": hits.object_id.astype(int),
            "start_frame": min(2, len(truth.frames) - 1),
            "end_frame": len(truth.frames) - 1,
            "start_s": 2 * DT_S,
        }
    )
    return RunTables(truth.frames, clusters, epipoles, tracks, events.reset_index(drop=True))


def manifest_of_run(image_size: tuple[int, int] = (640, 360), **changes: object) -> dict[str, object]:
    """What the manifest of a run has to say at the least."""
    size = {"width_px": image_size[0], "height_px": image_size[1]}
    lens = {"distortion_model": "none", "distortion": [], "origin": "hfov_deg", "is_assumed": False}
    camera = {"fx_px": 500.0, "fy_px": 500.0, "cx_px": 319.5, "cy_px": 179.5, "image_size": size, **lens}
    return {
        "state": "complete",
        "versions": {},
        "configuration": {"analyze": {"stride": {"value": 1}}, "egomotion": {"platform": {"value": "vehicle"}}},
        "input": {"nominal_dt_s": DT_S, "sha256": "", "n_files": 1, "kind": "images"},
        "camera": camera,
        "horizon": None,
        "image_size": size,
        "platform": {"value": "vehicle", "is_told_by_clip": False, "reason": "given", "glances": []},
        "counts": {"frames": 1, "track_rows": 0, "objects": 0, "events": 0, "skipped_packets": 0},
        "nearest": None,
        "timings": {"total_s": 1.0, "frames_per_s": 1.0},
        "limits": [],
        "warnings": [],
        **changes,
    }


def write_run(folder: Path, run: RunTables) -> Path:
    """The run as the folder that ``ttcvid analyze`` writes; what a table does not hold becomes null or zero."""
    folder.mkdir()
    for name in TABLES:
        given, columns = getattr(run, name), {}
        for field in table_schema(name):
            fill = None if field.nullable else _zero(field.type)
            columns[field.name] = given[field.name] if field.name in given else [fill] * len(given)
        arrays = [pa.array(columns[f.name], type=_storage(f.type), from_pandas=True) for f in table_schema(name)]
        arrays = [array.cast(f.type) for array, f in zip(arrays, table_schema(name), strict=True)]
        pq.write_table(pa.Table.from_arrays(arrays, schema=table_schema(name)), folder / f"{name}.parquet")
    write_manifest(folder / "manifest.json", manifest_of_run())
    return folder


def _storage(kind: pa.DataType) -> pa.DataType:
    return pa.string() if pa.types.is_dictionary(kind) else kind


def _zero(kind: pa.DataType) -> str | int | float:
    if pa.types.is_dictionary(kind) or pa.types.is_string(kind):
        return "ok"
    return 0
