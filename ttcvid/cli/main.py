"""The program ``ttcvid``: signals, and how failures become one line and an exit code.

What takes time to import is imported inside `main`, once an interruption finds an answer.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from types import FrameType
from typing import Any, NoReturn

EXIT_UNEXPECTED = 2
"""An error in ttcvid itself: no result, and never 1, which says that a check was made and failed."""
EXIT_INTERRUPTED = 130

BLAS_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_COMPLETION_VARIABLE = "_TTCVID_COMPLETE"
"""Set by a shell that asks how a line may go on (click's name for it)."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def program() -> NoReturn:
    """Run this process's command line and end the process, at once.

    An interpreter that ends takes apart all that it has imported, object by object: half a second, for memory that the
    system takes back in any case. Every command has closed its files and ended its processes and threads by then.
    """
    from ttcvid.cli.streams import guard_standard_streams

    guard_standard_streams()
    exit_code = main()
    # None where it was closed from the beginning.
    for stream in filter(None, (sys.stdout, sys.stderr)):
        # `_run` has written out what was printed, and told if it could not.
        with suppress(OSError):
            stream.flush()
    os._exit(exit_code)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line (default: this process's) and return its exit code."""
    stop = _Interruption()
    former = stop.catch()
    try:
        hold_blas_to_one_thread()
        return _run(list(sys.argv[1:] if arguments is None else arguments), stop)
    except KeyboardInterrupt:
        stop.is_caught = True
        return _fail("interrupted, nothing was written", EXIT_INTERRUPTED)
    finally:
        # where this process ends now, a further signal must not turn its exit code into another
        stop.is_caught = True
        if arguments is not None:
            for number, handler in former.items():
                signal.signal(number, handler)


def _run(arguments: list[str], stop: _Interruption) -> int:
    import click

    from ttcvid.cli.commands import cli
    from ttcvid.errors import OutputError, TtcvidError, UsageError

    try:
        if _COMPLETION_VARIABLE in os.environ:
            cli.main(prog_name="ttcvid")
        # Not by `cli.main`: it takes any end of a file for Ctrl-C, and any closed pipe for one of standard output.
        with cli.make_context("ttcvid", arguments, obj=tuple(arguments)) as context:
            code = cli.invoke(context)
        if sys.stdout is not None:
            sys.stdout.flush()
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        print(error.format_message(), file=sys.stderr)
        return UsageError.exit_code
    except click.ClickException as error:
        return _fail(error.format_message(), UsageError.exit_code)
    except TtcvidError as error:
        return _fail(str(error), error.exit_code)
    except Exception as error:
        if stop.is_caught:  # an import that is interrupted may fail in any way
            raise KeyboardInterrupt from None
        if isinstance(error, OSError) and _is_of_output(error):
            _drop_output()
            reason = error.strerror or "unknown reason"
            return _fail(
                f"standard output cannot be written ({reason}): results that go to files are there",
                OutputError.exit_code,
            )
        if _is_of_processes(error):
            return _fail(
                f"no further thread or process can be started ({error}): allow more of them (ulimit -u), or end some",
                UsageError.exit_code,
            )
        if isinstance(error, FileNotFoundError) and not _has_working_folder():
            return _fail("the working folder does not exist any more: change to another one", UsageError.exit_code)
        remedy = "an error in ttcvid itself; TTCVID_DEBUG=1 shows where, please report it"
        return _fail(f"{type(error).__name__}: {error}: {remedy}", EXIT_UNEXPECTED)
    return code if isinstance(code, int) else 0


class _Interruption:
    """Ctrl-C and SIGTERM as KeyboardInterrupt: once, so that what it sets going is not interrupted itself."""

    def __init__(self) -> None:
        self.is_caught = False

    def catch(self) -> dict[signal.Signals, Any]:
        """Take over the signals; returns their former handlers. Python gives signals to its main thread only."""
        if threading.current_thread() is not threading.main_thread():
            return {}
        return {number: signal.signal(number, self._on_signal) for number in _SIGNALS}

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if not self.is_caught:
            self.is_caught = True
            raise KeyboardInterrupt


def hold_blas_to_one_thread() -> None:
    """Keep linear algebra on one thread: our matrices are small, and the cores are busy decoding and drawing.

    Acts only before numpy is first imported; variables that the user has set stay.
    """
    for name in BLAS_THREAD_VARIABLES:
        os.environ.setdefault(name, "1")


def _is_of_output(error: OSError) -> bool:
    """Whether what failed is the printing of a result, done by click and by the flush at the end alone."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return trace is not None and trace.tb_frame.f_globals["__name__"] in ("click.utils", __name__)


def _is_of_processes(error: Exception) -> bool:
    """Whether the system refused a thread or a copy of this process: nothing else here gives these errors."""
    return isinstance(error, BlockingIOError) or (isinstance(error, RuntimeError) and "start new thread" in str(error))


def _has_working_folder() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def _drop_output() -> None:
    """What is still buffered must not fail at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(message: str, exit_code: int) -> int:
    if os.environ.get("TTCVID_DEBUG", "") not in ("", "0"):
        import traceback

        traceback.print_exc()
    from ttcvid.errors import on_one_line

    print(f"ttcvid: error: {on_one_line(' '.join(message.split()))}", file=sys.stderr)
    return exit_code
