"""``ttcvid analyze``: the options of one analysis, handed over as text to be checked in one place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ttcvid.cli.clip_options import (
    clip_options,
    configuration_options,
    message_options,
    method_option,
    output_option,
    tracker_option,
)
from ttcvid.cli.grouped import GroupedCommand, option_under
from ttcvid.errors import UsageError

ESTIMATORS = ("multi-frame", "three-frame", "two-frame")
PLATFORMS = ("vehicle", "aircraft", "free", "static")


_camera_option = option_under("Camera (without one: found in a clip that turns, else 55 deg assumed, and said)")


@click.command(cls=GroupedCommand, short_help="Collision times of everything that moves in a clip.")
@click.argument("inputs", metavar="INPUT", nargs=-1, required=True)
@output_option("-o", "--out", metavar="FOLDER", help="Output folder.  [default: INPUTSTEM_ttc]")
@output_option("--overlay/--no-overlay", default=None, help="Write the annotated video.  [default: --overlay]")
@output_option("--overwrite", is_flag=True, default=None, help="Replace an output folder that exists.")
@message_options()
@_camera_option(
    "--camera",
    metavar="FILE",
    help="Intrinsics and distortion, recognised by content: ttcvid YAML, ROS camera_info, Kalibr camchain, "
    "OpenCV FileStorage, KITTI calib.",
)
@_camera_option("--horizon", metavar="FILE|auto", help="Horizon of the camera, or auto: switches planar motion on.")
@clip_options(_camera_option)
@method_option(
    "--platform",
    type=click.Choice(PLATFORMS),
    help="What carries the camera: expectations of its own motion.  [default: free]",
)
@tracker_option()
@method_option("--estimator", type=click.Choice(ESTIMATORS), help="How times are estimated.  [default: multi-frame]")
@method_option(
    "--smooth/--no-smooth",
    default=None,
    help="Directions, times and objects from frames on both sides; warnings stay causal.  [default: --no-smooth]",
)
@method_option("--seed", metavar="N", help="Recorded in the manifest; nothing in analyze is random.  [default: 0]")
@configuration_options("tracking.max_tracks=800")
@click.pass_context
def analyze(
    ctx: click.Context,
    /,
    inputs: tuple[str, ...],
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
    from ttcvid.cli.progress import log_to_stderr, progress_on_stderr
    from ttcvid.jobs.analyze import run_analysis
    from ttcvid.jobs.compilation import compilation_note
    from ttcvid.jobs.configuration import configure_from_command_line

    input_ = _only_one(inputs)
    log_to_stderr(quiet=quiet, verbose=verbose)
    configuration = configure_from_command_line(
        {name: _as_text(value) for name, value in options.items()}, settings, Path(config) if config else None
    )
    with progress_on_stderr(compilation_note(), enabled=not quiet) as progress:
        run = run_analysis(input_, Path(out) if out else None, configuration, arguments=ctx.obj, on_frame=progress)
    click.echo(run.summary_json() if as_json else run.summary())
    ctx.exit(run.exit_code)


def _only_one(inputs: tuple[str, ...]) -> str:
    if len(inputs) > 1:
        raise UsageError(
            f"{len(inputs)} inputs, {inputs[0]} to {inputs[-1]}: expected one: give several clips to 'ttcvid batch', "
            "and the pictures of one clip as their folder, or as a pattern in quotes"
        )
    return inputs[0]


def _as_text(value: Any) -> str | None:
    return str(value).lower() if isinstance(value, bool) else value
