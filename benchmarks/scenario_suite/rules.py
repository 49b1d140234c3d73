"""The special rules of the analysis, each of which can be switched off for a trial: nothing in the package changes.

A rule is switched off by putting something in place of its function, in every module that has imported it, that does
what the analysis would do without it: finds nothing, changes nothing. What the analysis runs beside itself is a copy
of this process, and goes without the rule as well.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import ttcvid
from ttcvid.stages.floating import Floating
from ttcvid.stages.frozen import FrozenMemory

_PACKAGE = Path(ttcvid.__file__).parent


@dataclass(frozen=True)
class Rule:
    """A rule: what it is for, the group that it belongs to, and what stands in place of which names without it.

    ``instead`` has ``module.name`` below ``ttcvid`` and the value that is put there; ``files`` are what it costs.
    """

    title: str
    group: str
    instead: dict[str, Any]
    files: tuple[str, ...]

    @property
    def n_lines(self) -> int:
        """Lines of its files."""
        return sum(len((_PACKAGE / file).read_text(encoding="utf-8").splitlines()) for file in self.files)


def _nothing_floats(xy_px: Any, link_px: Any, fit: Any, key: Any, *_: Any) -> Floating:
    return Floating(np.full(len(key), -1), np.zeros(len(key), dtype=bool), np.full(len(key), -1))


def _none_frozen(memory: Any, points: Any, **_: Any) -> tuple[Any, FrozenMemory]:
    n = len(points.track_id)
    return np.zeros(n, dtype=bool), FrozenMemory(points.track_id, points.xy_px, np.zeros(n))


def _no_surfaces(next_cluster_id: int) -> tuple[dict[int, Any], tuple[Any, ...], int]:
    return {}, (), next_cluster_id


def _as_they_are(sets: Any, rate_hz: Any, *others: Any) -> tuple[Any, ...]:
    is_in = others[6]
    return is_in, np.zeros(len(rate_hz)), np.zeros(len(sets)), np.full((len(sets), 2), np.nan)


def _zeros(place: int) -> Callable[..., Any]:
    """As many False as the argument at a place is long."""
    return lambda *arguments, **_: np.zeros(len(arguments[place]), dtype=bool)


def _first(*arguments: Any, **_: Any) -> Any:
    return arguments[0]


def _none(*_: Any, **__: Any) -> None:
    return None


def _stage(file: str) -> tuple[str, ...]:
    return (f"stages/{file}.py",)


RULES: dict[str, Rule] = {
    "road": Rule(
        "the plane of the road, and what would lie under it",
        "ground",
        {"stages.road.find_road": _none},
        _stage("road"),
    ),
    "floating": Rule(
        "what nothing bears moves", "ground", {"stages.floating.find_floating": _nothing_floats}, _stage("floating")
    ),
    "upper_parts": Rule(
        "above what would lie under the road",
        "ground",
        {"stages.upper_parts.above_under": _zeros(3)},
        _stage("upper_parts"),
    ),
    "slipping": Rule(
        "windows that slip along an edge make no mover",
        "slips",
        {"stages.slipping.may_slip": _zeros(0)},
        _stage("slipping"),
    ),
    "slip_on_road": Rule(
        "the last step's slip on the road is noise",
        "slips",
        {"stages.new_movers._without_slip": lambda views, on_road, misfit: misfit},
        (),
    ),
    "occlusions": Rule(
        "corners of two surfaces make no mover",
        "slips",
        {"stages.occlusions.between_surfaces": _zeros(3)},
        _stage("occlusions"),
    ),
    "spreading": Rule(
        "new movers that keep their bearing and spread",
        "births",
        {"stages.spreading.spreading_things": lambda *_, **__: []},
        _stage("spreading"),
    ),
    "growing": Rule(
        "what comes straight at us and grows",
        "births",
        {"stages.growing.find_growing": lambda *arguments: _no_surfaces(arguments[7])},
        _stage("growing"),
    ),
    "obstacles": Rule(
        "what stands in our way",
        "births",
        {"stages.obstacles.find_obstacles": lambda *arguments, **_: _no_surfaces(arguments[4])},
        _stage("obstacles"),
    ),
    "surface_memory": Rule(
        "a surface that turns out to move keeps its number",
        "births",
        {"stages.surface_memory.number_of_taken": _none},
        _stage("surface_memory"),
    ),
    "begun_anew": Rule(
        "movers that went astray are begun anew",
        "bodies",
        {"stages.begun_anew.begun_anew": lambda movers, rate_hz, *_: (movers, rate_hz)},
        _stage("begun_anew"),
    ),
    "known_again": Rule(
        "hidden movers are known again",
        "bodies",
        {"stages.known_again.known_again": lambda *a: (a[2], a[3], np.zeros(len(a[4]), dtype=bool))},
        _stage("known_again"),
    ),
    "merged": Rule(
        "movers that are one become one",
        "bodies",
        {"stages.joining.merged": lambda views, scene, key, movers, *_: (key, movers)},
        _stage("joining"),
    ),
    "split": Rule(
        "movers that are several become several",
        "bodies",
        {"stages.joining.split": lambda views, key, movers, own, next_key, config: (key, movers, next_key)},
        _stage("joining"),
    ),
    "plain_gaps": Rule(
        "parts with nothing between are neighbours",
        "bodies",
        {"stages.plain_gaps.across_plain_gaps": _zeros(4)},
        _stage("plain_gaps"),
    ),
    "frozen": Rule(
        "what stays on its pixel is bonnet or text",
        "bodies",
        {"stages.frozen.find_frozen": _none_frozen},
        _stage("frozen"),
    ),
    "fronts": Rule(
        "the front part of an object",
        "times",
        {"stages.fronts.front_boxes": lambda members, joint, states, xy_px: members.boxes(xy_px)[joint.owner]},
        _stage("fronts"),
    ),
    "slant": Rule(
        "surfaces that turn a side to us", "times", {"stages.slant.nearest_parts": _as_they_are}, _stage("slant")
    ),
    "bends": Rule(
        "objects in a bend have paths of their own",
        "times",
        {"stages.bends._ASKED_TURN_RAD_S": np.inf, "stages.bends._BEND_CHI2": np.inf},
        _stage("bends"),
    ),
    "overlaps": Rule(
        "tracks that look at the same pixels share noise",
        "times",
        {"stages.overlaps.overlap_factors": lambda xy_px, set_of, is_asked: np.ones(len(is_asked))},
        _stage("overlaps"),
    ),
    "steadied": Rule(
        "a camera's sway is not the movers'",
        "times",
        {"stages.steadied.steadied": lambda history, *_: history.xy},
        _stage("steadied"),
    ),
    "common_errors": Rule(
        "approach has to exceed the tracker's common error",
        "amendments",
        {"stages.approach.with_common_errors": _first},
        _stage("approach"),
    ),
    "seen_motion": Rule(
        "approach has to agree with the picture's growth",
        "amendments",
        {"stages.approach.with_seen_motion": _first},
        _stage("approach"),
    ),
    "steadiness": Rule(
        "objects whose times contradict themselves lose them",
        "amendments",
        {"stages.steadiness.steady_rows": lambda rates, t_s, rows: (rows, rates)},
        _stage("steadiness"),
    ),
    "own_bend": Rule("our own bend in the course", "warnings", {"stages.own_bend.own_bend": _none}, _stage("own_bend")),
    "closing": Rule(
        "the size of what stands in our way tells its time",
        "warnings",
        {"stages.approach.closing_of_tracks": _none},
        ("geometry/closing.py",),
    ),
    "braking": Rule(
        "the size of what may have begun to brake",
        "warnings",
        {"stages.approach.braking_of_tracks": _none},
        ("geometry/closing.py",),
    ),
}
GROUPS: dict[str, tuple[str, ...]] = {
    group: tuple(name for name, rule in RULES.items() if rule.group == group)
    for group in dict.fromkeys(rule.group for rule in RULES.values())
}


@contextmanager
def switched_off(names: Sequence[str]) -> Iterator[None]:
    """The analysis without some of its rules, until the block ends."""
    changed: list[tuple[Any, str, Any]] = []
    import_module("ttcvid.jobs.analyze")
    try:
        for name in names:
            for place, value in RULES[name].instead.items():
                changed += _put(place, value)
        yield
    finally:
        for module, name, value in reversed(changed):
            setattr(module, name, value)


def _put(place: str, value: Any) -> list[tuple[Any, str, Any]]:
    """Put a value where a name stands, and everywhere where that has been imported to; what was there."""
    module_name, _, name = place.rpartition(".")
    home = import_module(f"ttcvid.{module_name}")
    former = getattr(home, name)
    # A function is looked for by what it is; a number only where it is at home.
    holders = [home]
    if callable(former):
        loaded = [module for key, module in sys.modules.items() if key.startswith("ttcvid.") and module is not home]
        holders += [module for module in loaded if getattr(module, name, None) is former]
    for holder in holders:
        setattr(holder, name, value)
    return [(holder, name, former) for holder in holders]
