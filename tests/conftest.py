"""What all tests share: the place of the real clips, compiled code, and a quiet, single-threaded numerics library."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

from ttcvid.jobs.processes.compilation import compile_missing

# The first call of a compiled function takes seconds, which is no fault of the case that makes it. The same cases in
# every run: a change is not to be judged by what chance finds in other code.
settings.register_profile("compiled", deadline=None, derandomize=True)
settings.load_profile("compiled")


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile what is missing, once, before any worker starts: a command that did would say so on standard error."""
    if not hasattr(session.config, "workerinput") and not session.config.option.collectonly:
        compile_missing()


REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real clips; a test that asks for it is skipped where they are absent."""
    folder = Path(os.environ.get("TTCVID_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real clips not found in {folder}: set TTCVID_DATA to their folder")
    return folder
