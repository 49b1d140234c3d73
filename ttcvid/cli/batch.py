"""``ttcvid batch``: many clips at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ttcvid.cli.analysis_options import analysis_options, as_text
from ttcvid.cli.clip_options import Messages, configuration_options, message_options, output_option
from ttcvid.cli.grouped import GroupedCommand, option_under

_work_option = option_under("Work")


@click.command(cls=GroupedCommand, short_help="Analyse many clips, several at a time, and go on where one stopped.")
@click.argument("inputs", metavar="INPUTS...", nargs=-1, required=True)
@output_option("-o", "--out", metavar="FOLDER", required=True, help="Folder of the batch: a folder a clip below it.")
@output_option("--overlay/--no-overlay", default=None, help="Write the annotated videos.  [default: --overlay]")
@output_option("--report/--no-report", default=None, help="Write the pages of the results.  [default: --report]")
@message_options()
@_work_option(
    "--jobs", type=click.IntRange(min=1), metavar="N", help="Clips at a time.  [default: 1; twice a cluster's threads]"
)
@_work_option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask cluster to do the work, such as tcp://10.0.0.1:8786 (docs/scale.md).",
)
@analysis_options()
@configuration_options("tracking.max_tracks=800")
@click.pass_context
def batch(
    ctx: click.Context,
    /,
    inputs: tuple[str, ...],
    out: str,
    messages: Messages,
    jobs: int | None,
    scheduler: str | None,
    config: str | None,
    settings: tuple[str, ...],
    **options: Any,
) -> None:
    """Analyse the clips of INPUTS, each into a folder of its own below -o, and make a table of all.

    INPUTS are clips, folders of clips, patterns, text files with a clip a line (.txt), or tables of clips (.csv with
    the column clip, and columns named like options: camera, platform, ...).

    \b
      ttcvid batch clips/ -o results --jobs 2
      ttcvid batch 'clips/**/front.mp4' batch.csv -o results --platform vehicle

    Results in the folder with the same input, version and configuration are kept: started again, a batch resumes
    where it was stopped. A clip that fails is tried once more, and does not stop the rest.

    Exit codes: 0 every clip is complete, 2 usage, configuration or output folder, 3 an input is not there, 4 some
    clips failed or end early, 130 stopped by a signal.
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    from ttcvid.cli.batch_progress import batch_progress
    from ttcvid.cli.main import EXIT_INTERRUPTED
    from ttcvid.cli.progress import compile_first, log_to_stderr
    from ttcvid.jobs.batch.run_batch import run_batch
    from ttcvid.jobs.settings.layers import layer_from_command_line

    log_to_stderr(quiet=messages.quiet, verbose=messages.verbose)
    compile_first(enabled=not messages.quiet)
    for_all = layer_from_command_line({name: as_text(value) for name, value in options.items()}, settings)
    try:
        with batch_progress(enabled=not messages.quiet) as (on_progress, on_failure):
            result = run_batch(
                inputs,
                Path(out),
                for_all,
                config=Path(config) if config else None,
                jobs=jobs,
                scheduler=scheduler,
                on_progress=on_progress,
                on_failure=on_failure,
            )
    except KeyboardInterrupt:
        click.echo("ttcvid: error: stopped at once: finished clips are kept, the same command goes on", err=True)
        ctx.exit(EXIT_INTERRUPTED)
    click.echo(result.summary_json() if messages.as_json else result.summary())
    ctx.exit(result.exit_code)
