"""What all tests share: the place of the real clips, and a quiet, single-threaded numerics library."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# The first call of a compiled function takes seconds, which is no fault of the case that makes it. The same cases in
# every run: a change is not to be judged by what chance finds in other code.
settings.register_profile("compiled", deadline=None, derandomize=True)
settings.load_profile("compiled")

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real clips; a test that asks for it is skipped where they are absent."""
    folder = Path(os.environ.get("TTCVID_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real clips not found in {folder}: set TTCVID_DATA to their folder")
    return folder
