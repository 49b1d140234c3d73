"""Items worked through by several workers: each once, failures once more by another, an end whenever it is wanted."""

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from ttcvid.errors import InputError
from ttcvid.jobs.crew import Attempt, Call, Crew


class FakeWorker:
    """Works in this process; says its name, and avoids what it is told to avoid by taking another one."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.is_closed = threading.Event()

    def call(self, function: Callable[..., Any], *arguments: Any, on_news: Any = None, avoid: str = "") -> Any:
        if avoid == self.name:
            self.name += "'"
        return function(*arguments)

    def close(self) -> None:
        self.is_closed.set()


def finished(crew: Crew[Any, Any], items: list[Any]) -> list[Attempt[Any, Any]]:
    with crew:
        return [attempt for attempt in crew.attempts(items) if attempt is not None]


def doubled(call: Call, item: int) -> int:
    return call(lambda x: 2 * x, item)


def test_every_item_is_done_once_whatever_the_number_of_workers() -> None:
    for n_workers in (1, 3):
        workers = [FakeWorker(str(number)) for number in range(n_workers)]
        attempts = finished(Crew(workers, doubled), list(range(20)))
        assert sorted((a.item, a.value) for a in attempts) == [(n, 2 * n) for n in range(20)]
        assert all(worker.is_closed.is_set() for worker in workers)


def test_no_items_are_done_at_once() -> None:
    assert finished(Crew([FakeWorker("one")], doubled), []) == []


def test_what_fails_is_tried_again_after_all_others_by_another_worker() -> None:
    def odd_fails(call: Call, item: int) -> int:
        def work() -> int:
            if item % 2:
                raise InputError(f"{item} is odd")
            return item

        return call(work)

    attempts = finished(Crew([FakeWorker("one")], odd_fails, n_tries=2), [1, 2, 3, 4])
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

    attempts = finished(Crew([FakeWorker("one")], unforeseen), [0, 1])
    assert [type(a.error) for a in attempts] == [ZeroDivisionError, type(None)]


def test_whoever_waits_can_look_at_the_clock_and_leave_at_any_time() -> None:
    worker = FakeWorker("one")

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

    assert len(finished(Crew([FakeWorker("one")], never, n_tries), [1])) == n_tries
