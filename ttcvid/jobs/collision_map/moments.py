"""The moments of a clip that collision maps are made of."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ttcvid.config import CollisionMapConfig
from ttcvid.model import Floats, Ints
from ttcvid.studies.collision_map.evasion import EvasionStatus
from ttcvid.studies.collision_map.hazards import OwnBody, Situation

_OWN_SIZE_M = (1.8, 4.5, 1.5)
"""Width, length and height of a car, its height half above and half below the camera."""


@dataclass(frozen=True)
class Moment:
    """What is known of one frame; without a ``situation``, ``status`` says why.

    ``unlinked`` are the names of objects of unknown distance and speed; ``notes`` say what the map rests on;
    ``is_scene_known`` whether what stands still would be seen, and ``course_rad`` the courses, from ahead to the right,
    along which it would.
    """

    situation: Situation | None
    status: EvasionStatus = EvasionStatus.no_danger
    unlinked: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    is_scene_known: bool = True
    course_rad: tuple[float, float] = (-math.pi, math.pi)


@dataclass(frozen=True)
class Clip:
    """All frames of a scene or of a run: ``frame (N,)``, ``t_s (N,)``, and what is known of the n-th."""

    name: str
    frame: Ints
    t_s: Floats
    moment: Callable[[int], Moment]
    sources: tuple[Path, ...] = ()


def own_body(config: CollisionMapConfig, default: OwnBody | None = None) -> OwnBody:
    """Our outline as configured; where nothing of it is, ``default``."""
    given = (config.width_m, config.length_m, config.height_m)
    if default is not None and given == (None, None, None):
        return default
    width, length, height = (size if v is None else v for v, size in zip(given, _OWN_SIZE_M, strict=True))
    return OwnBody(width, length, height)
