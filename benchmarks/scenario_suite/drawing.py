"""A scenario as a folder of truth: what ``ttcvid simulate`` writes, and the camera as the analysis is told it."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from scenario_suite.families.recorded import recorded_world
from scenario_suite.scenario import Scenario
from ttcvid.calibration.own import write_camera
from ttcvid.jobs.simulate import write_simulation
from ttcvid.simulate import TrackOptions, build_world, camera_of, encounters, encounters_in
from ttcvid.simulate.encounters import STEP_S
from ttcvid.simulate.world import STATIC_LABEL, World

N_TRACKS, MIN_PER_OBJECT = 104, 16
"""Few tracks: a table is analysed in a second. ``MIN_PER_OBJECT`` more for each object of the scene: of 120 in all,
eight walkers would leave none for what stands still, and nothing would tell how the camera moves."""
GIVEN_CAMERA_NAME = "camera_given.yaml"
"""The camera with the error of the focal length; absent where the camera is unknown to the analysis."""
_SIMULATOR = Path(__file__).resolve().parents[2] / "ttcvid" / "simulate"


def drawn(scenario: Scenario, folder: Path) -> Path:
    """The truth of a scenario in a folder of its own, drawn unless it is there and whole."""
    marker = folder / "drawn.json"
    if not is_drawn(scenario, folder):
        marker.unlink(missing_ok=True)
        folder.mkdir(parents=True, exist_ok=True)
        _draw(scenario, folder)
        write_json(marker, {"key": drawing_key(scenario)})
    return folder / "truth"


def is_drawn(scenario: Scenario, folder: Path) -> bool:
    """Whether the truth of a scenario is in its folder and whole."""
    return bool(read_json(folder / "drawn.json").get("key") == drawing_key(scenario))


def drawing_key(scenario: Scenario) -> str:
    """Changes with the scene, with how it is given to the analysis, and with the code that draws it."""
    content = {"scene": scenario.scene.model_dump(mode="json"), **scenario.described()}
    here = Path(__file__).parent
    places = (_SIMULATOR, Path(__file__), here / "families" / "recorded.py")
    code = "".join(map(code_digest, places if scenario.recording else places[:2]))
    return hashlib.sha256((json.dumps(content, sort_keys=True, default=str) + code).encode()).hexdigest()


@cache
def code_digest(place: Path, *, without: tuple[str, ...] = ()) -> str:
    """Digest of the Python files of a folder (or of one file), those of the folders ``without`` left out.

    Read once a process: what it runs is what it imported at its start.
    """
    digest = hashlib.sha256()
    files = [place] if place.is_file() else sorted(place.rglob("*.py"))
    for file in files:
        if not set(without) & set(file.relative_to(place).parts):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def input_of(truth: Path) -> Path:
    """What is to be analysed of a drawn scenario."""
    clip = truth / "clip.mp4"
    return clip if clip.exists() else truth / "tracks.parquet"


def _draw(scenario: Scenario, folder: Path) -> None:
    # Whole or not at all, also where two processes draw the same.
    truth = folder / f"truth.{os.getpid()}"
    shutil.rmtree(truth, ignore_errors=True)
    truth.mkdir(parents=True)
    scene = scenario.scene
    if scenario.recording is None:
        world, met = build_world(scene), encounters(scene)
    else:
        world = recorded_world(scene, scenario.recording)
        every_s = np.arange(0.0, float(world.path.t_s[-1]), STEP_S)
        met = encounters_in(recorded_world(scene, scenario.recording, every_s))
    write_simulation(world, met, truth, tracks=_track_options(scenario, world))
    if scenario.camera_known:
        camera = camera_of(scenario.scene)
        wrong = 1.0 + scenario.focal_error
        given = replace(camera, fx_px=camera.fx_px * wrong, fy_px=camera.fy_px * wrong)
        write_camera(truth / GIVEN_CAMERA_NAME, given)
    shutil.rmtree(folder / "truth", ignore_errors=True)
    truth.rename(folder / "truth")


def _track_options(scenario: Scenario, world: World) -> TrackOptions | None:
    if scenario.kind == "video":
        return None
    n_objects = np.count_nonzero(np.unique(world.object_ids) != STATIC_LABEL)
    values = {name: value for name, value in scenario.nuisances.items() if isinstance(value, float)}
    return TrackOptions(
        n_tracks=N_TRACKS + MIN_PER_OBJECT * n_objects,
        min_per_object=MIN_PER_OBJECT,
        sigma_px=values["track_noise_px"],
        outlier_fraction=values["outlier_share"],
        death_rate=1.0 / values["track_length_frames"],
    )


def read_json(path: Path) -> dict[str, Any]:
    """Content of a file; empty where there is none or where it is broken off."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, json.JSONDecodeError):
        return {}
    return dict(content)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a file whole or not at all."""
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    partial.replace(path)
