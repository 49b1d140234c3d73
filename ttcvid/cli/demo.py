"""``ttcvid demo``: see it work without any data."""

from __future__ import annotations

import click

SHOWN = {
    "median error of own direction": "epipole_scene.median",
    "of own rotation": "rotation.median",
    "of objects' time to collision": "ttc_z.median",
    "tracks in the right group": "tracks.right",
}
"""What a first look needs; 'ttcvid evaluate' and the page say the rest."""


@click.command()
@click.option("-o", "--out", metavar="FOLDER", default="ttcvid_demo", show_default=True, help="Output folder.")
@click.option("--overwrite", is_flag=True, help="Replace the demo in a folder that exists.")
@click.option("--frames", "n_frames", type=click.IntRange(min=1), help="Only the first pictures.")
@click.option("-q", "--quiet", is_flag=True, help="No progress and no warnings on stderr.")
@click.pass_context
def demo(ctx: click.Context, /, out: str, overwrite: bool, n_frames: int | None, quiet: bool) -> None:
    """Render a roundabout with a bus, a lorry, a car and known truth, analyse the clip, and say where to look."""
    from ttcvid.cli.progress import compile_first, log_to_stderr, progress_on_stderr
    from ttcvid.jobs.demo import demo as run_demo
    from ttcvid.studies.evaluation.wording import describe_object, describe_value

    log_to_stderr(quiet=quiet)
    compile_first(enabled=not quiet)
    with progress_on_stderr(enabled=not quiet) as progress:
        result = run_demo(out, overwrite=overwrite, n_frames=n_frames, on_picture=progress, on_frame=progress)
    evaluation = result.evaluated.evaluation
    click.echo(result.run.summary())
    click.echo(f"look at  {result.run.overlay}")
    click.echo(f"tables   {result.run.folder}/*.parquet")
    click.echo(f"truth    {result.simulation.folder}/truth_*.parquet")
    click.echo(f"errors   {result.page}")
    values = [f"{words} {describe_value(name, evaluation.metrics[name])}" for words, name in SHOWN.items()]
    click.echo(", ".join(values))
    for judged in evaluation.objects:
        click.echo(describe_object(judged))
    click.echo(f"report   {result.run.report}")
    ctx.exit(result.run.exit_code)
