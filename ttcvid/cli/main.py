"""The command ``ttcvid``: its list of commands, and how failures become one line and an exit code.

Nothing heavy is imported here: a command's module is loaded when that command is used, so that help answers at once.
"""

from __future__ import annotations

import difflib
import importlib
import os
import sys
import traceback
from collections.abc import Sequence

import click

import ttcvid
from ttcvid.errors import TtcvidError, UsageError

COMMANDS = {
    "analyze": "Collision times of everything that moves in a clip: tables and an annotated video.",
    "calibrate-horizon": "The horizon of a camera from things that move in straight lines.",
    "collision-map": "Which change of own velocity leads to a collision, and which one avoids it.",
    "compare": "Whether two results are the same, and what is different: frames, objects, times, warnings.",
    "demo": "Render a scene with known truth, analyse and evaluate it, and say where to look.",
    "doctor": "Versions of what ttcvid stands on, and what is broken.",
    "evaluate": "How good a run is beside a truth: errors, intervals, objects, warnings.",
    "regress": "Analyse the clips of a suite again and hold them against baselines and expectations.",
    "sensitivity": "How errors of direction and time grow with distance, method by method.",
    "simulate": "Render a scene with exact truth: pictures, camera, depths, collision times.",
}
"""Commands and their short help; the module ``ttcvid.cli.NAME`` holds each as ``NAME``, dashes as underscores."""

EXIT_UNEXPECTED = 2
"""An error in ttcvid itself: no result, and never 1, which says that a check was made and failed."""
EXIT_INTERRUPTED = 130

BLAS_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


class LazyGroup(click.Group):
    """A group of commands whose modules are imported when they are invoked."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names of all commands."""
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, its module imported now."""
        if cmd_name not in COMMANDS:
            nearest = difflib.get_close_matches(cmd_name, COMMANDS, n=1)
            remedy = f"did you mean {nearest[0]!r}?" if nearest else f"expected one of {', '.join(COMMANDS)}"
            raise UsageError(f"unknown command {cmd_name!r}: {remedy}")
        name = cmd_name.replace("-", "_")
        command = getattr(importlib.import_module(f"ttcvid.cli.{name}"), name)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands from ``COMMANDS``, importing none of them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name]) for name in self.list_commands(ctx)])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(ttcvid.__version__, prog_name="ttcvid")
def cli() -> None:
    """Which things in a clip move on their own, when each comes closest, and how far off it passes.

    One camera, moving or at rest; no depth sensor, no training, no GPU.

    \b
      ttcvid demo                see it work, without any data
      ttcvid analyze clip.mp4    analyse a clip of your own

    \b
    Exit codes: 0 ok, 1 a check failed, 2 usage or configuration (or an unexpected error),
    3 input or calibration unreadable, 4 done in part, 5 undetermined, 130 interrupted.
    TTCVID_DEBUG=1 shows the traceback of an error.
    """  # noqa: D301  the \b is click's mark of lines to keep as they are


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line (default: this process's) and return its exit code."""
    hold_blas_to_one_thread()
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = cli.main(args=arguments, prog_name="ttcvid", standalone_mode=False, obj=tuple(arguments))
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        print(error.format_message(), file=sys.stderr)
        return UsageError.exit_code
    except (click.Abort, KeyboardInterrupt):
        return _fail("interrupted, nothing was written", EXIT_INTERRUPTED)
    except click.ClickException as error:
        return _fail(error.format_message(), UsageError.exit_code)
    except TtcvidError as error:
        return _fail(str(error), error.exit_code)
    except BrokenPipeError:
        # The reader of our output has gone (``ttcvid ... | head``): what is still buffered must not fail at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        remedy = "an error in ttcvid itself; TTCVID_DEBUG=1 shows where, please report it"
        return _fail(f"{type(error).__name__}: {error}: {remedy}", EXIT_UNEXPECTED)
    return code if isinstance(code, int) else 0


def hold_blas_to_one_thread() -> None:
    """Keep linear algebra on one thread: our matrices are small, and the cores are busy decoding and drawing.

    Acts only before numpy is first imported; variables that the user has set stay.
    """
    for name in BLAS_THREAD_VARIABLES:
        os.environ.setdefault(name, "1")


def _fail(message: str, exit_code: int) -> int:
    if os.environ.get("TTCVID_DEBUG", "") not in ("", "0"):
        traceback.print_exc()
    print(f"ttcvid: error: {' '.join(message.split())}", file=sys.stderr)
    return exit_code
