"""The moments of a clip that a collision map can be made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ttcvid.config import CollisionMapConfig
from ttcvid.errors import InputError, UsageError
from ttcvid.jobs.simulate import MARKER_NAME
from ttcvid.jobs.true_hazards import own_body_of, true_situation
from ttcvid.model import Floats, Ints
from ttcvid.simulate import build_world, load_scene
from ttcvid.sinks.manifest import MANIFEST_NAME
from ttcvid.studies.evasion import EvasionStatus
from ttcvid.studies.hazards import OwnBody, Situation

_OWN_SIZE_M = (1.8, 4.5, 1.5)
"""Width, length and height of a car, above and below the camera alike."""


@dataclass(frozen=True)
class Moment:
    """What is known of one frame; without a ``situation``, ``status`` says why.

    ``families`` are objects of unknown speed: name, and relative place and velocity ``(K, 6)`` in m and m/s for each
    of their possible distances. ``notes`` say what the map rests on.
    """

    situation: Situation | None
    status: EvasionStatus = EvasionStatus.no_danger
    families: tuple[tuple[str, Floats], ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Clip:
    """All frames of a scene or of a run: ``frame (N,)``, ``t_s (N,)``, and what is known of the n-th."""

    name: str
    frame: Ints
    t_s: Floats
    moment: Callable[[int], Moment]
    sources: tuple[Path, ...] = field(default=())


def open_clip_of(path: Path, config: CollisionMapConfig) -> Clip:
    """The frames of a run, of the folder of a simulation (its truth), or of a scene file (its truth).

    Raises
    ------
    InputError
        ``path`` is none of these.
    UsageError
        An option says what a scene knows by itself, or the scene file is not valid.
    """
    if path.is_dir() and (path / MARKER_NAME).is_file():
        return _scene_clip(path / MARKER_NAME, config)
    if path.is_file() and path.suffix in (".yaml", ".yml"):
        return _scene_clip(path, config)
    if path.is_dir() and (path / MANIFEST_NAME).is_file():
        raise UsageError(f"{path}: maps of runs are not there yet")
    what = "holds neither" if path.is_dir() else "is neither a scene file nor a folder with"
    raise InputError(
        f"{path}: {what} manifest.json (a run) nor {MARKER_NAME} (a simulation): give the folder of 'ttcvid analyze' "
        "or 'ttcvid simulate', or a scene file"
    )


def own_body(config: CollisionMapConfig, default: OwnBody | None = None) -> OwnBody:
    """Our outline as configured; where nothing of it is, ``default``."""
    given = (config.width_m, config.length_m, config.height_m)
    if default is not None and given == (None, None, None):
        return default
    width, length, height = (size if v is None else v for v, size in zip(given, _OWN_SIZE_M, strict=True))
    return OwnBody(width, length, height)


def _scene_clip(path: Path, config: CollisionMapConfig) -> Clip:
    for name in ("ego_speed", "camera_height_m", "object_width_m"):
        if getattr(config, name) is not None:
            raise UsageError(f"--{name.replace('_', '-')}: {path} is a scene, which knows it by itself: leave it out")
    scene = load_scene(path)
    world = build_world(scene)
    own = own_body(config, own_body_of(world))
    note = f"From the true places, sizes and motions of scene {scene.name}."
    return Clip(
        scene.name,
        np.arange(world.n_frames),
        world.path.t_s,
        lambda n: Moment(true_situation(world, n, own), notes=(note,)),
        (path,),
    )
