"""Threads that keep order, hand failures over and never hang."""

import threading
import time
from collections.abc import Callable, Iterable, Iterator

import pytest

from ttcvid.jobs.processes.side_by_side import ReadAhead, WriteBehind, map_ahead, waiting_items

pytestmark = pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")


def count_then_fail(n: int) -> Iterator[int]:
    yield from range(n)
    raise ValueError("broken packet")


def put_all(items: Iterable[int], write: Callable[[int], None]) -> None:
    with WriteBehind(write, depth=2) as sink:
        for item in items:
            sink.put(item)


@pytest.fixture(autouse=True)
def no_thread_left() -> Iterator[None]:
    """Every test ends with the threads it started with."""
    before = threading.active_count()
    yield
    assert threading.active_count() == before


def test_read_ahead_keeps_order() -> None:
    with ReadAhead(range(100), depth=3) as items:
        assert list(items) == list(range(100))


def test_read_ahead_raises_after_the_items_before_the_failure() -> None:
    seen: list[int] = []
    with ReadAhead(count_then_fail(5), depth=2) as items, pytest.raises(ValueError, match="broken packet"):
        seen.extend(items)
    assert seen == [0, 1, 2, 3, 4]


def test_read_ahead_reads_no_further_than_its_queue_allows() -> None:
    read: list[int] = []

    def items() -> Iterator[int]:
        for n in range(1000):
            read.append(n)
            yield n

    with ReadAhead(items(), depth=4) as ahead:
        next(iter(ahead))
        time.sleep(0.05)
        assert len(read) <= 7
    assert len(read) <= 20


def test_leaving_read_ahead_early_ends_its_thread() -> None:
    def take_one_and_stop() -> None:
        with ReadAhead(range(10**9), depth=2) as items:
            next(iter(items))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        take_one_and_stop()


def test_write_behind_writes_everything_in_order_before_it_is_left() -> None:
    written: list[int] = []

    def slowly(item: int) -> None:
        time.sleep(0.001)
        written.append(item)

    put_all(range(30), slowly)
    assert written == list(range(30))


def test_a_failing_write_is_raised_where_items_are_put_and_nothing_hangs() -> None:
    written: list[int] = []

    def fail_at_three(item: int) -> None:
        if item == 3:
            raise OSError("disk full")
        written.append(item)

    with pytest.raises(OSError, match="disk full"):
        put_all(range(1000), fail_at_three)
    assert written == [0, 1, 2]


def test_a_failure_of_the_last_write_is_raised_on_leaving() -> None:
    def fail(_: int) -> None:
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        put_all([1], fail)


def test_leaving_write_behind_by_an_exception_keeps_that_exception() -> None:
    def stop(n: int) -> Iterator[int]:
        yield n
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        put_all(stop(1), lambda _: time.sleep(0.001))


@pytest.mark.parametrize("n", [0, 1, 3, 50])
def test_map_ahead_is_map(n: int) -> None:
    def square_late_for_even(item: int) -> int:
        time.sleep(0.002 * (item % 2 == 0))
        return item * item

    assert list(map_ahead(square_late_for_even, range(n))) == [item * item for item in range(n)]


def test_map_ahead_works_on_two_items_at_once() -> None:
    both = threading.Barrier(2, timeout=5)
    assert list(map_ahead(lambda item: both.wait() * 0 + item, range(4))) == [0, 1, 2, 3]


def test_map_ahead_hands_a_failure_over_in_its_place() -> None:
    results = map_ahead(lambda item: 1 // (item - 5), range(10))
    assert [next(results) for _ in range(5)] == [-1] * 5
    with pytest.raises(ZeroDivisionError):
        next(results)


def test_map_ahead_that_is_left_early_takes_no_more_items() -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for n in range(1000):
            taken.append(n)
            yield n

    results = map_ahead(lambda item: item, items())
    assert next(results) == 0
    results.close()
    assert len(taken) <= 6


@pytest.mark.parametrize(("item_bytes", "expected"), [(1e3, 3), (5.2e6, 3), (12.5e6, 1), (20.7e6, 0)])
def test_fewer_large_items_wait(item_bytes: float, expected: int) -> None:
    assert waiting_items(item_bytes, 3) == expected
