"""Items worked through by several workers: each once, failures once more by another, an end whenever it is wanted."""

import signal
import threading
import time
from typing import Any

import pytest
from workers_here import WorkerHere

from ttcvid.errors import InputError
from ttcvid.jobs.processes.crew import Attempt, Call, Crew
from ttcvid.jobs.processes.stopping import StopSignals


class Watched(WorkerHere):
    """Says whether it was closed."""

    def __init__(self) -> None:
        super().__init__()
        self.is_closed = threading.Event()

    def close(self) -> None:
        self.is_closed.set()


def finished(crew: Crew[Any, Any], items: list[Any]) -> list[Attempt[Any, Any]]:
    with crew:
        return [attempt for attempt in crew.attempts(items) if attempt is not None]


def doubled(call: Call, item: int) -> int:
    return call(lambda x: 2 * x, item)


def test_every_item_is_done_once_whatever_the_number_of_workers() -> None:
    for n_workers in (1, 3):
        workers = [Watched() for _ in range(n_workers)]
        attempts = finished(Crew(workers, doubled), list(range(20)))
        assert sorted((a.item, a.value) for a in attempts) == [(n, 2 * n) for n in range(20)]
        assert all(worker.is_closed.is_set() for worker in workers)


def test_no_items_are_done_at_once() -> None:
    assert finished(Crew([Watched()], doubled), []) == []


def test_what_fails_is_tried_again_after_all_others_by_another_worker() -> None:
    def odd_fails(call: Call, item: int) -> int:
        def work() -> int:
            if item % 2:
                raise InputError(f"{item} is odd")
            return item

        return call(work)

    attempts = finished(Crew([Watched()], odd_fails, n_tries=2), [1, 2, 3, 4])
    assert [(a.item, a.number, a.is_last) for a in attempts] == [
        (1, 1, False),
        (2, 1, True),
        (3, 1, False),
        (4, 1, True),
        (1, 2, True),
        (3, 2, True),
    ]
    assert [str(a.error) for a in attempts if a.is_last and a.error] == ["1 is odd", "3 is odd"]
    workers = {(a.item, a.worker) for a in attempts if a.item % 2}
    assert len(workers) == 4


def test_whatever_an_item_raises_belongs_to_that_item() -> None:
    def unforeseen(call: Call, item: int) -> float:
        return 1 / item

    attempts = finished(Crew([Watched()], unforeseen), [0, 1])
    assert [type(a.error) for a in attempts] == [ZeroDivisionError, type(None)]


def test_whoever_waits_can_look_at_the_clock_and_leave_at_any_time() -> None:
    worker = Watched()

    def until_closed(call: Call, item: int) -> None:
        worker.is_closed.wait()

    started_s = time.monotonic()
    with Crew([worker], until_closed) as crew:
        for attempt in crew.attempts([1, 2, 3]):
            assert attempt is None
            break
    assert time.monotonic() - started_s < 2.0
    assert not [t for t in threading.enumerate() if t.name == "ttcvid-crew"]


@pytest.mark.parametrize("n_tries", [1, 3])
def test_the_number_of_tries_is_kept(n_tries: int) -> None:
    def never(call: Call, item: int) -> None:
        raise InputError("never")

    assert len(finished(Crew([Watched()], never, n_tries), [1])) == n_tries


def test_a_second_signal_waits_for_nothing() -> None:
    """A worker that goes on although it is closed stands for one that the system holds on to."""
    may_end = threading.Event()

    def stubborn(call: Call, item: int) -> None:
        may_end.wait()

    to_main = (threading.main_thread().ident, signal.SIGINT)
    timers = [threading.Timer(delay_s, signal.pthread_kill, to_main) for delay_s in (0.1, 0.5)]
    started_s = time.monotonic()

    def work_until_stopped() -> None:
        with StopSignals("stopping") as stop, Crew([Watched()], stubborn) as crew:
            for timer in timers:
                timer.start()
            for _ in crew.attempts([1]):
                if stop.is_requested:
                    break

    try:
        with pytest.raises(KeyboardInterrupt):
            work_until_stopped()
        assert 0.5 <= time.monotonic() - started_s < 1.2
    finally:
        may_end.set()
        for timer in timers:
            timer.join()
