"""``ttcvid sensitivity``: how well a camera can tell direction and time, before it is bought."""

from __future__ import annotations

from pathlib import Path

import click

from ttcvid.cli.grouped import GroupedCommand, option_under

OUTPUT, CASE, CAMERA, STUDY = "Output", "What moves", "The camera", "The study"


@click.command(cls=GroupedCommand, short_help="How errors of direction and time grow with distance.")
@click.argument("config", type=click.Path(path_type=Path), required=False)
@option_under(OUTPUT)("-o", "--out", type=click.Path(path_type=Path), help="Output folder (default: sensitivity).")
@option_under(OUTPUT)("--overwrite", is_flag=True, help="Replace the result in a folder that exists.")
@option_under(OUTPUT)("--json", "as_json", is_flag=True, help="One JSON object instead of the summary line.")
@option_under(OUTPUT)("-q", "--quiet", is_flag=True, help="No summary and no progress.")
@option_under(CASE)("--speed-km-h", metavar="V", help="Speed relative to the camera.  [default: 50]")
@option_under(CASE)("--angle-deg", metavar="A", help="Angle of its motion with the optical axis.  [default: 45]")
@option_under(CASE)("--distance-m", metavar="M", help="Distance, where that is not varied.  [default: 50]")
@option_under(CASE)("--height-m", metavar="M", help="Height of the point off the horizon's plane.  [default: 1]")
@option_under(CAMERA)("--focal-mm", metavar="F", help="Focal length.  [default: 8]")
@option_under(CAMERA)("--pixel-pitch-um", metavar="P", help="Size of a pixel.  [default: 4.65]")
@option_under(CAMERA)("--sigma-px", metavar="S", help="Noise of a coordinate.  [default: 0.2]")
@option_under(CAMERA)("--frame-rate-hz", metavar="R", help="Pictures a second.  [default: 12]")
@option_under(CAMERA)("--baseline-m", metavar="B", help="Baseline of the stereo pair.  [default: 0.15]")
@option_under(CAMERA)("--frames", metavar="N,N", help="Lengths of whole tracks.  [default: 5,10,20]")
@option_under(STUDY)(
    "--over", metavar="WHAT", help="distance, angle, focal, noise, rate or height.  [default: distance]"
)
@option_under(STUDY)("--first", metavar="X", help="First value of what is varied.  [default: by what is varied]")
@option_under(STUDY)("--last", metavar="X", help="Last value of what is varied.  [default: by what is varied]")
@option_under(STUDY)("--steps", metavar="N", help="Number of values.  [default: 25]")
@option_under(STUDY)("--trials", metavar="N", help="Trials of each value and method.  [default: 10000]")
@option_under(STUDY)("--within", metavar="E", help="Relative error that is still useful.  [default: 0.1]")
@option_under(STUDY)("--seed", metavar="N", help="Seed of the noise.  [default: 0]")
@click.pass_context
def sensitivity(
    ctx: click.Context,
    /,
    config: Path | None,
    out: Path | None,
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    **options: str | None,
) -> None:
    """How the errors of the direction of motion and of the time to collision grow, and how far they are useful.

    Compares the paper's planar method (two pictures and a horizon) and general method (three pictures), whole tracks
    by maximum likelihood, and a stereo pair: by closed form, by Cramer-Rao bound, and by Monte-Carlo of the functions
    that analyze uses. Writes sensitivity.parquet, .png and .svg. Without options it is the paper's case; CONFIG is a
    TOML file with the section [sensitivity].

    \b
      ttcvid sensitivity -o study
      ttcvid sensitivity --focal-mm 25 --frame-rate-hz 30 -o telephoto
      ttcvid sensitivity --over noise --distance-m 80 -o noise
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    import json

    from ttcvid.cli.progress import compile_first, progress_on_stderr
    from ttcvid.config import SensitivityConfig
    from ttcvid.jobs.sensitivity import run_sensitivity
    from ttcvid.jobs.settings.configuration import configure_study

    parameters = configure_study("sensitivity", SensitivityConfig, options, config, is_text=True)
    compile_first(enabled=not quiet)
    with progress_on_stderr(enabled=not quiet) as progress:
        result = run_sensitivity(parameters, out, overwrite, progress)
    if as_json:
        click.echo(json.dumps(result.as_json(), allow_nan=False))
    elif not quiet:
        click.echo(f"{result.folder}: {result.sentence}")
