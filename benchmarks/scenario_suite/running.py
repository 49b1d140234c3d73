"""Scenarios drawn and analysed, several side by side; what is complete is not done again.

OUT/FAMILY/SEED/
  scenario.json    the scenario, all but its scene
  truth            link to its folder of truth, clip or tracks included
  run/             the folder of ``ttcvid analyze``; absent where that failed
  run.json         exit_code, seconds, error (one line, or null)
  score/           the run beside the truth

Truth is drawn into a folder of its own, which runs with other options or another state of the code share.
"""

from __future__ import annotations

import hashlib
import json
import logging
import multiprocessing
import shutil
import signal
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import cv2

import ttcvid
from scenario_suite.drawing import (
    GIVEN_CAMERA_NAME,
    code_digest,
    drawing_key,
    drawn,
    input_of,
    is_drawn,
    read_json,
    write_json,
)
from scenario_suite.families import scenario
from scenario_suite.rules import RULES_FILE, switched_off
from scenario_suite.scenario import Kind, NuisanceValue, Scenario
from scenario_suite.scoring import keep_score
from ttcvid.jobs.analyze import run_analysis

T, R = TypeVar("T"), TypeVar("R")
_PACKAGE = Path(ttcvid.__file__).parent
_NOT_OF_THE_ANALYSIS = ("simulate", "studies", "report", "draw", "cli")
CRASHED = 70
"""Exit code of an analysis that ended with a traceback: a defect (EX_SOFTWARE of sysexits.h)."""


@dataclass(frozen=True)
class Task:
    """A scenario to be done: where its folder of truth and its run belong, and further options of the analysis.

    ``nuisances`` None: as drawn. ``without``: names of rules that are switched off. ``is_watched``: ``run.json`` says,
    as ``acting``, which rules act, or would if they were not switched off.
    """

    family: str
    seed: int
    kind: Kind | None
    out: Path
    pictures: Path
    nuisances: dict[str, NuisanceValue] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    without: tuple[str, ...] = ()
    is_watched: bool = False

    @property
    def folder(self) -> Path:
        """Where its run belongs."""
        return self.out / self.family / str(self.seed)


@dataclass(frozen=True)
class Done:
    """A finished task: its folder, whether it was done before, and what its run said; ``drawing_s`` 0: drawn before."""

    task: Task
    folder: Path
    is_old: bool
    drawing_s: float
    run: Mapping[str, Any]


@dataclass(frozen=True)
class Took:
    """How long ``n`` tasks took together, of which ``n_old`` were done before, and ``n_drawn`` at least drawn."""

    n: int
    n_old: int
    seconds: float
    n_drawn: int = 0

    def said(self, name: str, n_wanted: int, limit_min: float) -> str:
        """In words, and what ``n_wanted`` take at this rate beside their limit.

        >>> Took(120, 0, 90.0).said("tables", 1000, 10)
        '120 tables in 1 min 30 s (1000 at this rate: 12.5 min, limit 10)'
        >>> Took(3, 2, 4.0).said("scenes", 60, 15)
        '3 scenes in 0 min 4 s, 2 of them done before'
        >>> Took(60, 0, 180.0, n_drawn=60).said("scenes", 60, 15)
        '60 scenes in 3 min 0 s, 60 of them drawn before (60 at this rate: 3.0 min, limit 15)'
        """
        text = f"{self.n} {name} in {int(self.seconds) // 60} min {int(self.seconds) % 60} s"
        if self.n_old:
            return f"{text}, {self.n_old} of them done before"
        took_min = self.seconds * n_wanted / max(self.n, 1) / 60.0
        if self.n_drawn:
            text += f", {self.n_drawn} of them drawn before"
        return f"{text} ({n_wanted} at this rate: {took_min:.1f} min, limit {limit_min:g})"


def run_all(tasks: Iterable[T], n_jobs: int, work: Callable[[T], R]) -> Iterator[R]:
    """Do ``work`` on tasks in ``n_jobs`` processes; results as they are finished.

    Ctrl-C, or a caller that takes no more, ends the processes at once: what they were at is begun anew next time.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(n_jobs, mp_context=context, initializer=_prepare) as pool:
        waiting = [pool.submit(work, task) for task in tasks]
        try:
            for done in as_completed(waiting):
                yield done.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.kill()
            raise


def do(task: Task) -> Done:
    """Draw, analyse and score one scenario, unless that is done."""
    chosen = scenario(task.family, task.seed, task.kind, task.nuisances)
    folder = task.folder
    pictures = task.pictures / task.family / str(task.seed)
    start_s, was_drawn = time.perf_counter(), is_drawn(chosen, pictures)
    truth = drawn(chosen, pictures)
    drawing_s = 0.0 if was_drawn else time.perf_counter() - start_s
    key = _run_key(chosen, task)
    known = read_json(folder / "run.json")
    if known.get("key") == key:
        keep_score(folder)
        return Done(task, folder, True, drawing_s, known)
    (folder / "run.json").unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "scenario.json", chosen.described())
    _link(folder / "truth", truth)
    acting: set[str] | None = set() if task.is_watched else None
    with switched_off(task.without, acting):
        run = {"key": key, **analyzed(input_of(truth), folder / "run", options_of(chosen, truth) | dict(task.options))}
    if acting is not None:
        run["acting"] = sorted(acting)
    write_json(folder / "run.json", run)
    keep_score(folder)
    return Done(task, folder, False, drawing_s, run)


def options_of(chosen: Scenario, truth: Path) -> dict[str, Any]:
    """Options with which a scenario is analysed: what a user would know of the camera and of what carries it."""
    options: dict[str, Any] = {"platform": chosen.platform, "overlay": False, "report": chosen.kind == "video"}
    if chosen.camera_known:
        options["camera"] = str(truth / GIVEN_CAMERA_NAME)
    elif chosen.kind == "tracks":
        width, height = chosen.scene.camera.image_size
        options["image_size"] = f"{width}x{height}"
    return options


def analyzed(input_: Path, out: Path, options: Mapping[str, Any]) -> dict[str, Any]:
    """Exit code, seconds and error of an analysis."""
    shutil.rmtree(out, ignore_errors=True)
    start_s = time.perf_counter()
    exit_code, error = 0, None
    try:
        with _in_one_process():
            run = ttcvid.analyze(input_, out, **options)
        if run.manifest["state"] == "interrupted":
            raise KeyboardInterrupt
    except ttcvid.TtcvidError as failure:
        exit_code, error = failure.exit_code, str(failure)
    except Exception as failure:  # A crash of the analysis is a finding of the suite.
        last = traceback.extract_tb(failure.__traceback__)[-1]
        exit_code, error = CRASHED, f"{type(failure).__name__}: {failure} ({Path(last.filename).name}:{last.lineno})"
    return {"exit_code": exit_code, "seconds": round(time.perf_counter() - start_s, 3), "error": error}


def _run_key(chosen: Scenario, task: Task) -> str:
    """Changes with the drawn scenario, the options, the rules switched off and the code of the analysis."""
    content = json.dumps(dict(task.options), sort_keys=True, default=str) + "".join(task.without)
    if task.without or task.is_watched:
        content += f"{task.is_watched}" + code_digest(RULES_FILE)
    return hashlib.sha256((drawing_key(chosen) + content + code_of_analysis()).encode()).hexdigest()


def code_of_analysis() -> str:
    """Digest of the code that an analysis depends on."""
    return code_digest(_PACKAGE, without=_NOT_OF_THE_ANALYSIS)


def _link(link: Path, target: Path) -> None:
    if link.is_symlink():
        link.unlink()
    link.symlink_to(target.absolute(), target_is_directory=True)


@contextmanager
def _in_one_process() -> Iterator[None]:
    """The geometry worked out here and not beside: several scenes are under way, and the results are the same."""

    @contextmanager
    def here(function: Callable[[Iterable[T]], Iterator[R]], items: Iterable[T], _: int) -> Iterator[Iterable[R]]:
        yield function(items)

    former = run_analysis.beside
    run_analysis.beside = here
    try:
        yield
    finally:
        run_analysis.beside = former


def _prepare() -> None:
    """One thread of OpenCV in each process, no log on the terminal; Ctrl-C is for the process that asked."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    logging.getLogger("ttcvid").addHandler(logging.NullHandler())
