"""``ttcvid doctor``: versions, and what is broken."""

from __future__ import annotations

import json
from dataclasses import asdict

import click


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option("--warm", is_flag=True, help="Compile ahead what the first analysis would compile.")
@click.pass_context
def doctor(ctx: click.Context, /, as_json: bool, warm: bool) -> None:
    """Print the versions of what ttcvid stands on, and what is broken; exit code 1 if anything is."""
    from ttcvid.jobs.doctor import examine

    if warm:
        from ttcvid.cli.progress import compile_first

        compile_first()
    diagnosis = examine()
    if as_json:
        click.echo(json.dumps(asdict(diagnosis), sort_keys=True))
    else:
        for name, value in (diagnosis.versions | diagnosis.machine).items():
            click.echo(f"{name:15}{value}")
        for problem in diagnosis.problems:
            click.echo(f"BROKEN  {problem}")
        if not diagnosis.problems:
            click.echo("all is well")
    ctx.exit(diagnosis.exit_code)
