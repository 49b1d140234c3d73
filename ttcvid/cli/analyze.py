"""``ttcvid analyze``: the options of one analysis, handed over as text to be checked in one place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ttcvid.cli.grouped import GroupedCommand, option_under

TRACKERS = ("klt", "akaze")
ESTIMATORS = ("multi-frame", "three-frame", "two-frame")
PLATFORMS = ("vehicle", "aircraft", "free", "static")


_camera_option = option_under("Camera (without one: found in a clip that turns, else 55 deg assumed, and said)")
_time_option = option_under("Time (frames as 120, seconds as 4.5s or 00:01:02.5)")
_method_option = option_under("Method")
_output_option = option_under("Output")


@click.command(cls=GroupedCommand, short_help="Collision times of everything that moves in a clip.")
@click.argument("input_", metavar="INPUT")
@_output_option("-o", "--out", metavar="FOLDER", help="Output folder.  [default: INPUTSTEM_ttc]")
@_output_option("--overlay/--no-overlay", default=None, help="Write the annotated video.  [default: --overlay]")
@_output_option("--overwrite", is_flag=True, default=None, help="Replace an output folder that exists.")
@_output_option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object.")
@_output_option("-q", "--quiet", is_flag=True, help="No progress and no warnings on stderr.")
@_output_option("-v", "--verbose", is_flag=True, help="Say on stderr what is being done.")
@_camera_option(
    "--camera",
    metavar="FILE",
    help="Intrinsics and distortion, recognised by content: ttcvid YAML, ROS camera_info, Kalibr camchain, "
    "OpenCV FileStorage, KITTI calib.",
)
@_camera_option("--focal-px", metavar="PX", help="Focal length in px, principal point at the centre.")
@_camera_option("--hfov", metavar="DEG", help="Horizontal field of view in degrees.")
@_camera_option("--image-size", metavar="WxH", help="Picture size in px of a track table without a camera file.")
@_camera_option("--horizon", metavar="FILE|auto", help="Horizon of the camera, or auto: switches planar motion on.")
@_camera_option("--mask", metavar="FILE", help="Picture, black where nothing is to be looked at (own bonnet, text).")
@_time_option("--fps", metavar="HZ", help="Frame rate of an image folder.")
@_time_option("--timestamps", metavar="FILE", help="Times of an image folder: one second a line, or KITTI's format.")
@_time_option("--start", metavar="PLACE", help="First frame or time.  [default: the beginning]")
@_time_option("--end", metavar="PLACE", help="End, itself left out.  [default: the end]")
@_time_option("--stride", metavar="N", help="Take every N-th frame.  [default: 1]")
@_method_option(
    "--platform",
    type=click.Choice(PLATFORMS),
    help="What carries the camera: expectations of its own motion.  [default: free]",
)
@_method_option("--tracker", type=click.Choice(TRACKERS), help="How points are followed.  [default: klt]")
@_method_option("--estimator", type=click.Choice(ESTIMATORS), help="How times are estimated.  [default: multi-frame]")
@_method_option(
    "--smooth/--no-smooth",
    default=None,
    help="Directions, times and objects from frames on both sides; warnings stay causal.  [default: --no-smooth]",
)
@_method_option("--seed", metavar="N", help="Recorded in the manifest; nothing in analyze is random.  [default: 0]")
@_method_option("--config", metavar="FILE", help="TOML configuration; ./ttcvid.toml is read as well, and is weaker.")
@_method_option(
    "--set",
    "settings",
    metavar="SECTION.KEY=VALUE",
    multiple=True,
    help="A parameter of a stage, such as tracking.max_tracks=800. Repeatable.",
)
@click.pass_context
def analyze(
    ctx: click.Context,
    /,
    input_: str,
    out: str | None,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    config: str | None,
    settings: tuple[str, ...],
    **options: Any,
) -> None:
    """Find what moves on its own in INPUT, when each thing comes closest, and how far off it passes.

    INPUT is a video, a folder or pattern of pictures (frames/%06d.png, 'frames/*.png'), or a table of point tracks
    (.parquet or .csv with frame, t_s, track_id, x_px, y_px).

    \b
      ttcvid analyze drive.mp4 --camera calib.yaml --platform vehicle
      ttcvid analyze frames/ --fps 9.65 --focal-px 721 -o results/drive1

    Every option may also stand in a configuration file (focal_px under [analyze]) or in the environment
    (TTCVID_FOCAL_PX); the command line is stronger than the environment, and that than --config.
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    from ttcvid.cli.progress import log_to_stderr, progress_on_terminal
    from ttcvid.jobs.analyze import run_analysis
    from ttcvid.jobs.configuration import configure_from_command_line

    log_to_stderr(quiet=quiet, verbose=verbose)
    configuration = configure_from_command_line(
        {name: _as_text(value) for name, value in options.items()}, settings, Path(config) if config else None
    )
    with progress_on_terminal(enabled=not quiet) as progress:
        run = run_analysis(input_, Path(out) if out else None, configuration, arguments=ctx.obj, on_frame=progress)
    click.echo(run.summary_json() if as_json else run.summary())
    ctx.exit(run.exit_code)


def _as_text(value: Any) -> str | None:
    return str(value).lower() if isinstance(value, bool) else value
