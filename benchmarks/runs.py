"""``ttcvid analyze`` as a user calls it: in a process of its own, in a folder of its own, without other settings."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from report import REPOSITORY

from ttcvid import Run

TTCVID = Path(sys.executable).with_name("ttcvid")


@dataclass(frozen=True)
class TimedRun:
    """A finished analysis and how long its command took, start of the interpreter included."""

    run: Run
    wall_s: float


def data_place() -> Path:
    """Where the folder of the real clips is, if it is there."""
    return Path(os.environ.get("TTCVID_DATA", REPOSITORY.parent / "shared" / "data")).resolve()


def data_folder() -> Path:
    """Folder of the real clips; ends the program where they are absent."""
    folder = data_place()
    if not folder.is_dir():
        raise SystemExit(f"{folder}: real clips not found: set TTCVID_DATA to their folder")
    return folder


def until_stopped(main: Callable[[], None]) -> None:
    """Run a program that has begun processes; they end with it at Ctrl-C and at SIGTERM, with exit code 130."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)


def shown(words: list[str]) -> list[str]:
    """A command as it can be typed anywhere: program names, and the data folder by its variable."""
    data = str(data_folder())
    programs = {str(TTCVID): "ttcvid", sys.executable: "python"}
    short = [programs.get(word, word.replace(data, "$TTCVID_DATA")) for word in words]
    return [word.replace(f"{REPOSITORY}/", "") for word in short]


def analyze_command(input_: Path, out: Path, options: list[str]) -> list[str]:
    """The command line of one analysis."""
    return [str(TTCVID), "analyze", str(input_), *options, "-q", "-o", str(out)]


def timed(words: list[str], folder: Path) -> tuple[str, float]:
    """Output and wall-clock seconds of a command that has to succeed, run in ``folder`` without TTCVID settings."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("TTCVID_")}
    start_s = time.perf_counter()
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    wall_s = time.perf_counter() - start_s
    if done.returncode:
        raise SystemExit(f"{' '.join(shown(words))}: exit code {done.returncode}: {done.stderr.strip()}")
    return done.stdout, wall_s


def analyzed(input_: Path, out: Path, options: list[str]) -> TimedRun:
    """Analyse a clip into ``out``."""
    _, wall_s = timed(analyze_command(input_, out, options), out.parent)
    return TimedRun(Run.open(out), wall_s)
