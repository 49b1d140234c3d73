"""``ttcvid simulate``: a scene file becomes a clip, or point tracks, with exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Output folder (default: SCENE_scene).")
@click.option("--overwrite", is_flag=True, help="Replace the folder of a former simulation.")
@click.option("--png", is_flag=True, help="Loss-free pictures in frames/ and timestamps.txt instead of clip.mp4.")
@click.option("--seed", type=click.IntRange(min=0), help="Instead of the scene's own seed.")
@click.option("--frames", "n_frames", type=click.IntRange(min=1), help="Only the first pictures.")
@click.option("--tracks", "as_tracks", is_flag=True, help="Point tracks with truth instead of pictures.")
@click.option("--n-tracks", type=click.IntRange(min=1), default=400, show_default=True, help="Tracks alive at a time.")
@click.option("--sigma-px", type=click.FloatRange(min=0), default=0.2, show_default=True, help="Noise of the tracks.")
@click.option(
    "--outliers",
    "outlier_fraction",
    type=click.FloatRange(0, 1),
    default=0.0,
    show_default=True,
    help="Fraction of outliers.",
)
@click.option(
    "--deaths", "death_rate", type=click.FloatRange(0, 1), default=0.01, show_default=True, help="Deaths per frame."
)
@click.option("--births/--no-births", default=True, show_default=True, help="Whether tracks start after frame 0.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of the summary line.")
@click.option("-q", "--quiet", is_flag=True, help="No summary and no progress.")
def simulate(
    scene: Path,
    out: Path | None,
    overwrite: bool,
    png: bool,
    seed: int | None,
    n_frames: int | None,
    as_json: bool,
    quiet: bool,
    **tracks: Any,
) -> None:
    """Simulate SCENE (a YAML file) into a folder: clip, camera, horizon and the truth of every frame and object."""
    import json

    from ttcvid.cli.progress import progress_on_stderr
    from ttcvid.errors import counted
    from ttcvid.jobs.simulate import simulate as run
    from ttcvid.simulate.tracks import TrackOptions

    are_asked = tracks.pop("as_tracks")
    with progress_on_stderr(enabled=not quiet) as progress:
        result = run(
            scene,
            out,
            png=png,
            tracks=TrackOptions(**tracks) if are_asked else None,
            seed=seed,
            n_frames=n_frames,
            overwrite=overwrite,
            progress=progress,
        )
    if as_json:
        summary = {"folder": str(result.folder), "input": str(result.input), "scene": result.name}
        counts = {"n_frames": result.n_frames, "n_objects": result.n_objects, "n_observations": result.n_observations}
        click.echo(json.dumps({**summary, **counts}))
    elif not quiet:
        what = f", {result.n_observations} observations of tracks" if result.n_observations is not None else ""
        size = f"{counted(result.n_frames, 'frame')}, {counted(result.n_objects, 'object')}"
        click.echo(f"{result.input}: scene {result.name}, {size}{what}")
