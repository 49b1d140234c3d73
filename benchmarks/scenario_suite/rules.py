"""The special rules of the analysis, each of which can be switched off for a trial: nothing in the package changes.

A rule is switched off by putting something in place of its function, in every module that has imported it, that does
what the analysis would do without it: finds nothing, changes nothing.

A rule acts in an analysis if, at least once, it gives something else than what stands in its place. Where it never
does, the analysis is the same with it and without it, and need not be made twice.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass, is_dataclass
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import ttcvid
from ttcvid.stages.segmentation import expansion, obstacles, surface_memory
from ttcvid.stages.segmentation.ground_contact import Contacts
from ttcvid.stages.tracking.static_overlays import FrozenMemory

_PACKAGE = Path(ttcvid.__file__).parent
RULES_FILE = Path(__file__)


@dataclass(frozen=True)
class Rule:
    """A rule: what it is for, the group that it belongs to, and what stands in place of which names without it.

    ``instead`` has ``module.name`` below ``ttcvid`` and the value that is put there; ``files`` are what it costs, and
    where it has none of its own its functions are.
    """

    title: str
    group: str
    instead: dict[str, Any]
    files: tuple[str, ...]

    @property
    def n_lines(self) -> int:
        """Lines of its files, or of its functions."""
        if self.files:
            return sum(len((_PACKAGE / file).read_text(encoding="utf-8").splitlines()) for file in self.files)
        return sum(
            len(inspect.getsource(inspect.unwrap(getattr(*_home(place)))).splitlines()) for place in self.instead
        )


def _no_contacts(xy_px: Any, link_px: Any, fit: Any, key: Any, *_: Any) -> Contacts:
    # All tracks of our own car's front: none is under the road by itself, either.
    none, every = np.zeros(0, dtype=bool), np.ones(len(key), dtype=bool)
    return Contacts(np.full(len(key), -1), none, none, every)


def _none_frozen(memory: Any, points: Any, **_: Any) -> tuple[Any, FrozenMemory]:
    n = len(points.track_id)
    return np.zeros(n, dtype=bool), FrozenMemory(points.track_id, points.xy_px, np.zeros(n))


def _no_surfaces_of(function: Callable[..., Any]) -> Callable[..., tuple[dict[int, Any], tuple[Any, ...], int]]:
    """In place of a function that finds surfaces: none, and the next number as it was given."""
    place = list(inspect.signature(function).parameters).index("next_cluster_id")
    return lambda *arguments, **_: ({}, (), arguments[place])


_REMEMBERED = surface_memory.remembered


def _seen_only(*arguments: Any) -> tuple[dict[int, Any], tuple[Any, ...], int]:
    """Surfaces of which none is kept that is not found in this frame."""
    public, memory, next_cluster_id = _REMEMBERED(*arguments)
    seen = tuple(surface for surface in memory if surface.n_missed == 0)
    numbers = {surface.cluster_id for surface in seen}
    return {number: own for number, own in public.items() if number in numbers}, seen, next_cluster_id


def _zeros(place: int) -> Callable[..., Any]:
    """As many False as the argument at a place is long."""
    return lambda *arguments, **_: np.zeros(len(arguments[place]), dtype=bool)


def _none(*_: Any, **__: Any) -> None:
    return None


def _stage(file: str) -> tuple[str, ...]:
    return (f"stages/{file}.py",)


RULES: dict[str, Rule] = {
    "road": Rule(
        "the road under us",
        "ground",
        {"stages.segmentation.road.find_road": _none},
        (*_stage("segmentation/road"), *_stage("segmentation/road_evidence")),
    ),
    "ground_contact": Rule(
        "what would lie under the road or hangs over it moves",
        "ground",
        {"stages.segmentation.ground_contact.find_contacts": _no_contacts},
        _stage("segmentation/ground_contact"),
    ),
    "speed_changes": Rule(
        "what changes its speed along our way stays a mover",
        "ground",
        {"stages.segmentation.speed_changes.change_speed": _zeros(3)},
        _stage("segmentation/speed_changes"),
    ),
    "spreading": Rule(
        "new movers that keep their bearing and spread",
        "births",
        {"stages.segmentation.expansion.expanding_movers": lambda *_, **__: []},
        (),
    ),
    "growing": Rule(
        "what comes straight at us and grows",
        "births",
        {"stages.segmentation.expansion.find_growing": _no_surfaces_of(expansion.find_growing)},
        _stage("segmentation/expansion"),
    ),
    "obstacles": Rule(
        "what stands in our way",
        "births",
        {"stages.segmentation.obstacles.find_obstacles": _no_surfaces_of(obstacles.find_obstacles)},
        _stage("segmentation/obstacles"),
    ),
    "surface_memory": Rule(
        "a surface that is not found in a frame is kept",
        "births",
        {"stages.segmentation.surface_memory.remembered": _seen_only},
        _stage("segmentation/surface_memory"),
    ),
    "fixed_to_camera": Rule(
        "what is fixed to the camera is no mover",
        "bodies",
        {"stages.segmentation.fixed_to_camera.ride_odds": lambda views, *_, **__: np.full(len(views.xy_px), -np.inf)},
        _stage("segmentation/fixed_to_camera"),
    ),
    "drift": Rule(
        "what drifts by no more than tracks err in common is no mover",
        "bodies",
        {"stages.segmentation.common_errors.drift_cost": lambda _, __, count, ___: np.full(count, np.inf)},
        (),
    ),
    "nearer": Rule(
        "what is nearer than the rest of an object is no part of it",
        "bodies",
        {"stages.segmentation.data_association.are_nearer": _zeros(0)},
        (),
    ),
    "turning_movers": Rule(
        "a mover that most of its tracks contradict becomes a turning body",
        "bodies",
        {"stages.segmentation.turning_movers.with_turning_bodies": lambda *a: a[3]},
        _stage("segmentation/turning_movers"),
    ),
    "reidentified": Rule(
        "hidden movers are known again",
        "bodies",
        {"stages.segmentation.reidentification.reidentified": lambda *a: (a[2], a[3], np.zeros(len(a[4]), dtype=bool))},
        _stage("segmentation/reidentification"),
    ),
    "merged": Rule(
        "movers that are one become one",
        "bodies",
        {"stages.segmentation.merges.merged": lambda views, scene, key, movers, *_: (key, movers)},
        _stage("segmentation/merges"),
    ),
    "split": Rule(
        "movers that do not hang together are two",
        "bodies",
        {"stages.segmentation.merges.split": lambda views, key, movers, next_key, _: (key, movers, next_key)},
        _stage("segmentation/merges"),
    ),
    "frozen": Rule(
        "what stays on its pixel is bonnet or text",
        "bodies",
        {"stages.tracking.static_overlays.find_frozen": _none_frozen},
        _stage("tracking/static_overlays"),
    ),
    "fronts": Rule(
        "the front part of an object",
        "times",
        {
            "stages.objects.near_face.front_boxes": lambda members, boxes, joint, *_: boxes[joint.owner],
        },
        _stage("objects/near_face"),
    ),
    "bends": Rule(
        "objects in a bend have paths of their own",
        "times",
        {f"stages.objects.turning.{name}": np.inf for name in ("_ASKED_TURN_RAD_S", "_BEND_CHI2", "_SURE_CHI2")},
        _stage("objects/turning"),
    ),
    "common_errors": Rule(
        "approach has to exceed the tracker's common error",
        "amendments",
        {"stages.segmentation.common_errors.common_covariances": lambda *_: 0.0},
        _stage("segmentation/common_errors"),
    ),
    "own_bend": Rule(
        "our own bend in the course",
        "warnings",
        {"stages.segmentation.own_turn.share_of_bend": lambda turn_rad_s: 0.0},
        _stage("segmentation/own_turn"),
    ),
}
GROUPS: dict[str, tuple[str, ...]] = {
    group: tuple(name for name, rule in RULES.items() if rule.group == group)
    for group in dict.fromkeys(rule.group for rule in RULES.values())
}


@contextmanager
def switched_off(names: Sequence[str], acting: set[str] | None = None) -> Iterator[None]:
    """The analysis without some of its rules, until the block ends.

    Into ``acting`` go the names of rules that give something else, once at least, than without them; of those that
    are switched off, which would.
    """
    changed: list[tuple[Any, str, Any]] = []
    import_module("ttcvid.jobs.analyze.run_analysis")
    try:
        for name, rule in RULES.items():
            for place, without in rule.instead.items():
                if acting is None and name in names:
                    changed += _put(place, without)
                elif acting is not None:
                    former = getattr(*_home(place))
                    one, other = (without, former) if name in names else (former, without)
                    if callable(former):
                        changed += _put(place, _beside(one, other, name, acting))
                    else:
                        acting.add(name)
                        changed += _put(place, one)
        yield
    finally:
        for module, name, value in reversed(changed):
            setattr(module, name, value)


def _beside(one: Callable[..., Any], other: Callable[..., Any], name: str, acting: set[str]) -> Callable[..., Any]:
    """The function ``one``; ``name`` is ``acting`` as soon as ``other`` has another result."""

    @wraps(one)
    def watched(*arguments: Any, **named: Any) -> Any:
        result = one(*arguments, **named)
        if name not in acting and not _same(result, other(*arguments, **named)):
            acting.add(name)
        return result

    return watched


def _same(one: Any, other: Any) -> bool:
    """Whether two results are equal in every number; NaN equals NaN."""
    if one is other:
        return True
    if is_dataclass(one) and not isinstance(one, type):
        return type(one) is type(other) and _same(astuple(one), astuple(other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return list(one) == list(other) and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, np.ndarray | float) and isinstance(other, np.ndarray | float):
        a, b = np.asarray(one), np.asarray(other)
        return a.shape == b.shape and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    return type(one) is type(other) and bool(one == other)


def _home(place: str) -> tuple[Any, str]:
    """The module in which a name stands, and the name."""
    module_name, _, name = place.rpartition(".")
    return import_module(f"ttcvid.{module_name}"), name


def _put(place: str, value: Any) -> list[tuple[Any, str, Any]]:
    """Put a value where a name stands, and everywhere where that has been imported to; what was there."""
    home, name = _home(place)
    former = getattr(home, name)
    # A function is looked for by what it is; a number only where it is at home.
    holders = [home]
    if callable(former):
        loaded = [module for key, module in sys.modules.items() if key.startswith("ttcvid.") and module is not home]
        holders += [module for module in loaded if getattr(module, name, None) is former]
    for holder in holders:
        setattr(holder, name, value)
    return [(holder, name, former) for holder in holders]
