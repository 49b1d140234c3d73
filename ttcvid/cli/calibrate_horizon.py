"""``ttcvid calibrate-horizon``: the horizon of a camera from what moves before it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ttcvid.cli.clip_options import (
    Messages,
    clip_options,
    configuration_options,
    message_options,
    method_option,
    output_option,
    tracker_option,
)
from ttcvid.cli.grouped import GroupedCommand, option_under

_camera_option = option_under("Camera (default: a horizontal field of view of 55 deg is assumed)")


@click.command(cls=GroupedCommand, short_help="The horizon of a camera from objects that move in straight lines.")
@click.argument("clips", metavar="CLIP...", nargs=-1, required=True)
@output_option(
    "-o",
    "--out",
    metavar="FILE",
    default="horizon.yaml",
    show_default=True,
    help="Horizon file, written alone.",
)
@output_option(
    "--evidence",
    metavar="FOLDER",
    help="Write into it, too, what the horizon rests on: motions.parquet and horizon.png.",
)
@output_option("--overwrite", is_flag=True, default=None, help="Replace files that exist.")
@message_options()
@_camera_option("--camera", metavar="FILE", help="Intrinsics and distortion, as for analyze.")
@clip_options(_camera_option)
@method_option("--moving", is_flag=True, default=None, help="The camera drives: its own motion determines the horizon.")
@method_option("--roll-zero", is_flag=True, default=None, help="The camera has no roll: one direction is enough.")
@tracker_option()
@method_option(
    "--platform", type=click.Choice(("vehicle", "free", "static")), help="static: skip the check that the camera rests."
)
@configuration_options("horizon_calibration.min_motions=4")
@click.pass_context
def calibrate_horizon(
    ctx: click.Context,
    /,
    clips: tuple[str, ...],
    out: str,
    evidence: str | None,
    messages: Messages,
    config: str | None,
    settings: tuple[str, ...],
    **options: Any,
) -> None:
    """Find the horizon of a camera in CLIP, or in several clips of the same camera in the same place.

    A resting camera finds it from several objects that move in straight lines, in different directions. Where the clip
    does not determine it, the result is "undetermined": exit code 5, and no file.

    \b
      ttcvid calibrate-horizon street.mp4 --camera calib.yaml -o horizon.yaml --evidence look
      ttcvid calibrate-horizon dashcam.mp4 --moving
      ttcvid analyze street.mp4 --camera calib.yaml --horizon horizon.yaml
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    from ttcvid.cli.progress import compile_first, log_to_stderr, progress_on_stderr
    from ttcvid.jobs.calibrate_horizon.run_calibration import run_calibration
    from ttcvid.jobs.settings.configuration import configure_from_command_line

    log_to_stderr(quiet=messages.quiet, verbose=messages.verbose)
    texts = {name: str(value).lower() if isinstance(value, bool) else value for name, value in options.items()}
    configuration = configure_from_command_line(texts, settings, Path(config) if config else None)
    compile_first(enabled=not messages.quiet)
    with progress_on_stderr(enabled=not messages.quiet) as progress:
        done = run_calibration(
            clips, Path(out), configuration, evidence=Path(evidence) if evidence else None, on_frame=progress
        )
    click.echo(done.summary_json() if messages.as_json else done.summary())
    ctx.exit(done.exit_code)
