"""Commands in processes of their own, and what becomes of the processes that they begin."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil

DEADLINE_S = 120.0
GONE_WITHIN_S = 5.0
STOPPED_WITHIN_S = 4.0
"""Two seconds are promised; machines that run tests have other things to do."""


def begun(*arguments: object) -> subprocess.Popen[str]:
    """``ttcvid`` with these arguments, in a session of its own: signals of the terminal do not reach it."""
    return subprocess.Popen(
        [Path(sys.executable).with_name("ttcvid"), *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def children_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """All processes that it has begun."""
    return psutil.Process(process.pid).children(recursive=True)


def are_gone(processes: list[psutil.Process]) -> bool:
    """Whether they are gone within 5 s."""
    return not psutil.wait_procs(processes, timeout=GONE_WITHIN_S)[1]


def wait_for(is_so: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Wait until something is so, while the process runs."""
    end_s = time.monotonic() + DEADLINE_S
    while not is_so():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end_s
        time.sleep(0.01)
