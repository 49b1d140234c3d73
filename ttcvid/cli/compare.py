"""``ttcvid compare``: a run held against a baseline."""

from __future__ import annotations

from pathlib import Path

import click

EXIT_DIFFERENT = 1


@click.command(short_help="Whether two results are the same, and what is different.")
@click.argument("baseline", type=click.Path(path_type=Path))
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--tolerance", type=click.Path(path_type=Path), metavar="FILE", help="Tolerances (YAML), laid over the defaults."
)
@click.option(
    "--warn",
    "warn_s",
    type=click.FloatRange(min=0),
    metavar="S",
    help="Objects that certainly come sooner always count, however small.  [default: 4]",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of the words.")
@click.option("--junit", type=click.Path(path_type=Path), metavar="FILE", help="Write a JUnit file as well.")
@click.option("-q", "--quiet", is_flag=True, help="Only the verdict.")
@click.pass_context
def compare(
    ctx: click.Context,
    /,
    baseline: Path,
    run: Path,
    tolerance: Path | None,
    warn_s: float | None,
    as_json: bool,
    junit: Path | None,
    quiet: bool,
) -> None:
    """Compare the results of RUN with those of BASELINE: output folders of analyze, or a baseline file of regress.

    \b
      ttcvid analyze clip.mp4 -o today
      ttcvid compare yesterday today

    Frames are joined by time, objects by overlap, tracks by place, warnings by object and time; numbers of objects and
    tracks do not matter. An object counts by itself if it carries a warning, is near in time (--warn), or is large
    enough; of all others their number counts. A difference counts beyond the tolerance of its column: absolute,
    relative, and in the sigmas that the baseline itself reports. What changed in versions, configuration and input is
    named, and is no difference.

    Exit codes: 0 the same, 1 different, 2 not comparable (unreadable, not whole, or of another schema).
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    import json

    from ttcvid.jobs.compare.compare_runs import compare as compare_runs
    from ttcvid.jobs.compare.compare_runs import write_junit
    from ttcvid.studies.compare.wording import comparison_as_json, comparison_cases, describe_comparison, verdict
    from ttcvid.studies.regression.junit import Suite

    comparison = compare_runs(baseline, run, tolerance, warn_s)
    if junit is not None:
        write_junit(junit, [Suite(f"{comparison.run} beside {comparison.baseline}", comparison_cases(comparison))])
    if as_json:
        click.echo(json.dumps(comparison_as_json(comparison), allow_nan=False))
    else:
        click.echo(verdict(comparison) if quiet else "\n".join(describe_comparison(comparison)))
    ctx.exit(0 if comparison.is_same else EXIT_DIFFERENT)
