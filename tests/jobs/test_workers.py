"""A process that carries out calls: results, failures and news come back, and neither end outlives the other."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import psutil
import pytest

from ttcvid.errors import InputError
from ttcvid.jobs.processes.workers import LocalWorker, WorkerLostError

DEADLINE_S = 30.0
GONE_WITHIN_S = 5.0


@pytest.fixture
def worker() -> Iterator[LocalWorker]:
    worker = LocalWorker()
    yield worker
    worker.close()


def failing(what: str) -> None:
    raise InputError(what)


def counting(n: int, on_news: object = None) -> int:
    for number in range(n):
        on_news(number)  # type: ignore[operator]
    return n


def kill_itself() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def lose_connection() -> None:
    raise ConnectionResetError("the camera has gone")


def failing_unforeseen() -> None:
    raise ZeroDivisionError("no reason")


def test_calls_go_to_one_other_process_one_after_another(worker: LocalWorker) -> None:
    first, second = worker.call(os.getpid), worker.call(os.getpid)
    assert first == second != os.getpid()
    assert worker.name == f"process {first}"


def test_what_a_call_raises_is_raised_here_and_the_process_goes_on(worker: LocalWorker) -> None:
    before = worker.call(os.getpid)
    with pytest.raises(InputError) as caught:
        worker.call(failing, "no clip")
    assert str(caught.value) == "no clip"
    assert worker.call(os.getpid) == before


def test_after_an_unforeseen_error_a_new_process_takes_over(worker: LocalWorker) -> None:
    before = worker.call(os.getpid)
    with pytest.raises(ZeroDivisionError, match="no reason"):
        worker.call(failing_unforeseen)
    assert worker.call(os.getpid) != before


def test_a_connection_that_the_call_loses_is_a_failure_like_any_other(worker: LocalWorker) -> None:
    with pytest.raises(ConnectionResetError, match="the camera has gone"):
        worker.call(lose_connection)


def test_news_arrive_before_the_result(worker: LocalWorker) -> None:
    news: list[int] = []
    assert worker.call(counting, 3, on_news=news.append) == 3
    assert news == [0, 1, 2]


def test_a_process_to_be_avoided_and_one_that_is_used_once_are_replaced(worker: LocalWorker) -> None:
    before = worker.call(os.getpid)
    assert worker.call(os.getpid, avoid=worker.name) != before
    once = LocalWorker(is_fresh_each_call=True)
    assert once.call(os.getpid) != once.call(os.getpid)
    once.close()


def test_a_process_that_dies_is_told_and_replaced(worker: LocalWorker) -> None:
    with pytest.raises(WorkerLostError, match="ended from outside: is there enough memory"):
        worker.call(kill_itself)
    with pytest.raises(WorkerLostError, match="exit code 3: a script of your own"):
        worker.call(os._exit, 3)
    assert worker.call(abs, -1) == 1


def test_closing_ends_a_call_at_once_and_no_other_begins(worker: LocalWorker) -> None:
    worker.call(abs, -1)
    timer = threading.Timer(0.2, worker.close)
    timer.start()
    started_s = time.monotonic()
    with pytest.raises(WorkerLostError):
        worker.call(time.sleep, DEADLINE_S)
    assert time.monotonic() - started_s < 2.0
    with pytest.raises(WorkerLostError, match="being stopped"):
        worker.call(abs, -1)
    timer.join()


def test_signals_to_all_processes_do_not_end_it(worker: LocalWorker) -> None:
    pid = worker.call(os.getpid)
    for number in (signal.SIGINT, signal.SIGTERM):
        os.kill(pid, number)
    assert worker.call(os.getpid) == pid


LEADER = """
import os, time
from ttcvid.jobs.processes.workers import LocalWorker
worker = LocalWorker()
print(worker.call(os.getpid), flush=True)
worker.call(time.sleep, 100)
"""


def test_the_process_ends_with_a_leader_that_is_killed() -> None:
    leader = subprocess.Popen([sys.executable, "-c", LEADER], stdout=subprocess.PIPE, text=True)
    assert leader.stdout is not None
    worker = psutil.Process(int(leader.stdout.readline()))
    leader.kill()
    leader.wait()
    leader.stdout.close()
    assert psutil.wait_procs([worker], timeout=GONE_WITHIN_S)[1] == []
