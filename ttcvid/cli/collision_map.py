"""``ttcvid collision-map``: which change of own velocity leads to a collision, and which one avoids it."""

from __future__ import annotations

from pathlib import Path

import click

from ttcvid.cli.grouped import GroupedCommand, option_under

OUTPUT, SCALE, OWN, LIMITS, MAP = "Output", "Scale", "Own size", "What may be advised", "The map"

DEFAULT_FRAME = "Frame of the map (default: the first in which something is to be done, else the most dangerous)."


@click.command(cls=GroupedCommand, short_help="Which change of own velocity leads to a collision.")
@click.argument("run", type=click.Path(path_type=Path))
@option_under(OUTPUT)("-o", "--out", type=click.Path(path_type=Path), help="Output folder (default: RUN_map).")
@option_under(OUTPUT)("--overwrite", is_flag=True, help="Replace the result in a folder that exists.")
@option_under(OUTPUT)("--json", "as_json", is_flag=True, help="One JSON object instead of the summary line.")
@option_under(OUTPUT)("-q", "--quiet", is_flag=True, help="No summary and no progress.")
@option_under(OUTPUT)(
    "--config", type=click.Path(path_type=Path), metavar="FILE", help="TOML file with the section [collision_map]."
)
@option_under(MAP)("--frame", type=int, metavar="N", help=DEFAULT_FRAME)
@option_under(MAP)("--time", "time_s", type=float, metavar="S", help="Time of the map in seconds, instead of --frame.")
@option_under(MAP)("--range-m-s", metavar="V", help="Largest change forward, half of it sideways (default: own speed).")
@option_under(MAP)("--n-cells", metavar="N", help="Cells each way, odd.  [default: 61]")
@option_under(MAP)("--units", metavar="km/h|own-speed", help="Units of the picture's axes.  [default: km/h]")
@option_under(SCALE)(
    "--ego-speed", metavar="V|FILE:COLUMN", help="Own speed: 13.9 (m/s), 50km/h, or a column ..._m_s or ..._km_h."
)
@option_under(SCALE)("--camera-height-m", metavar="M", help="Height of the camera over the ground.")
@option_under(SCALE)("--object-width-m", metavar="M", help="Width of objects: 1.8 for all, 3=2.5 for object 3.")
@option_under(OWN)("--width-m", metavar="M", help="Own width.  [default: the scene's own, else 1.8]")
@option_under(OWN)("--length-m", metavar="M", help="Own length.  [default: the scene's own, else 4.5]")
@option_under(OWN)("--height-m", metavar="M", help="Own height.  [default: the scene's own, else 1.5]")
@option_under(LIMITS)("--look-ahead-s", metavar="S", help="Collisions later than this do not count.  [default: 5]")
@option_under(LIMITS)("--warn-s", metavar="S", help="An advice is given for contacts before this.  [default: 3.5]")
@option_under(LIMITS)("--max-probability", metavar="P", help="What an advice brings it down to.  [default: 0.1]")
@option_under(LIMITS)("--braking-m-s2", metavar="A", help="Hardest braking.  [default: 6]")
@option_under(LIMITS)("--sideways-m-s2", metavar="A", help="Largest acceleration sideways.  [default: 3]")
@option_under(LIMITS)("--turning-radius-m", metavar="M", help="Radius of our narrowest turn.  [default: 5.5]")
@option_under(LIMITS)("--forward-m-s2", metavar="A", help="Largest acceleration forward.  [default: 0]")
def collision_map(
    run: Path,
    out: Path | None,
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    config: Path | None,
    frame: int | None,
    time_s: float | None,
    **options: str | None,
) -> None:
    """For changes of our velocity, forward and sideways: when we would collide, with what, and how probably.

    RUN is the output folder of analyze, the folder of simulate or a scene file (then its truth is used). Writes
    collision_map.png and .svg, the map as collision_map.parquet, and evasion.parquet: for each frame the smallest
    change of velocity that avoids a collision.

    \b
      ttcvid collision-map sample_configs/scenes/crossing_collision.yaml -o map
      ttcvid collision-map clip_ttc --ego-speed 50km/h --camera-height-m 1.4 -o map
      ttcvid collision-map clip_ttc --ego-speed speed.csv:speed_m_s --time 3.2

    A run has no metres: own speed or the camera's height gives them to the static scene, its ground contact or its
    width to each moving object. An object without either is drawn as the family of its possible speeds.
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    import json

    from ttcvid.cli.progress import compile_first, progress_on_stderr
    from ttcvid.config import CollisionMapConfig
    from ttcvid.jobs.collision_map.run_collision_map import run_collision_map
    from ttcvid.jobs.settings.configuration import configure_study

    parameters = configure_study("collision_map", CollisionMapConfig, options, config, is_text=True)
    compile_first(enabled=not quiet)
    with progress_on_stderr(enabled=not quiet) as progress:
        result = run_collision_map(run, out, parameters, frame, time_s, overwrite, progress)
    if as_json:
        click.echo(json.dumps(result.as_json(), allow_nan=False))
    elif not quiet:
        click.echo(result.summary())
