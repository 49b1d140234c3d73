"""What a manifest says of a run: what it was made of, what came out, and how long it took."""

from __future__ import annotations

import hashlib
import math
import os
import platform
import threading
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import av
import cv2
import numba
import numpy as np
import pyarrow as pa
import scipy

import ttcvid
from ttcvid.errors import InputError, counted
from ttcvid.jobs.analyze.limits import LimitWatch
from ttcvid.jobs.clip import Calibration
from ttcvid.jobs.settings.options import AUTO_HORIZON, PATH_OPTIONS, AnalyzeOptions
from ttcvid.model import (
    SCENE_CLUSTER,
    SCENE_MOTION,
    Camera,
    ClusterRow,
    FrameResult,
    FrameStatus,
    SourceInfo,
    SourceReport,
)
from ttcvid.stages.horizon.watch import MoverOffset, own_offset_px


def versions() -> dict[str, str]:
    """Versions of everything that the numbers can depend on."""
    return {
        "ttcvid": ttcvid.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "numba": numba.__version__,
        "opencv": cv2.__version__,
        "av": av.__version__,
        "pyarrow": pa.__version__,
        "pandas": metadata.version("pandas"),
    }


@dataclass(frozen=True)
class Digest:
    """``sha256`` of one file as ``sha256sum`` gives it; of several, over their names and contents in order."""

    sha256: str
    size_bytes: int


def digest_in_background(files: tuple[Path, ...]) -> Future[Digest]:
    """Hash the input in a thread beside the analysis; a program that ends does not wait for it.

    Whatever goes wrong there is raised where the result is asked for: nobody would hear of it otherwise, and who waits
    for a result would wait for ever.
    """
    future: Future[Digest] = Future()

    def work() -> None:
        try:
            future.set_result(digest_of(files))
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=work, name="ttcvid-hash", daemon=True).start()
    return future


def digest_of(files: tuple[Path, ...]) -> Digest:
    """Hash the files of an input; InputError where one cannot be read any more."""
    total = hashlib.sha256()
    size_bytes = 0
    sha256 = ""
    for file in files:
        try:
            with file.open("rb") as stream:
                sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
            size_bytes += file.stat().st_size
        except OSError as error:
            raise InputError(f"{file}: cannot be read ({error.strerror}): leave the input alone meanwhile") from None
        total.update(os.fsencode(file.name) + f"\0{sha256}\0".encode())
    return Digest(sha256 if len(files) == 1 else total.hexdigest(), size_bytes)


def describe_option_files(options: AnalyzeOptions) -> dict[str, dict[str, str]]:
    """Name and hash of each file that an option names: two runs with the same ones were told the same.

    InputError where one cannot be read.
    """
    paths = {
        name: getattr(options, name) for name in PATH_OPTIONS if (name, str(getattr(options, name))) != AUTO_HORIZON
    }
    return {
        name: {"name": path.name, "sha256": digest_of((path,)).sha256}
        for name, path in paths.items()
        if path is not None
    }


# Frames that tell motion since another one, see `Tally.complaint_about_repeats`.
_MOVED_ON = (FrameStatus.ok, FrameStatus.rotation_only, FrameStatus.static)
# From this part of the pictures on repeated ones are the way a clip was made; steps that differ by so much are uneven.
_MANY_REPEATED, _UNEVEN = 0.05, 0.25
# Frames farther apart than this, s, are no clip of anything that moves; more than this part of a clip is most of it.
_SLOW_S, _MOSTLY = 2.0, 0.5


@dataclass
class Tally:
    """What an analysis has brought so far."""

    n_frames: int = 0
    n_track_rows: int = 0
    n_cluster_rows: int = 0
    cluster_ids: set[int] = field(default_factory=set)
    event_ids: set[int] = field(default_factory=set)
    nearest: dict[str, Any] | None = None
    own_offset_px: list[float] = field(default_factory=list)
    limits: LimitWatch = field(default_factory=LimitWatch)
    mover_offsets: dict[int, MoverOffset] = field(default_factory=dict)
    n_repeated: int = 0
    n_bad_dt: int = 0
    n_unseen: int = 0
    steps_s: list[float] = field(default_factory=list)
    has_motion: bool = False

    def add(self, result: FrameResult) -> None:
        """Count one frame."""
        self.limits.add(result)
        self.n_frames += 1
        self.n_track_rows += len(result.tracks.track_id)
        self.n_cluster_rows += len(result.clusters)
        self.cluster_ids.update(cluster.cluster_id for cluster in result.clusters)
        self.event_ids.update(event.event_id for event in result.events)
        offset_px = own_offset_px(result)
        if offset_px is not None:
            self.own_offset_px.append(offset_px)
        for cluster in result.clusters:
            if cluster.horizon_offset is not None and cluster.motion_id != SCENE_MOTION:
                self.mover_offsets.setdefault(cluster.cluster_id, MoverOffset()).add(cluster.horizon_offset)
        self.n_repeated += result.status == FrameStatus.duplicate
        self.n_bad_dt += result.status == FrameStatus.bad_dt
        self.n_unseen += result.status in (FrameStatus.few_tracks, FrameStatus.dark)
        if result.status in _MOVED_ON and result.dt_s is not None:
            self.steps_s.append(result.dt_s)
        self.has_motion |= result.status == FrameStatus.ok or any(
            c.cluster_id != SCENE_CLUSTER for c in result.clusters
        )
        if result.nearest is not None:
            self._note_nearest(result, result.nearest)

    def _note_nearest(self, result: FrameResult, nearest: ClusterRow) -> None:
        """Keep the object that is nearer in time than every one before it."""
        times = {name: float(getattr(nearest.times, name)[0]) for name in ("ttc_z_s", "ttc_z_lo_s", "ttc_z_hi_s")}
        if self.nearest is None or times["ttc_z_s"] < self.nearest["ttc_z_s"]:
            self.nearest = {"cluster_id": nearest.cluster_id, "frame": result.frame, "t_s": result.t_s, **times}

    def complaint_about_times(self) -> str:
        """What to say of frames that are not later than the one before, or far apart."""
        if self.n_bad_dt:
            frames = f"{self.n_bad_dt} of {counted(self.n_frames, 'frame')}"
            return (
                f"{frames} have a time that is not later than that of the frame before (status bad_dt), and no "
                "results: look at the times of the input"
            )
        typical_s = float(np.median(self.steps_s)) if self.steps_s else 0.0
        if typical_s > _SLOW_S:
            return (
                f"frames are {typical_s:g} s apart, over which nothing on a road can be followed: are the times of the "
                "input in seconds? (--stride sets them apart as well)"
            )
        return ""

    def complaint_about_sight(self) -> str:
        """What to say of a clip most of which shows too little to tell anything of."""
        if self.n_unseen <= _MOSTLY * self.n_frames:
            return ""
        return (
            f"{self.n_unseen} of {counted(self.n_frames, 'frame')} show too little to tell own motion (status "
            "few_tracks or dark): that nothing was found there does not mean that nothing was there"
        )

    def complaint_about_repeats(self) -> str:
        """What to say of a clip that was converted from another frame rate by repeating pictures unevenly."""
        # Where nothing moves at all, a codec gives some pictures back as they were, and there is no speed to be off.
        if not self.has_motion or not self.steps_s or self.n_repeated < _MANY_REPEATED * self.n_frames:
            return ""
        steps_s = np.array(self.steps_s)
        typical_s = float(np.sort(steps_s)[len(steps_s) // 2])  # one that occurs: of two kinds, no mean of both
        if np.mean(np.abs(steps_s - typical_s) > _UNEVEN * typical_s) < _MANY_REPEATED:
            return ""
        off = abs(float(np.mean(steps_s)) / typical_s - 1.0)
        return (
            f"{self.n_repeated} of {self.n_frames} pictures repeat the one before, at uneven distances: the clip was "
            f"converted from another frame rate, its times are not those of the camera, and speeds and times to "
            f"collision may be off by {100 * off:.0f} %; give the clip as it was recorded, or its true times by "
            f"--timestamps"
        )

    def counts(self, info: SourceInfo, report: SourceReport) -> dict[str, Any]:
        """The counts of the manifest; ``frames_expected`` is what the input promised (null: unknown)."""
        return {
            "frames": self.n_frames,
            "frames_expected": info.n_frames,
            "skipped_packets": report.n_packets_skipped,
            "corrupt_frames": report.n_frames_corrupt,
            "missing_frames": report.n_frames_missing,
            "track_rows": self.n_track_rows,
            "cluster_rows": self.n_cluster_rows,
            "clusters": len(self.cluster_ids),
            "objects": len(self.cluster_ids - {SCENE_CLUSTER}),
            "events": len(self.event_ids),
        }


def describe_input(info: SourceInfo, files: tuple[Path, ...], digest: Digest) -> dict[str, Any]:
    """The input as the manifest has it."""
    return {
        "path": info.path,
        "kind": info.kind,
        "n_files": len(files),
        **asdict(digest),
        "nominal_dt_s": info.nominal_dt_s,
        "time_origin": info.time_origin,
    }


def describe_calibration(calibration: Calibration) -> dict[str, Any]:
    """Camera, horizon and picture size as the manifest has them."""
    horizon = calibration.horizon
    return {
        "camera": _describe_camera(calibration.camera),
        "horizon": None if horizon is None else asdict(horizon),
        "image_size": asdict(calibration.camera.image_size),
    }


def _describe_camera(camera: Camera) -> dict[str, Any]:
    hfov_deg = math.degrees(2 * math.atan(camera.image_size.width_px / (2 * camera.fx_px)))
    return {**asdict(camera), "is_assumed": camera.is_assumed, "undistorted_hfov_deg": hfov_deg}


def table_metadata(calibration: Calibration, configuration: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """What every table says of its making; nothing in it depends on where or when it was made."""
    camera = calibration.camera
    found = {"camera_fx_sigma_px": repr(camera.focal_sigma_px)} if camera.is_found else {}
    return {
        "ttcvid_version": ttcvid.__version__,
        "estimates": "smooth" if configuration["collision_times"]["smooth"]["value"] else "causal",
        "warnings": "causal",
        "camera_origin": Path(camera.origin).name,
        "camera_is_assumed": str(camera.is_assumed).lower(),
        "camera_fx_px": repr(camera.fx_px),
        **found,
        "horizon_in_use": str(calibration.horizon is not None).lower(),
        "tracker": str(configuration["tracking"]["tracker"]["value"]),
        "estimator": str(configuration["collision_times"]["estimator"]["value"]),
        "platform": str(configuration["egomotion"]["platform"]["value"]),
        "seed": str(configuration["analyze"]["seed"]["value"]),
    }
