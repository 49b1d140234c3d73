"""``ttcvid calibrate-horizon``: the horizon of a camera from what moves before it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ttcvid.cli.analyze import TRACKERS
from ttcvid.cli.grouped import GroupedCommand, option_under

_camera_option = option_under("Camera (without one, 55 deg horizontal field of view is assumed, and said)")
_time_option = option_under("Time (frames as 120, seconds as 4.5s or 00:01:02.5)")
_method_option = option_under("Method")
_output_option = option_under("Output")


@click.command(cls=GroupedCommand, short_help="The horizon of a camera from things that move in straight lines.")
@click.argument("clips", metavar="CLIP...", nargs=-1, required=True)
@_output_option(
    "-o",
    "--out",
    metavar="FILE",
    default="horizon.yaml",
    show_default=True,
    help="Horizon file; motions.parquet and horizon.png are put beside it.",
)
@_output_option("--overwrite", is_flag=True, default=None, help="Replace files that exist.")
@_output_option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object.")
@_output_option("-q", "--quiet", is_flag=True, help="No progress and no warnings on stderr.")
@_output_option("-v", "--verbose", is_flag=True, help="Say on stderr what is being done.")
@_camera_option("--camera", metavar="FILE", help="Intrinsics and distortion, as for analyze.")
@_camera_option("--focal-px", metavar="PX", help="Focal length in px, principal point at the centre.")
@_camera_option("--hfov", metavar="DEG", help="Horizontal field of view in degrees.")
@_camera_option("--image-size", metavar="WxH", help="Picture size in px of a track table without a camera file.")
@_camera_option("--mask", metavar="FILE", help="Picture, black where nothing is to be looked at (own bonnet, text).")
@_time_option("--fps", metavar="HZ", help="Frame rate of an image folder.")
@_time_option("--timestamps", metavar="FILE", help="Times of an image folder: one second a line, or KITTI's format.")
@_time_option("--start", metavar="PLACE", help="First frame or time.  [default: the beginning]")
@_time_option("--end", metavar="PLACE", help="End, itself left out.  [default: the end]")
@_time_option("--stride", metavar="N", help="Take every N-th frame.  [default: 1]")
@_method_option("--moving", is_flag=True, default=None, help="The camera drives: its own motion tells the horizon.")
@_method_option("--roll-zero", is_flag=True, default=None, help="The camera stands level: one direction is enough.")
@_method_option("--tracker", type=click.Choice(TRACKERS), help="How points are followed.  [default: klt]")
@_method_option(
    "--platform", type=click.Choice(("vehicle", "free", "static")), help="static: believe without a look that it rests."
)
@_method_option("--config", metavar="FILE", help="TOML configuration; ./ttcvid.toml is read as well, and is weaker.")
@_method_option(
    "--set",
    "settings",
    metavar="SECTION.KEY=VALUE",
    multiple=True,
    help="A parameter of a stage, such as horizon_calibration.min_motions=4. Repeatable.",
)
@click.pass_context
def calibrate_horizon(
    ctx: click.Context,
    /,
    clips: tuple[str, ...],
    out: str,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    config: str | None,
    settings: tuple[str, ...],
    **options: Any,
) -> None:
    """Find the horizon of a camera in CLIP, or in several clips of the same camera in the same place.

    A resting camera that watches several things move in straight lines, in different directions, sees each make for a
    point of the horizon. Where that is not so, the result is "undetermined": exit code 5, and no file.

    \b
      ttcvid calibrate-horizon street.mp4 --camera calib.yaml -o street/horizon.yaml
      ttcvid calibrate-horizon dashcam.mp4 --moving
      ttcvid analyze street.mp4 --camera calib.yaml --horizon street/horizon.yaml
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    from ttcvid.cli.progress import log_to_stderr, progress_on_terminal
    from ttcvid.jobs.calibrate_horizon import run_calibration
    from ttcvid.jobs.configuration import configure_from_command_line

    log_to_stderr(quiet=quiet, verbose=verbose)
    texts = {name: str(value).lower() if isinstance(value, bool) else value for name, value in options.items()}
    configuration = configure_from_command_line(texts, settings, Path(config) if config else None)
    with progress_on_terminal(enabled=not quiet) as progress:
        done = run_calibration(clips, Path(out), configuration, on_frame=progress)
    click.echo(done.summary_json() if as_json else done.summary())
    ctx.exit(done.exit_code)
