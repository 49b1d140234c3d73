"""A stream worked out beside the caller: in order, failures handed over, nothing left behind, whatever happens."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator

import pytest
from numba.core.compiler_lock import global_compiler_lock

from ttcvid.errors import InputError, TtcvidError
from ttcvid.jobs.analyze import beside as module
from ttcvid.jobs.analyze.beside import AHEAD_ITEMS, OtherProcess, beside
from ttcvid.posix import can_copy_process

DEADLINE_S = 30.0
needs_fork = pytest.mark.skipif(not can_copy_process(), reason="processes cannot be copied here")


@pytest.fixture(params=["process", "thread"], autouse=True)
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Every test holds for both ways."""
    if request.param == "process" and not can_copy_process():
        pytest.skip("processes cannot be copied here")
    monkeypatch.setattr(module, "can_copy_process", can_copy_process if request.param == "process" else lambda: False)
    return str(request.param)


@pytest.fixture(autouse=True)
def nothing_left() -> Iterator[None]:
    threads = threading.active_count()
    yield
    assert threading.active_count() == threads
    assert not multiprocessing.active_children()


def running_sum(numbers: Iterable[int]) -> Iterator[int]:
    total = 0
    for number in numbers:
        total += number
        yield total


def looking_ahead(numbers: Iterable[int]) -> Iterator[int]:
    """Yields nothing before it has seen everything."""
    yield from reversed(list(numbers))


def failing_at_three(numbers: Iterable[int]) -> Iterator[int]:
    for number in numbers:
        if number == 3:
            raise InputError("no three")
        yield number


def until_five(numbers: Iterable[int]) -> Iterator[int]:
    for number in numbers:
        if number == 5:
            return
        yield number


def test_results_are_those_of_the_function_in_its_order() -> None:
    with beside(running_sum, range(200)) as results:
        assert list(results) == list(running_sum(range(200)))


def test_a_function_may_look_as_far_ahead_as_it_likes() -> None:
    with beside(looking_ahead, range(50)) as results:
        assert list(results) == list(reversed(range(50)))


def test_a_function_may_end_before_its_items() -> None:
    with beside(until_five, range(10**9)) as results:
        assert list(results) == [0, 1, 2, 3, 4]


def test_a_failure_of_the_function_comes_after_its_results() -> None:
    seen = []
    with pytest.raises(InputError, match="no three"), beside(failing_at_three, range(10)) as results:
        seen.extend(results)
    assert seen == [0, 1, 2]


def test_a_failure_of_the_items_comes_after_the_results_of_those_before_it() -> None:
    def items() -> Iterator[int]:
        yield from (1, 2)
        raise InputError("broken packet")

    seen = []
    with pytest.raises(InputError, match="broken packet"), beside(running_sum, items()) as results:
        seen.extend(results)
    assert seen == [1, 3]


def test_a_connection_that_the_items_lose_is_a_failure_like_any_other() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ConnectionResetError("the camera has gone")

    with pytest.raises(ConnectionResetError, match="camera"), beside(running_sum, items()) as results:
        list(results)


def doubled_beside(numbers: Iterable[int]) -> Iterator[int]:
    """Has part of its own work done beside it."""
    with beside(running_sum, numbers) as sums:
        for number in sums:
            yield 2 * number


def test_part_of_the_function_may_itself_be_worked_out_beside_it() -> None:
    with beside(doubled_beside, range(200)) as results:
        assert list(results) == [2 * number for number in running_sum(range(200))]


def test_what_two_threads_of_it_say_at_the_same_time_stays_whole() -> None:
    """It takes items in a thread while its results are on their way, where part of it is worked out beside it."""

    def large_beside(numbers: Iterable[int]) -> Iterator[bytes]:
        with beside(running_sum, numbers) as sums:
            for number in sums:
                yield bytes([number % 256]) * 200_000

    with beside(large_beside, range(2000)) as results:
        for result, number in zip(results, running_sum(range(2000)), strict=True):
            assert result[:1] == result[-1:] == bytes([number % 256])


def test_a_failure_of_the_part_of_a_part_comes_after_its_results() -> None:
    def with_failing_part(numbers: Iterable[int]) -> Iterator[int]:
        with beside(failing_at_three, numbers) as few:
            yield from few

    seen = []
    with pytest.raises(InputError, match="no three"), beside(with_failing_part, range(10)) as results:
        seen.extend(results)
    assert seen == [0, 1, 2]


class HardToTellError(Exception):
    """Cannot be put together again from what it is taken apart into."""

    def __init__(self, what: str, why: str) -> None:
        super().__init__(f"{what}: {why}")


def hard_to_tell(numbers: Iterable[int]) -> Iterator[int]:
    yield from numbers
    raise HardToTellError("all of it", "no reason")


def test_a_failure_that_cannot_be_sent_is_told_in_words() -> None:
    with (
        pytest.raises((HardToTellError, RuntimeError), match="all of it: no reason"),
        beside(hard_to_tell, []) as found,
    ):
        list(found)


def test_leaving_early_ends_everything() -> None:
    def take_one_and_stop() -> None:
        with beside(running_sum, range(10**9)) as results:
            next(iter(results))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        take_one_and_stop()


def test_leaving_early_ends_what_a_part_of_the_function_does_beside_it(way: str) -> None:
    """At once, even where that looks at no pipe for long."""

    def slow(numbers: Iterable[int]) -> Iterator[tuple[int, int]]:
        for number in numbers:
            yield os.getpid(), number
            if number == 1 and way == "process":
                time.sleep(DEADLINE_S)

    def with_slow_part(numbers: Iterable[int]) -> Iterator[tuple[int, int]]:
        with beside(slow, numbers) as results:
            yield from results

    with beside(with_slow_part, range(10**9)) as results:
        pid, _ = next(iter(results))
    if way == "process":
        end_s = time.monotonic() + 0.1 * DEADLINE_S
        while _is_running(pid):
            assert time.monotonic() < end_s
            time.sleep(0.01)


def test_large_results_that_nobody_takes_do_not_keep_it_from_ending() -> None:
    def large(numbers: Iterable[int]) -> Iterator[bytes]:
        for _ in numbers:
            yield bytes(1 << 20)

    with beside(large, (bytes(1 << 20) for _ in range(100))) as results:
        next(iter(results))
        time.sleep(0.1)


def test_items_are_not_made_long_before_they_are_needed() -> None:
    made = []

    def items() -> Iterator[int]:
        for n in range(1000):
            made.append(n)
            yield n

    def slow(numbers: Iterable[int]) -> Iterator[int]:
        for number in numbers:
            time.sleep(0.01)
            yield number

    with beside(slow, items()) as results:
        for n, _ in zip(range(20), results, strict=False):
            assert len(made) <= n + 2 * AHEAD_ITEMS + 4


def test_a_process_that_is_ended_from_outside_is_told_from_one_that_is_done(way: str) -> None:
    if way == "thread":
        pytest.skip("a thread cannot be ended")

    def kill_it_at_ten() -> None:
        with OtherProcess(running_sum, range(10**9)) as results:
            for number in results:
                if number == 10:
                    (process,) = multiprocessing.active_children()
                    process.kill()

    with pytest.raises(TtcvidError, match="enough memory"):
        kill_it_at_ten()


@needs_fork
def test_whoever_may_have_no_processes_works_all_the_same(way: str) -> None:
    context = multiprocessing.get_context("fork")
    process = context.Process(target=_work_as_daemon, daemon=True)
    process.start()
    process.join(DEADLINE_S)
    assert process.exitcode == 0


def _work_as_daemon() -> None:
    with beside(running_sum, range(10)) as results:
        assert list(results) == list(running_sum(range(10)))


@needs_fork
def test_one_of_two_that_dies_is_noticed_while_the_other_works_on(way: str) -> None:
    if way == "thread":
        pytest.skip("a thread cannot be ended")
    one = OtherProcess(running_sum, range(10**9))

    def kill_one_while_another_works() -> None:
        with one as first:
            stream = iter(first)
            next(stream)
            (process,) = multiprocessing.active_children()
            with OtherProcess(running_sum, range(10**9)) as second:
                next(iter(second))
                process.kill()
                for _ in stream:
                    pass

    with pytest.raises(TtcvidError, match="enough memory"):
        kill_one_while_another_works()


@needs_fork
def test_a_thread_that_compiles_meanwhile_does_not_block_it(way: str) -> None:
    if way == "thread":
        pytest.skip("a thread has no copy of the lock")
    is_held, may_go = threading.Event(), threading.Event()

    def compile_for_long() -> None:
        with global_compiler_lock:
            is_held.set()
            may_go.wait(0.3)

    thread = threading.Thread(target=compile_for_long)
    thread.start()
    is_held.wait()
    with OtherProcess(compiling, range(3)) as results:
        assert list(results) == [0, 1, 2]
    thread.join()


def compiling(numbers: Iterable[int]) -> Iterator[int]:
    for number in numbers:
        with global_compiler_lock:
            yield number


@needs_fork
def test_the_other_processes_end_with_one_that_is_killed(way: str) -> None:
    script = """
import os
from ttcvid.jobs.analyze.beside import OtherProcess
def numbers(items):
    for item in items:
        yield os.getpid(), item
def with_part(items):
    with OtherProcess(numbers, items) as results:
        for pid, item in results:
            yield os.getpid(), pid, item
with OtherProcess(with_part, range(10**9)) as results:
    for *pids, number in results:
        if number == 5:
            print(*pids, flush=True)
"""
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    others = [int(pid) for pid in process.stdout.readline().split()]
    assert len(set(others)) == 2
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    end_s = time.monotonic() + DEADLINE_S
    while any(_is_running(pid) for pid in others):
        assert time.monotonic() < end_s
        time.sleep(0.01)


def _is_running(pid: int) -> bool:
    """Whether a process is there and does something (an ended one may wait for somebody to ask)."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@needs_fork
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_all_processes_does_not_end_it(number: signal.Signals, way: str) -> None:
    if way == "thread":
        pytest.skip("a thread gets no signals")
    with OtherProcess(running_sum, range(100)) as results:
        stream = iter(results)
        next(stream)
        (process,) = multiprocessing.active_children()
        assert process.pid is not None
        os.kill(process.pid, number)
        assert sum(1 for _ in stream) == 99
