"""Which clips there are, and their analyses, each in a folder that is made once for a state of the code."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenario_suite.drawing import code_digest, read_json, write_json
from scenario_suite.rules import RULES_FILE, switched_off
from scenario_suite.running import analyzed, code_of_analysis

import ttcvid

DASHCAM = ("motorway_empty", "motorway_traffic", "highway", "rain_wiper", "city_traffic")


@dataclass(frozen=True)
class Clip:
    """A clip of the data folder in which nothing hits the camera, and the options of its analysis; no camera is given.

    ``setting`` names the options on the page.
    """

    name: str
    path: str
    setting: str
    options: dict[str, Any] = field(hash=False)


CLIPS = (
    *(Clip(name, f"dashcam/{name}.mp4", "vehicle", {"platform": "vehicle"}) for name in DASHCAM),
    Clip("solidWhiteRight", "driving_clips/solidWhiteRight.mp4", "vehicle", {"platform": "vehicle"}),
    Clip(
        "street_multidir_905f",
        "static_traffic/street_multidir_905f.mp4",
        "static",
        {"platform": "static", "end": "300"},
    ),
    Clip("TUD-Stadtmitte", "tud_stadtmitte/TUD-Stadtmitte.mp4", "static", {"platform": "static"}),
    *(Clip(name, f"dashcam/{name}.mp4", "nothing given", {}) for name in DASHCAM),
)


@dataclass(frozen=True)
class ClipTask:
    """A clip to be analysed below a folder, ``without`` the rules of these names; ``is_watched`` as of `Task`."""

    clip: Clip
    data: Path
    out: Path
    without: tuple[str, ...] = ()
    is_watched: bool = False

    @property
    def folder(self) -> Path:
        """Where its run belongs."""
        return self.out / self.clip.setting.replace(" ", "_") / self.clip.name


@dataclass(frozen=True)
class ClipDone:
    """A finished analysis; ``error`` None where there is a result; rules ``acting`` where the task was watched."""

    task: ClipTask
    seconds: float
    error: str | None
    is_old: bool
    acting: tuple[str, ...]

    def run(self) -> ttcvid.Run:
        """Its tables."""
        return ttcvid.Run.open(self.task.folder / "run")


def do_clip(task: ClipTask) -> ClipDone:
    """Analyse a clip, unless that is done."""
    path = task.data / task.clip.path
    stamp = (path.stat().st_size, sorted(task.clip.options.items()), task.without, code_of_analysis())
    if task.without or task.is_watched:
        stamp += (task.is_watched, code_digest(RULES_FILE))
    key = hashlib.sha256(json.dumps(stamp).encode()).hexdigest()
    known = read_json(task.folder / "run.json")
    is_old = known.get("key") == key
    if not is_old:
        (task.folder / "run.json").unlink(missing_ok=True)
        task.folder.mkdir(parents=True, exist_ok=True)
        acting: set[str] | None = set() if task.is_watched else None
        with switched_off(task.without, acting):
            known = {"key": key, **analyzed(path, task.folder / "run", {"overlay": False, **task.clip.options})}
        known["acting"] = sorted(acting or ())
        write_json(task.folder / "run.json", known)
    return ClipDone(task, float(known["seconds"]), known["error"], is_old, tuple(known.get("acting", ())))
