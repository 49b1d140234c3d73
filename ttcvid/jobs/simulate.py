"""From a scene file to a folder: clip or tracks, calibration files, truth."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from ttcvid.calibration.own import write_camera
from ttcvid.errors import OutputError
from ttcvid.simulate import (
    Encounter,
    Rendered,
    Renderer,
    Scene,
    TrackOptions,
    World,
    build_world,
    encounters,
    load_scene,
    tracks_of,
)
from ttcvid.simulate.poses import mean_horizon_px
from ttcvid.simulate.tables import (
    TRUTH_TABLES,
    encounter_columns,
    frame_columns,
    object_rows,
    track_columns,
    truth_table,
)
from ttcvid.sinks.failures import output_errors
from ttcvid.sinks.video import OverlayVideo, check_video

CLIP_PRESET = "veryfast"
"""With the scene's own crf of 12 it changes the flow that KLT sees by 0.05 px (median)."""
MARKER_NAME = "scene.yaml"
"""The scene, as simulated: a folder that holds it and truth_frames is a simulation and may be overwritten."""
SIMULATION_NAMES = frozenset(
    [MARKER_NAME, "camera.yaml", "horizon.yaml", "clip.mp4", "frames", "timestamps.txt", "truth_labels"]
    + [f"{name}.parquet" for name in TRUTH_TABLES]
)
"""All that such a folder may hold: it is replaced as a whole."""


@dataclass(frozen=True)
class Simulation:
    """What was written: the folder, how many pictures and objects, and what kind of input it holds for analysis."""

    folder: Path
    name: str
    input: Path
    n_frames: int
    n_objects: int
    n_observations: int | None = None


def simulate(
    scene_path: str | Path,
    out: str | Path | None = None,
    *,
    png: bool = False,
    tracks: TrackOptions | None = None,
    seed: int | None = None,
    n_frames: int | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Simulation:
    """Simulate a scene file into a folder.

    Parameters
    ----------
    scene_path : The scene file.
    out : The folder; default ``NAME_scene`` of the scene file's name, in the working directory.
    png : Loss-free pictures in ``frames/`` with ``timestamps.txt`` instead of ``clip.mp4``.
    tracks : Point tracks instead of pictures.
    seed : Instead of the scene's own: other textures, noise and tracks, the same motion but for the jitter.
    n_frames : Only the first pictures of the scene.
    overwrite : Replace the folder of a former simulation.
    progress : Called with (pictures done, pictures in all).

    Returns
    -------
    `Simulation`: the folder, the ``input`` for `ttcvid.analyze`, numbers of frames and objects.

    Raises
    ------
    UsageError
        The scene file is not valid.
    OutputError
        The folder exists, is to be replaced but holds something else, or cannot be written.
    """
    scene = load_scene(scene_path)
    if seed is not None:
        scene = scene.model_copy(update={"seed": seed})
    if n_frames is not None:
        scene = _shortened(scene, n_frames)
    target = Path(f"{Path(scene_path).stem}_scene" if out is None else out)
    _check_target(target, overwrite)
    partial = _beside(target, "partial")
    with output_errors(target):
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        try:
            world, met = build_world(scene), encounters(scene)
            n_observations = write_simulation(world, met, partial, png=png, tracks=tracks, progress=progress)
            _publish(partial, target)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    input_name = "tracks.parquet" if tracks is not None else "frames" if png else "clip.mp4"
    return Simulation(target, scene.name, target / input_name, world.n_frames, len(met), n_observations)


def write_simulation(
    world: World,
    met: Sequence[Encounter],
    folder: Path,
    *,
    png: bool = False,
    tracks: TrackOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> int | None:
    """Write what is seen and true of a world, and whom it meets, into an empty folder; number of observations.

    For worlds that no scene file can describe; `simulate` checks its scene and leaves nothing half done.
    """
    scene = world.scene
    _write_calibration(world, folder)
    _write_table("truth_frames", frame_columns(world), scene, folder)
    _write_table("truth_encounters", encounter_columns(met), scene, folder)
    content = scene.model_dump(mode="json", exclude_none=True)
    (folder / MARKER_NAME).write_text(yaml.dump(content, Dumper=_DUMPER, sort_keys=False))
    if tracks is not None:
        columns = track_columns(tracks_of(world, tracks))
        for name in ("tracks", "truth_tracks"):
            _write_table(name, columns, scene, folder)
        return len(columns["frame"])
    input_name = "frames" if png else "clip.mp4"
    with _PictureFolder(folder, world) if png else _Clip(folder / input_name, world) as pictures:
        _write_pictures(world, folder, pictures.write, progress or (lambda done, total: None))
    if not png:
        check_video(folder / input_name)
    return None


_DUMPER = yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper
"""The same text, several times as fast where PyYAML was built with its library."""


def _write_pictures(
    world: World, folder: Path, write: Callable[[Rendered], None], progress: Callable[[int, int], None]
) -> None:
    """Render all pictures; writes them, ``truth_labels/`` and ``truth_objects``."""
    renderer = Renderer(world)
    (folder / "truth_labels").mkdir()
    rows: list[tuple[Any, ...]] = []
    for frame in range(world.n_frames):
        rendered = renderer.render(frame)
        write(rendered)
        _write_png(folder / "truth_labels" / f"{frame:06d}.png", rendered.labels)
        rows.extend(object_rows(rendered))
        progress(frame + 1, world.n_frames)
    names = [column.name for column in TRUTH_TABLES["truth_objects"]]
    columns = {name: [row[k] for row in rows] for k, name in enumerate(names)}
    _write_table("truth_objects", columns, world.scene, folder)


class _Clip:
    """The pictures as H.264."""

    def __init__(self, path: Path, world: World) -> None:
        times = world.path.t_s
        crf = world.scene.picture.codec_crf
        nominal_dt_s = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
        self._video = OverlayVideo(path, world.camera.image_size, nominal_dt_s, CLIP_PRESET, crf)

    def write(self, rendered: Rendered) -> None:
        self._video.write(rendered.bgr, rendered.t_s)

    def __enter__(self) -> _Clip:
        return self

    def __exit__(self, *error: object) -> None:
        self._video.close()


class _PictureFolder:
    """The pictures without loss, and their times."""

    def __init__(self, folder: Path, world: World) -> None:
        self._frames = folder / "frames"
        self._frames.mkdir()
        _write_lines(folder / "timestamps.txt", (f"{t:.9f}" for t in world.path.t_s))

    def write(self, rendered: Rendered) -> None:
        _write_png(self._frames / f"{rendered.frame:06d}.png", rendered.bgr)

    def __enter__(self) -> _PictureFolder:
        return self

    def __exit__(self, *error: object) -> None:
        pass


def _write_calibration(world: World, folder: Path) -> None:
    camera = world.camera
    left, right = mean_horizon_px(world.scene)
    size = [camera.image_size.width_px, camera.image_size.height_px]
    write_camera(folder / "camera.yaml", camera)
    horizon = {"image_size": size, "horizon": {"y_left_px": left, "y_right_px": right}}
    (folder / "horizon.yaml").write_text(yaml.dump(horizon, Dumper=_DUMPER, sort_keys=False))


def _write_table(name: str, columns: dict[str, Any], scene: Scene, folder: Path) -> None:
    table: pa.Table = truth_table(name, columns, scene)
    with (folder / f"{name}.parquet").open("wb") as file:  # pyarrow takes no name that is not UTF-8
        pq.write_table(table, file, compression="zstd")


def _write_png(path: Path, picture: np.ndarray[Any, Any]) -> None:
    _, content = cv2.imencode(".png", picture)
    path.write_bytes(content.tobytes())


def _write_lines(path: Path, lines: Iterable[str]) -> None:
    path.write_text("".join(f"{line}\n" for line in lines))


def _shortened(scene: Scene, n_frames: int) -> Scene:
    """The same scene with its first pictures only."""
    times = tuple(scene.camera.frame_times_s()[:n_frames].tolist())
    camera = scene.camera.model_copy(update={"times_s": times, "fps": None, "n_frames": None})
    return scene.model_copy(update={"camera": camera})


def _check_target(target: Path, overwrite: bool) -> None:
    """OutputError unless ``target`` is free, or a folder that may be replaced: empty, or all of it of a simulation."""
    if not os.path.lexists(target):
        return
    if not overwrite:
        raise OutputError(f"{target}: exists already; choose another folder with -o, or replace it with --overwrite")
    if target.is_symlink() or not target.is_dir():
        raise OutputError(f"{target}: is no folder but a link or a file, so it is kept: choose another one with -o")
    names = set(os.listdir(target))
    if names and not names >= {MARKER_NAME, "truth_frames.parquet"}:
        raise OutputError(
            f"{target}: is no folder of a simulation (it has no {MARKER_NAME} and truth_frames.parquet), so "
            "--overwrite does not touch it; choose another folder with -o"
        )
    foreign = sorted(names - SIMULATION_NAMES)
    if foreign:
        raise OutputError(
            f"{target / foreign[0]}: not a file of a simulation, and --overwrite replaces the whole folder: move it "
            "away, or choose another folder with -o"
        )


def _publish(partial: Path, target: Path) -> None:
    """Give the finished folder its name; a former one is moved aside first, then removed."""
    former = _beside(target, "former")
    shutil.rmtree(former, ignore_errors=True)
    if target.exists():
        target.rename(former)
    partial.rename(target)
    shutil.rmtree(former, ignore_errors=True)


def _beside(target: Path, what: str) -> Path:
    """A hidden name next to the folder, on the same file system."""
    place = target.absolute()
    return place.with_name(f".{place.name}.{what}")
