"""What all tests share: the place of the real clips, compiled code, and a quiet, single-threaded numerics library."""

import gc
import os
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import pytest
from compared_runs import analyzed, simulated
from filelock import FileLock
from hypothesis import settings

from ttcvid.jobs.analyze import beside
from ttcvid.jobs.processes.compilation import compile_missing
from ttcvid.jobs.processes.side_by_side import ReadAhead
from ttcvid.posix import can_copy_process

# The first call of a compiled function takes seconds, which is no fault of the case that makes it. The same cases in
# every run: a change is not to be judged by what chance finds in other code.
settings.register_profile("compiled", deadline=None, derandomize=True)
settings.load_profile("compiled")

# Two workers share the cores: more threads only wait for one another.
cv2.setNumThreads(1)


# What is imported and collected lives to the end: to look through it for garbage again and again, while it grows and in
# every test, takes a sixth of the time.
gc.disable()


def pytest_collection_finish() -> None:
    """Look for garbage from now on, but not in what is there already."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile what is missing, once, before any worker starts: a command that did would say so on standard error."""
    if not hasattr(session.config, "workerinput") and not session.config.option.collectonly:
        compile_missing()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests first: those that are left at the end take a moment each."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session", autouse=True)
def _geometry_in_a_thread() -> Iterator[None]:
    """The copy of a process with all tests in it takes as long as the analysis of a small clip: a thread does its work.

    Items and results are pickled and read again, as on their way to a process and back. The results are the same, which
    tests/jobs/test_determinism.py holds; commands that tests begin have their copies.
    """

    class Sent(ReadAhead):
        def __iter__(self):
            return (pickle.loads(pickle.dumps(item)) for item in super().__iter__())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(beside, "can_copy_process", lambda: False)
        patch.setattr(beside, "ReadAhead", Sent)
        yield


@pytest.fixture
def geometry_in_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Analyses as a command makes them, where processes can be copied: what is shown is that of the process."""
    monkeypatch.setattr(beside, "can_copy_process", can_copy_process)


REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real clips; a test that asks for it is skipped where they are absent."""
    folder = Path(os.environ.get("TTCVID_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real clips not found in {folder}: set TTCVID_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def made_once(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """A place filled by ``make(place)`` for all workers of the session, by whoever asks first; nobody changes it."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if hasattr(request.config, "workerinput") else base) / "made_once"
    folder.mkdir(exist_ok=True)

    def filled(name: str, make: Callable[[Path], object]) -> Path:
        is_made = folder / f"{name}.made"
        with FileLock(folder / f"{name}.lock"):
            if not is_made.exists():
                make(folder / name)
                is_made.touch()
        return folder / name

    return filled


@pytest.fixture(scope="session")
def small_clip(made_once: Callable[..., Path]) -> Path:
    """Pictures of a simulated drive with their times, camera and horizon."""
    return made_once("small_clip", simulated)


@pytest.fixture(scope="session")
def small_run(made_once: Callable[..., Path], small_clip: Path) -> Path:
    """The folder of a run over the small clip, with as many tracks as it usually has."""
    return made_once("small_run", lambda folder: analyzed(small_clip, folder, tracking={}))


@pytest.fixture(scope="session")
def few_tracks_run(made_once: Callable[..., Path], small_clip: Path) -> Path:
    """The folder of a run over the small clip with few tracks: what other runs are compared with."""
    return made_once("few_tracks_run", lambda folder: analyzed(small_clip, folder))


@pytest.fixture(scope="session")
def horizon_run(made_once: Callable[..., Path], small_clip: Path) -> Path:
    """The same with the horizon of the clip."""
    return made_once("horizon_run", lambda folder: analyzed(small_clip, folder, horizon=small_clip / "horizon.yaml"))
