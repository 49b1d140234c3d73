"""Links, pipes and foreign files in output folders: nothing of others is touched, and nothing hangs."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from ttcvid.errors import InputError, OutputError
from ttcvid.jobs.simulate import MARKER_NAME, simulate
from ttcvid.simulate import TrackOptions
from ttcvid.sinks.folder import LOCK_NAME, PARTIAL_NAME, OutputFolder
from ttcvid.sinks.manifest import read_manifest
from ttcvid.sinks.whole_text import write_whole

SCENE = Path(__file__).resolve().parents[2] / "sample_configs" / "scenes" / "resting_six_movers.yaml"
PRECIOUS = {"letter.txt": "mine", "deep/picture.png": "mine, too"}


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A folder of somebody else."""
    for name, text in PRECIOUS.items():
        path = tmp_path / "elsewhere" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "elsewhere"


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """The output folder of a former run."""
    out = tmp_path / "out"
    with OutputFolder.create(out) as folder:
        (folder.partial / "frames.parquet").write_text("former")
        folder.publish({"state": "complete"})
    return out


def partial_is_a_link(out: Path, elsewhere: Path) -> Path:
    (out / PARTIAL_NAME).symlink_to(elsewhere)
    return out / PARTIAL_NAME


def lock_is(make: Callable[[Path, Path], None]) -> Callable[[Path, Path], Path]:
    def attack(out: Path, elsewhere: Path) -> Path:
        (out / PARTIAL_NAME).mkdir()
        make(out / PARTIAL_NAME / LOCK_NAME, elsewhere)
        return out / PARTIAL_NAME / LOCK_NAME

    return attack


def manifest_is(make: Callable[[Path, Path], None]) -> Callable[[Path, Path], Path]:
    def attack(out: Path, elsewhere: Path) -> Path:
        (out / "manifest.json").unlink()
        make(out / "manifest.json", elsewhere)
        return out / "manifest.json"

    return attack


def result_is(make: Callable[[Path, Path], None]) -> Callable[[Path, Path], Path]:
    def attack(out: Path, elsewhere: Path) -> Path:
        (out / "frames.parquet").unlink()
        make(out / "frames.parquet", elsewhere)
        return out / "frames.parquet"

    return attack


def link(path: Path, elsewhere: Path) -> None:
    path.symlink_to(elsewhere / "letter.txt")


def dangling_link(path: Path, elsewhere: Path) -> None:
    path.symlink_to(elsewhere / "not there")


def hard_link(path: Path, elsewhere: Path) -> None:
    path.hardlink_to(elsewhere / "letter.txt")


def pipe(path: Path, elsewhere: Path) -> None:
    os.mkfifo(path)


def folder(path: Path, elsewhere: Path) -> None:
    path.mkdir()


ATTACKS = {
    "partial link": partial_is_a_link,
    **{f"lock {kind.__name__}": lock_is(kind) for kind in (link, dangling_link, hard_link, pipe, folder)},
    **{f"manifest {kind.__name__}": manifest_is(kind) for kind in (link, dangling_link, pipe, folder)},
    **{f"result {kind.__name__}": result_is(kind) for kind in (link, dangling_link, pipe, folder)},
}


def content_of(folder: Path) -> dict[str, str]:
    """Text of every plain file, where links lead for every link, and the kind of everything else."""
    return {
        str(path.relative_to(folder)): f"-> {path.readlink()}"
        if path.is_symlink()
        else path.read_text()
        if path.is_file()
        else "folder"
        if path.is_dir()
        else "device"
        for path in folder.rglob("*")
    }


@pytest.mark.parametrize("overwrite", [True, False])
@pytest.mark.parametrize("attack", ATTACKS.values(), ids=ATTACKS)
def test_what_ttcvid_never_makes_is_neither_followed_nor_removed(
    out: Path, elsewhere: Path, attack: Callable[[Path, Path], Path], overwrite: bool
) -> None:
    place = attack(out, elsewhere)
    before = content_of(out.parent)
    with pytest.raises(OutputError) as caught:
        OutputFolder.create(out, overwrite)
    assert str(place if overwrite else out) in str(caught.value)
    assert content_of(out.parent) == before


def test_the_output_folder_itself_may_be_a_link(out: Path) -> None:
    """It is what the user named: a large disk, say."""
    name = out.with_name("results")
    name.symlink_to(out)
    with OutputFolder.create(name, overwrite=True) as folder:
        (folder.partial / "frames.parquet").write_text("new")
        folder.publish({"state": "complete"})
    assert (out / "frames.parquet").read_text() == "new"


def test_a_link_between_preparation_and_end_is_not_followed(out: Path, elsewhere: Path) -> None:
    before = content_of(elsewhere)
    with OutputFolder.create(out, overwrite=True) as folder:
        os.rename(folder.partial, out / "moved")
        folder.partial.symlink_to(elsewhere)
    assert content_of(elsewhere) == before


def test_a_manifest_that_is_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "manifest.json")
    with pytest.raises(InputError, match="no plain file"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("make", [link, dangling_link, hard_link, pipe], ids=lambda make: make.__name__)
def test_a_text_is_not_written_through_what_stands_at_its_temporary_name(
    tmp_path: Path, elsewhere: Path, make: Callable[[Path, Path], None]
) -> None:
    make(tmp_path / ".page.html.partial", elsewhere)
    before = content_of(elsewhere)
    write_whole(tmp_path / "page.html", "new")
    assert (tmp_path / "page.html").read_text() == "new"
    assert content_of(elsewhere) == before


def test_simulate_replaces_its_own_folder_and_nothing_else(tmp_path: Path, elsewhere: Path) -> None:
    def again(out: Path) -> None:
        simulate(SCENE, out, tracks=TrackOptions(n_tracks=20), n_frames=4, overwrite=True)

    again(tmp_path / "sim")
    again(tmp_path / "sim")
    (tmp_path / "sim" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt: not a file of a simulation"):
        again(tmp_path / "sim")
    assert (tmp_path / "sim" / "notes.txt").read_text() == "mine"
    (elsewhere / MARKER_NAME).write_text("{}")
    (elsewhere / "truth_frames.parquet").write_text("")
    (tmp_path / "link").symlink_to(elsewhere)
    before = content_of(elsewhere)
    with pytest.raises(OutputError, match="a link"):
        again(tmp_path / "link")
    assert content_of(elsewhere) == before
    assert (tmp_path / "link").is_symlink()
