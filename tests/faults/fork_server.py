"""Runs commands of ttcvid for `attacked_runs.Attacker`, each in a copy of this process: none imports or loads anything.

Reads one JSON object a line from standard input and answers each with one on standard output.
"""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import resource
import signal
import sys
import time
from typing import Any

import psutil

import ttcvid
from ttcvid.jobs.processes.compilation import load_compiled

POLL_S = 0.002


def run(task: dict[str, Any]) -> dict[str, Any]:
    """Run a command to its end, or kill its process (and nothing else) at a moment; then wait for what it has left."""
    started_s = time.monotonic()
    pid = os.fork()
    if pid == 0:
        _become_the_command(task)
    kill_after_s, deadline_s = task["kill_after_s"], task["deadline_s"]
    is_hanging = False
    while True:
        ended, status = os.waitpid(pid, os.WNOHANG)
        elapsed_s = time.monotonic() - started_s
        if ended:
            break
        if kill_after_s is not None and elapsed_s >= kill_after_s:
            os.kill(pid, signal.SIGKILL)
            kill_after_s = None
        if elapsed_s > deadline_s:
            is_hanging = True
            os.killpg(pid, signal.SIGKILL)
            deadline_s = float("inf")
        time.sleep(POLL_S)
    return {
        "exit_code": None if is_hanging else os.waitstatus_to_exitcode(status),
        "duration_s": elapsed_s,
        "n_orphans": _n_left_of(pid, task["orphan_s"]),
    }


def _become_the_command(task: dict[str, Any]) -> None:
    try:
        os.setsid()
        os.chdir(task["folder"])
        for descriptor, path in ((0, os.devnull), (1, task["stdout"]), (2, task["stderr"])):
            os.dup2(os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC), descriptor)
        if task["largest_file_bytes"] is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (task["largest_file_bytes"],) * 2)
        for name in [name for name in os.environ if name.startswith("TTCVID_")]:
            del os.environ[name]
        sys.argv = ["ttcvid", *task["arguments"]]
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", closefd=False)
        from ttcvid.cli.main import program

        program()
    finally:
        os._exit(99)


def _n_left_of(session: int, wait_s: float) -> int:
    """Processes of a session that are still there after some seconds; they are ended then."""
    end_s = time.monotonic() + wait_s
    while (left := _processes_of(session)) and time.monotonic() < end_s:
        time.sleep(0.02)
    for process in left:
        process.kill()
    return len(left)


def _processes_of(session: int) -> list[psutil.Process]:
    found = []
    for pid in psutil.pids():
        try:
            if os.getsid(pid) == session and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
                found.append(psutil.Process(pid))
        except (ProcessLookupError, PermissionError, psutil.NoSuchProcess):
            continue
    return found


def main() -> None:
    """Import all of ttcvid, then serve until the input ends."""
    for module in pkgutil.walk_packages(ttcvid.__path__, "ttcvid."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    load_compiled()
    for line in sys.stdin:
        print(json.dumps(run(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
