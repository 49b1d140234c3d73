"""``ttcvid regress``: recorded clips as a regression test."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from ttcvid.jobs.regress.run_suite import ClipOutcome

MAX_DETAILS = 40


@click.command(short_help="Analyse the clips of a suite again and say what got different.")
@click.argument("suite", type=click.Path(path_type=Path))
@click.option("--update", is_flag=True, help="Rewrite the baselines and show what changes.")
@click.option("--only", metavar="NAME", multiple=True, help="This clip only. Repeatable.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Clips at a time.")
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), metavar="FOLDER", help="Runs.  [default: SUITESTEM_regress]"
)
@click.option(
    "--junit", type=click.Path(path_type=Path), metavar="FILE", help="[default: junit.xml in the folder of --out]"
)
@click.option("-q", "--quiet", is_flag=True, help="One line a clip, no rows that differ.")
@click.pass_context
def regress(
    ctx: click.Context,
    /,
    suite: Path,
    update: bool,
    only: tuple[str, ...],
    jobs: int,
    out: Path | None,
    junit: Path | None,
    quiet: bool,
) -> None:
    """Analyse the clips of SUITE (a YAML file) and hold the results against baselines and expectations.

    \b
      ttcvid regress sample_configs/regression.yaml             what a CI job calls
      ttcvid regress suite.yaml --only crossing --update        take the new results of a clip as right

    Prints a line a clip and writes a JUnit file. Baselines are small text files that live beside the suite.

    Exit codes: 0 all as expected (or skipped), 1 something changed, 2 suite or baseline cannot be used,
    3 a clip is missing or cannot be read.
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    from ttcvid.jobs.regress.run_suite import regress as run_suite

    def tell(outcome: ClipOutcome) -> None:
        click.echo(outcome.line())
        details = [] if quiet else outcome.details()
        for line in details[:MAX_DETAILS]:
            click.echo(f"    {line}")
        if len(details) > MAX_DETAILS:
            click.echo(f"    ... {len(details) - MAX_DETAILS} more lines: in the JUnit file, or by ttcvid compare")

    result = run_suite(suite, update=update, only=only, jobs=jobs, out=out, junit=junit, on_clip=tell)
    click.echo(result.summary())
    ctx.exit(result.exit_code)
