"""Reading scene files: every mistake becomes one line that names file, field, value and what was expected."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from ttcvid.errors import InputError, UsageError, quoted
from ttcvid.plain_files import read_plain
from ttcvid.simulate.scene import Scene
from ttcvid.simulate.shapes import distance_to_parts_m
from ttcvid.simulate.world import World, build_world
from ttcvid.strict_yaml import MAX_BYTES, StrictYamlError, load_yaml


def load_scene(path: str | Path) -> Scene:
    """Read and check a scene file (YAML).

    Raises
    ------
    InputError
        There is no such file, or it cannot be read.
    UsageError
        The file is no YAML, has an unknown key or a value out of bounds, or the camera is inside
        a body in one of its pictures.
    """
    path = Path(path)
    try:
        content = load_yaml(read_plain(path, MAX_BYTES).decode())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): expected a scene file in YAML") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: is not text in UTF-8: expected a scene file in YAML") from error
    except StrictYamlError as error:
        raise UsageError(f"{path}{error.place}: no valid YAML: {error}: mend the file") from error
    if not isinstance(content, dict):
        raise UsageError(f"{path}: expected a mapping with the keys {', '.join(Scene.model_fields)}")
    try:
        scene = Scene.model_validate(content)
    except ValidationError as error:
        raise UsageError(f"{path}: {_one_line(error.errors()[0])}") from error
    _check_camera_is_outside(path, build_world(scene))
    return scene


def _one_line(error: ErrorDetails) -> str:
    """One line of the first mistake that pydantic found."""
    field = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in error["loc"]).lstrip(".")
    if error["type"] == "extra_forbidden":
        known = _known_keys(error["loc"][:-1])
        near = difflib.get_close_matches(str(error["loc"][-1]), known, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(known)}"
        return f"{field}: unknown key, {hint}"
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "missing":
        return f"{field}: missing, expected a value"
    if error["type"] == "value_error":
        return f"{field}: {message}" if field else message
    return f"{field}: got {quoted(error['input'])}; {message[0].lower()}{message[1:]}"


def _known_keys(location: tuple[int | str, ...]) -> list[str]:
    """Keys of the part of the scene that stands at a location."""
    model: type[BaseModel] = Scene
    for part in location:
        if isinstance(part, str):
            model = _model_in(model.model_fields[part].annotation)
    return list(model.model_fields)


def _model_in(annotation: Any) -> type[BaseModel]:
    """The model class inside an annotation such as ``tuple[Body, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(_model_in(inner) for inner in get_args(annotation) if inner is not Ellipsis and inner is not type(None))


def _check_camera_is_outside(path: Path, world: World) -> None:
    for actor in world.actors:
        offset = world.path.position_m - actor.path.position_m
        inside = np.einsum("nji,nj->ni", actor.path.road_R_body, offset)
        frames = np.flatnonzero(distance_to_parts_m(actor.parts, inside) <= 0)
        if len(frames):
            x, y, z = actor.path.position_m[frames[0]].round(2).tolist()
            raise UsageError(
                f"{path}: bodies: the camera is inside {actor.name!r} in frame {frames[0]}, when that is at "
                f"({x}, {y}, {z}) m; expected the camera outside of all bodies: move one or end the clip earlier"
            )
