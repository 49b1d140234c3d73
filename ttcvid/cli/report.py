"""``ttcvid report``: a page of finished runs."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(short_help="A page that shows a run, or several side by side, in any browser.")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--out",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="The page.  [default, of one run: RUN/report.html]",
)
def report(runs: tuple[Path, ...], out: Path | None) -> None:
    """Write a page of each RUN (the output folder of analyze): summary, video, warnings, times with their intervals.

    It opens offline; a click on a warning, a plot or a direction shows that frame of the video. Of several runs, what
    they differ in comes first, then all of them side by side.

    \b
      ttcvid report clip_ttc
      ttcvid report yesterday today -o both.html
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    from ttcvid.jobs.report import report as write_report

    click.echo(str(write_report(*runs, out=out)))
