"""The paper's roundabout, rendered, analysed, and held against its truth."""

from __future__ import annotations

import importlib.resources
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ttcvid.errors import OutputError
from ttcvid.jobs.analyze.run_analysis import OnFrame, run_analysis
from ttcvid.jobs.evaluate import EvaluatedRun, evaluate, write_page
from ttcvid.jobs.runs.run import Run
from ttcvid.jobs.settings.configuration import configure_from_arguments
from ttcvid.jobs.simulate import Simulation, simulate

SCENE_NAME, RESULT_NAME, PAGE_NAME = "scene", "result", "evaluation.html"


@dataclass(frozen=True)
class Demo:
    """The rendered scene, its analysis, how the two compare, and the page that shows it."""

    simulation: Simulation
    run: Run
    evaluated: EvaluatedRun
    page: Path


def demo(
    out: str | Path = "ttcvid_demo",
    *,
    overwrite: bool = False,
    n_frames: int | None = None,
    on_picture: Callable[[int, int], None] | None = None,
    on_frame: OnFrame | None = None,
) -> Demo:
    """Render the scene of the package into ``out/scene``, analyse it into ``out/result``, and evaluate.

    ``on_picture`` and ``on_frame`` are told of each picture rendered and analysed. OutputError where ``out`` exists
    and ``overwrite`` is not given, or holds other things.
    """
    out = Path(out)
    if out.exists() and not overwrite:
        raise OutputError(f"{out}: exists already: give --overwrite to replace the demo in it, or use -o")
    scene = importlib.resources.files("ttcvid.jobs") / "demo_scene.yaml"
    with importlib.resources.as_file(scene) as scene_path:
        simulation = simulate(scene_path, out / SCENE_NAME, n_frames=n_frames, overwrite=overwrite, progress=on_picture)
    options = {
        "camera": simulation.folder / "camera.yaml",
        "platform": "vehicle",
        "report": True,
        "overwrite": overwrite,
    }
    configuration = configure_from_arguments(options)
    run = run_analysis(str(simulation.input), out / RESULT_NAME, configuration, arguments=["demo"], on_frame=on_frame)
    evaluated = evaluate(run, simulation.folder)
    write_page(evaluated, out / PAGE_NAME)
    return Demo(simulation, run, evaluated, out / PAGE_NAME)
