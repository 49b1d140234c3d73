"""The benchmarks are scripts of a folder of their own: their helper functions are imported from there.

What they compute is drawn as the tests of the geometry draw it.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
for folder in (REPOSITORY / "benchmarks", REPOSITORY / "tests" / "geometry"):
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


DONE_FAMILIES, DONE_SEED = ("mast-crossing", "CCRs"), 5


@pytest.fixture(scope="session")
def done_scenes(made_once: Callable[..., Path]) -> list[Path]:
    """Folders of two scenes of the suite, drawn, analysed and scored; nobody changes them."""
    from scenario_suite.running import Task, do

    def make(place: Path) -> None:
        for family in DONE_FAMILIES:
            do(Task(family, DONE_SEED, "tracks", place / "out", place / "pictures"))

    place = made_once("scenes", make)
    return [place / "out" / family / str(DONE_SEED) for family in DONE_FAMILIES]
