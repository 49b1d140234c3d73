"""``ttcvid analyze``: the options of one analysis, handed over as text to be checked in one place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ttcvid.cli.analysis_options import analysis_options, as_text
from ttcvid.cli.clip_options import Messages, configuration_options, message_options, output_option
from ttcvid.cli.grouped import GroupedCommand
from ttcvid.errors import UsageError


@click.command(cls=GroupedCommand, short_help="Collision times of everything that moves in a clip.")
@click.argument("inputs", metavar="INPUT", nargs=-1, required=True)
@output_option("-o", "--out", metavar="FOLDER", help="Output folder.  [default: INPUTSTEM_ttc]")
@output_option("--overlay/--no-overlay", default=None, help="Write the annotated video.  [default: --overlay]")
@output_option("--report/--no-report", default=None, help="Write the page that shows the result.  [default: --report]")
@output_option("--overwrite", is_flag=True, default=None, help="Replace an output folder that exists.")
@message_options()
@analysis_options()
@configuration_options("tracking.max_tracks=800")
@click.pass_context
def analyze(
    ctx: click.Context,
    /,
    inputs: tuple[str, ...],
    out: str | None,
    messages: Messages,
    config: str | None,
    settings: tuple[str, ...],
    **options: Any,
) -> None:
    """Find what moves by itself in INPUT, when each object comes closest, and how far off it passes.

    INPUT is a video, a folder or pattern of pictures (frames/%06d.png, 'frames/*.png'), or a table of point tracks
    (.parquet or .csv with frame, t_s, track_id, x_px, y_px).

    \b
      ttcvid analyze drive.mp4 --camera calib.yaml --platform vehicle
      ttcvid analyze frames/ --fps 9.65 --focal-px 721 -o results/drive1

    Every option may also stand in a configuration file (focal_px under [analyze]) or in the environment
    (TTCVID_FOCAL_PX); the command line is stronger than the environment, and that than --config.
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    from ttcvid.cli.progress import compile_first, log_to_stderr, progress_on_stderr
    from ttcvid.jobs.analyze.run_analysis import run_analysis
    from ttcvid.jobs.settings.configuration import configure_from_command_line

    input_ = _only_one(inputs)
    log_to_stderr(quiet=messages.quiet, verbose=messages.verbose)
    configuration = configure_from_command_line(
        {name: as_text(value) for name, value in options.items()}, settings, Path(config) if config else None
    )
    compile_first(enabled=not messages.quiet)
    with progress_on_stderr(enabled=not messages.quiet) as progress:
        run = run_analysis(input_, Path(out) if out else None, configuration, arguments=ctx.obj, on_frame=progress)
    click.echo(run.summary_json() if messages.as_json else run.summary())
    ctx.exit(run.exit_code)


def _only_one(inputs: tuple[str, ...]) -> str:
    if len(inputs) > 1:
        raise UsageError(
            f"{len(inputs)} inputs, {inputs[0]} to {inputs[-1]}: expected one: give several clips to 'ttcvid batch', "
            "and the pictures of one clip as their folder, or as a pattern in quotes"
        )
    return inputs[0]
