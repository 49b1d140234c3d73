"""``ttcvid demo``: see it work without any data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from ttcvid.jobs.demo import Comparison


@click.command()
@click.option("-o", "--out", metavar="FOLDER", default="ttcvid_demo", show_default=True, help="Output folder.")
@click.option("--overwrite", is_flag=True, help="Replace the demo in a folder that exists.")
@click.option("--frames", "n_frames", type=click.IntRange(min=1), help="Only the first pictures.")
@click.option("-q", "--quiet", is_flag=True, help="No progress and no warnings on stderr.")
@click.pass_context
def demo(ctx: click.Context, /, out: str, overwrite: bool, n_frames: int | None, quiet: bool) -> None:
    """Render a street with two moving cars and known truth, analyse the clip, and say where to look."""
    from ttcvid.cli.progress import log_to_stderr, progress_on_terminal
    from ttcvid.jobs.demo import demo as run_demo

    log_to_stderr(quiet=quiet)
    with progress_on_terminal(enabled=not quiet) as progress:
        result = run_demo(out, overwrite=overwrite, n_frames=n_frames, on_picture=progress, on_frame=progress)
    click.echo(result.run.summary())
    click.echo(f"look at  {result.run.overlay}")
    click.echo(f"tables   {result.run.folder}/*.parquet")
    click.echo(f"truth    {result.simulation.folder}/truth_*.parquet")
    for comparison in result.comparisons:
        click.echo(describe(comparison))
    ctx.exit(result.run.exit_code)


def describe(comparison: Comparison) -> str:
    """One line: the estimated against the true time of a mover, at the last frame in which it was found."""
    if comparison.matches.empty:
        return f"{comparison.name}: not found in any of {comparison.n_visible} frames"
    last = comparison.matches.iloc[-1]
    return (
        f"{comparison.name}: found in {len(comparison.matches)} of {comparison.n_visible} frames, time to collision "
        f"off by {100 * comparison.median_error:.1f} % (median); at frame {int(last.frame)} {last.estimated_s:.2f} s "
        f"(90 %: {last.lo_s:.2f} to {last.hi_s:.2f}), in truth {last.true_s:.2f} s"
    )
