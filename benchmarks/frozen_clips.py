"""The clips of a freeze, and their tracked points kept on disk, so that geometry alone is run again."""

from __future__ import annotations

import ast
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from clips import CLIPS, TABLE_OPTIONS
from report import REPOSITORY
from runs import data_folder
from scenario_suite.drawing import drawn, input_of
from scenario_suite.families import FAMILIES, scenario
from scenario_suite.running import options_of

import ttcvid
from ttcvid.jobs.clip import open_clip, read_calibration
from ttcvid.jobs.settings.configuration import configure_from_arguments
from ttcvid.model import Frame, FrameStatus, ImageSize, PointSet
from ttcvid.stages.tracking.tracked_frames import TrackedFrame, track_frames

MOST_FRAMES = 60
"""So many frames of each clip: enough for whole windows (40), births and deaths of objects, and warnings."""
N_TABLES = 200
_SCENES = REPOSITORY / "sample_configs" / "scenes"
_PLATFORM_OF_SCENE = {
    "aircraft_head_on": "aircraft",
    "aircraft_passing": "aircraft",
    "drone_among_posts": "free",
    "resting_six_movers": "static",
}


@dataclass(frozen=True)
class FrozenClip:
    """One analysis of a freeze.

    ``input_of`` makes its input in a folder and returns it with the options of the analysis that belong to it;
    ``tracks`` names the tracked points, which clips that differ in ``options`` alone share.
    """

    name: str
    tracks: str
    input_of: Callable[[Path], tuple[Path, dict[str, Any]]]
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Tracked:
    """Tracked points of a clip, and what else of its source the analysis has to know."""

    image_size: ImageSize
    nominal_dt_s: float
    options: dict[str, Any]
    frames: list[TrackedFrame]


@cache
def frozen_clips() -> dict[str, FrozenClip]:
    """All clips by name, the real ones first."""
    real = [_real(clip.name, clip.path, _keywords(clip.options)) for clip in CLIPS]
    camera = {"camera": "kitti_odom_straight50/calib.txt", "fps": 10.0, "platform": "vehicle"}
    real.append(_real("kitti_odom_straight50", "kitti_odom_straight50/image_0", camera))
    real.append(_real("tud_stadtmitte", "tud_stadtmitte/TUD-Stadtmitte.mp4", {"platform": "static"}))
    drives = sorted((data_folder() / "dashcam").glob("*.mp4"))
    real += [_real(path.stem, f"dashcam/{path.name}", {"platform": "vehicle"}) for path in drives]
    tables = sorted((data_folder() / "kt3dmoseg").glob("*.tracks.parquet"))
    real += [_real(path.name.split(".")[0], f"kt3dmoseg/{path.name}", _keywords(TABLE_OPTIONS)) for path in tables]
    scenes = [_scene(path) for path in sorted(_SCENES.glob("*.yaml"))]
    by_name = {clip.name: clip for clip in real + scenes}
    ways = [
        _otherwise(by_name["kitti_sfnd_ttc"], "smooth", collision_times={"smooth": True}),
        _otherwise(by_name["kitti_sfnd_ttc"], "two-frame", collision_times={"estimator": "two-frame"}),
        _otherwise(by_name["kitti_sfnd_ttc"], "three-frame", collision_times={"estimator": "three-frame"}),
        _scene(_SCENES / "demo.yaml", "horizon"),
        _otherwise(by_name["demo"], "smooth", collision_times={"smooth": True}),
    ]
    return {clip.name: clip for clip in (*real, *scenes, *ways, *_drawn_tables())}


def tracked_of(clip: FrozenClip, folder: Path) -> Tracked:
    """The tracked points of a clip: from ``folder`` where they are kept there, else tracked and put there."""
    path = folder / f"{clip.tracks}.npz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        # Two processes may track the same clip, to be analysed in two ways.
        tracked = _track(clip, folder / f"inputs.{os.getpid()}" / clip.tracks)
        partial = path.with_suffix(f".{os.getpid()}.npz")
        np.savez_compressed(partial, **_arrays_of(tracked))
        partial.rename(path)
    with np.load(path, allow_pickle=False) as arrays:
        return _tracked_from(dict(arrays))


def _track(clip: FrozenClip, folder: Path) -> Tracked:
    cv2.setNumThreads(1)
    folder.mkdir(parents=True, exist_ok=True)
    input_, options = clip.input_of(folder)
    configuration = configure_from_arguments({**options, "end": MOST_FRAMES})
    with open_clip(str(input_), configuration.options) as source:
        calibration = read_calibration(configuration.options, source.info.image_size)
        tracked = track_frames(source, configuration.pipeline.tracking, calibration.mask)
        frames = list(islice(tracked, MOST_FRAMES))
        return Tracked(source.info.image_size, source.info.nominal_dt_s, options, frames)


def _arrays_of(tracked: Tracked) -> dict[str, Any]:
    """Plain arrays, which a later state of the code can read whatever its types are called."""
    arrays: dict[str, Any] = {
        "image_size": np.array([tracked.image_size.width_px, tracked.image_size.height_px]),
        "nominal_dt_s": np.array(tracked.nominal_dt_s),
        "options": np.array(repr(tracked.options)),
        "frame": np.array([item.frame.index for item in tracked.frames]),
        "t_s": np.array([item.frame.t_s for item in tracked.frames]),
        "status": np.array([item.status.value for item in tracked.frames]),
        "is_from_table": np.array([item.frame.points is not None for item in tracked.frames]),
    }
    for i, item in enumerate(tracked.frames):
        points = item.points
        parts = {"id": points.track_id, "xy": points.xy_px, "window": points.window_px}
        arrays[f"common_{i}"] = np.array(points.common_error_px)
        arrays |= {f"{name}_{i}": part for name, part in parts.items() if part is not None}
    return arrays


def _tracked_from(arrays: Mapping[str, Any]) -> Tracked:
    frames = []
    columns = zip(arrays["frame"], arrays["t_s"], arrays["status"], arrays["is_from_table"], strict=True)
    for i, (index, t_s, status, is_from_table) in enumerate(columns):
        points = PointSet(
            arrays[f"id_{i}"],
            arrays[f"xy_{i}"],
            window_px=arrays.get(f"window_{i}"),
            common_error_px=float(arrays[f"common_{i}"]),
        )
        frame = Frame(int(index), float(t_s), points=points if is_from_table else None)
        frames.append(TrackedFrame(frame, points, FrameStatus(str(status))))
    # Numbers, texts and mappings of them: what `repr` has written.
    options = ast.literal_eval(str(arrays["options"]))
    width, height = map(int, arrays["image_size"])
    return Tracked(ImageSize(width, height), float(arrays["nominal_dt_s"]), options, frames)


def _real(name: str, path: str, options: dict[str, Any]) -> FrozenClip:
    data = data_folder()
    if "camera" in options:
        options = options | {"camera": str(data / options["camera"])}
    return FrozenClip(name, name, lambda _: (data / path, options))


def _scene(path: Path, *files: str) -> FrozenClip:
    """A sample scene, with the camera and other calibration ``files`` that its simulation writes."""

    def rendered(folder: Path) -> tuple[Path, dict[str, Any]]:
        out = folder / "truth"
        ttcvid.simulate(path, out, n_frames=MOST_FRAMES, overwrite=True)
        platform = _PLATFORM_OF_SCENE.get(path.stem, "vehicle")
        given = {name: str(out / f"{name}.yaml") for name in ("camera", *files)}
        return out / "clip.mp4", {**given, "platform": platform}

    name = "_".join((path.stem, *files))
    return FrozenClip(name, name, rendered)


def _otherwise(clip: FrozenClip, way: str, **options: Any) -> FrozenClip:
    return FrozenClip(f"{clip.name}_{way}", clip.tracks, clip.input_of, options)


def _drawn_tables() -> Iterator[FrozenClip]:
    """Track tables of the scenario suite, one of each family in turn."""
    names = [name for name, family in FAMILIES.items() if "tracks" in family.kinds]
    for seed, name in islice(((seed, name) for seed in range(N_TABLES) for name in names), N_TABLES):
        yield _drawn_table(name, seed)


def _drawn_table(family: str, seed: int) -> FrozenClip:
    def table(folder: Path) -> tuple[Path, dict[str, Any]]:
        chosen = scenario(family, seed, "tracks")
        truth = drawn(chosen, folder)
        return input_of(truth), options_of(chosen, truth)

    name = f"table_{family}_{seed}"
    return FrozenClip(name, name, table)


def _keywords(words: tuple[str, ...]) -> dict[str, Any]:
    """Options as on the command line, each with its value, as Python arguments."""
    named = dict(zip(words[::2], words[1::2], strict=True))
    return {
        name.lstrip("-").replace("-", "_"): float(value) if name == "--fps" else value for name, value in named.items()
    }
