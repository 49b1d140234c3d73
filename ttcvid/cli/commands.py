"""The list of commands of ``ttcvid``.

Nothing heavy is imported here: a command's module is loaded when that command is used, so that help answers at once.
"""

from __future__ import annotations

import difflib
import importlib
from itertools import pairwise

import click

import ttcvid
from ttcvid.errors import UsageError

COMMANDS = {
    "analyze": "Collision times of everything that moves in a clip: tables and an annotated video.",
    "batch": "Analyse many clips, several at a time, and go on where one stopped.",
    "calibrate-horizon": "The horizon of a camera from objects that move in straight lines.",
    "collision-map": "Which change of own velocity leads to a collision, and which one avoids it.",
    "compare": "Whether two results are the same, and what is different: frames, objects, times, warnings.",
    "demo": "Render a scene with known truth, analyse and evaluate it, and say where to look.",
    "doctor": "Versions of what ttcvid stands on, and what is broken.",
    "evaluate": "How good a run is beside a truth: errors, intervals, objects, warnings.",
    "export": "A run in the formats of other tools: csv, mot, coco, rrd (Rerun), mcap (Foxglove).",
    "regress": "Analyse the clips of a suite again and hold them against baselines and expectations.",
    "report": "A page that shows a run, or several side by side, in any browser.",
    "sensitivity": "How errors of direction and time grow with distance, method by method.",
    "simulate": "Render a scene with exact truth: pictures, camera, depths, collision times.",
}
"""Commands and their short help; the module ``ttcvid.cli.NAME`` holds each as ``NAME``, dashes as underscores."""


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

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command and its arguments; an option that is given nothing stands for a variable that nobody has set."""
        for option, value in pairwise([*args, "given"]):
            name, equals, rest = option.partition("=")
            if option.startswith("-") and (value == "" or (equals and not rest)):
                raise UsageError(f"what follows {name} is empty: give it a value, or leave it out")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands from ``COMMANDS``, importing none of them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name]) for name in self.list_commands(ctx)])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(ttcvid.__version__, prog_name="ttcvid")
def cli() -> None:
    """What moves by itself in a clip, when each object comes closest, and how far off it passes.

    One camera, moving or at rest; no depth sensor, no training, no GPU.

    \b
      ttcvid demo                see it work, without any data
      ttcvid analyze clip.mp4    analyse a clip of your own

    \b
    Exit codes: 0 ok, 1 a check failed, 2 usage or configuration (or an unexpected error),
    3 input or calibration unreadable, 4 done in part, 5 undetermined, 130 interrupted.
    TTCVID_DEBUG=1 shows the traceback of an error.
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
