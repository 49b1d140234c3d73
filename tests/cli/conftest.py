"""What tests of several commands share: a small simulated clip, rendered once."""

from pathlib import Path

import pytest
from compared_runs import simulated


@pytest.fixture(scope="session")
def small_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of a simulated drive with their times, camera and horizon."""
    return simulated(tmp_path_factory.mktemp("small_clip") / "scene")
