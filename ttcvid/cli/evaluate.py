"""``ttcvid evaluate``: a run held against a truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from ttcvid.studies.evaluation.evaluate import Evaluation

EXIT_CHECK_FAILED = 1


@click.command(short_help="How good a run is beside a truth.")
@click.argument("run", type=click.Path(path_type=Path))
@click.argument("truth", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of the table.")
@click.option("--html", type=click.Path(path_type=Path), metavar="FILE", help="Write a page with curves as well.")
@click.option(
    "--fail-on",
    "conditions",
    metavar="CONDITION",
    multiple=True,
    help="Exit 1 where it holds, as 'ttc_z.median>0.05'; a metric without a value fails. Repeatable.",
)
@click.option("-q", "--quiet", is_flag=True, help="No table; only what --fail-on says.")
@click.pass_context
def evaluate(
    ctx: click.Context,
    /,
    run: Path,
    truth: Path,
    as_json: bool,
    html: Path | None,
    conditions: tuple[str, ...],
    quiet: bool,
) -> None:
    """Compare RUN (the output folder of analyze) with TRUTH (the folder of simulate, or tables of the same columns).

    \b
      ttcvid simulate sample_configs/scenes/roundabout.yaml -o scene
      ttcvid analyze scene/clip.mp4 --camera scene/camera.yaml -o run
      ttcvid evaluate run scene --fail-on 'ttc_z.median>0.1' --fail-on 'events.false>0'
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    from ttcvid.cli.progress import log_to_stderr
    from ttcvid.jobs.evaluate import evaluate as evaluate_run
    from ttcvid.jobs.evaluate import write_page
    from ttcvid.studies.evaluation.metrics import check_from_text

    checks = [check_from_text(text) for text in conditions]
    log_to_stderr(quiet=quiet)
    result = evaluate_run(run, truth)
    if html is not None:
        write_page(result, html)
    if as_json:
        click.echo(result.as_json())
    elif not quiet:
        click.echo(describe(result.evaluation))
    complaints = [complaint for check in checks if (complaint := check.complaint(result.evaluation.metrics))]
    for complaint in complaints:
        click.echo(f"ttcvid: check failed: {complaint}", err=True)
    ctx.exit(EXIT_CHECK_FAILED if complaints else 0)


def describe(evaluation: Evaluation) -> str:
    """All metrics that have a value, a line a group, and a line for each object."""
    from ttcvid.studies.evaluation.wording import describe_groups, describe_object

    return "\n".join([*describe_groups(evaluation.metrics), *map(describe_object, evaluation.objects)])
