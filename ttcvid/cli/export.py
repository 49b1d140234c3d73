"""``ttcvid export``: a finished run in the formats of other tools."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(short_help="A run in the formats of other tools: csv, mot, coco, rrd (Rerun), mcap (Foxglove).")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--to", "format_", metavar="FORMAT", required=True, help="csv, mot, coco, rrd or mcap.")
@click.option("--table", metavar="NAME", help="Of csv: this table alone, such as clusters.")
@click.option(
    "-o",
    "--out",
    metavar="PATH",
    type=click.Path(path_type=Path),
    help="The file; of all tables as csv, the folder.  [default: named after RUN, in the working folder]",
)
@click.option("--overwrite", is_flag=True, help="Replace what exists.")
@click.option("-q", "--quiet", is_flag=True, help="No warnings on stderr.")
def export(run: Path, format_: str, table: str | None, out: Path | None, overwrite: bool, quiet: bool) -> None:
    """Write RUN (the output folder of analyze) as files that other tools read, and print where.

    \b
      ttcvid export clip_ttc --to csv                      all tables, into clip_ttc_csv/
      ttcvid export clip_ttc --to csv --table clusters     one table
      ttcvid export clip_ttc --to mot -o det.txt           boxes of objects, MOT Challenge
      ttcvid export clip_ttc --to coco                     boxes and tracks, COCO
      ttcvid export clip_ttc --to rrd                      for the Rerun viewer (pip install 'ttcvid[rrd]')
      ttcvid export clip_ttc --to mcap                     for Foxglove (pip install 'ttcvid[mcap]')
    """  # noqa: D301  the \b is click's mark of lines to keep as they are
    from ttcvid.cli.progress import log_to_stderr
    from ttcvid.jobs.export import export as export_run

    log_to_stderr(quiet=quiet)
    click.echo(str(export_run(run, format_, out, table=table, overwrite=overwrite)))
