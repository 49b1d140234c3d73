import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ttcvid.errors import OutputError
from ttcvid.sinks import folder as folder_module
from ttcvid.sinks.folder import PARTIAL_NAME, OutputFolder
from ttcvid.sinks.manifest import read_manifest

MANIFEST = {"state": "complete"}


def make_run(out: Path, files: dict[str, str], overwrite: bool = False):
    with OutputFolder.create(out, overwrite) as folder:
        for name, text in files.items():
            (folder.partial / name).write_text(text)
        folder.publish(MANIFEST)


def content(out: Path) -> dict[str, str]:
    return {file.name: file.read_text() for file in out.iterdir() if file.is_file() and file.name != "manifest.json"}


def is_complete(out: Path) -> bool:
    """What a user can check: there is a manifest, and each file that it lists is there with its size."""
    if not (out / "manifest.json").exists():
        return False
    sizes = read_manifest(out)["files"]
    assert {name: (out / name).stat().st_size for name in sizes} == sizes
    return True


def test_a_published_run_holds_its_files_and_a_manifest_with_their_sizes(tmp_path):
    out = tmp_path / "deep" / "out"
    make_run(out, {"frames.parquet": "abc", "overlay.mp4": "de"})
    assert read_manifest(out)["files"] == {"frames.parquet": 3, "overlay.mp4": 2}
    assert read_manifest(out)["state"] == "complete"
    assert sorted(os.listdir(out)) == ["frames.parquet", "manifest.json", "overlay.mp4"]


def test_nothing_is_seen_before_publication(tmp_path):
    folder = OutputFolder.create(tmp_path / "out")
    (folder.partial / "frames.parquet").write_text("abc")
    assert os.listdir(tmp_path / "out") == [PARTIAL_NAME]
    folder.abandon()


def test_abandoned_new_folder_is_gone(tmp_path):
    with OutputFolder.create(tmp_path / "out") as folder:
        (folder.partial / "frames.parquet").write_text("abc")
    assert not any(tmp_path.iterdir())


def test_existing_folder_is_refused_without_overwrite(tmp_path):
    make_run(tmp_path / "out", {"frames.parquet": "old"})
    with pytest.raises(OutputError, match="exists already: give --overwrite"):
        OutputFolder.create(tmp_path / "out")
    assert content(tmp_path / "out") == {"frames.parquet": "old"}


def test_overwrite_replaces_former_files_and_removes_those_no_longer_made(tmp_path):
    out = tmp_path / "out"
    make_run(out, {"frames.parquet": "old", "overlay.mp4": "old"})
    make_run(out, {"frames.parquet": "newer", "clusters.parquet": "new"}, overwrite=True)
    assert content(out) == {"frames.parquet": "newer", "clusters.parquet": "new"}
    assert is_complete(out)


def test_abandoned_overwrite_leaves_the_former_result(tmp_path):
    out = tmp_path / "out"
    make_run(out, {"frames.parquet": "old"})
    with OutputFolder.create(out, overwrite=True) as folder:
        (folder.partial / "frames.parquet").write_text("new")
    assert content(out) == {"frames.parquet": "old"}
    assert is_complete(out)
    assert not (out / PARTIAL_NAME).exists()


def test_empty_folder_can_be_overwritten_and_stays_when_abandoned(tmp_path):
    with OutputFolder.create(tmp_path, overwrite=True):
        pass
    assert tmp_path.is_dir()
    make_run(tmp_path, {"frames.parquet": "new"}, overwrite=True)
    assert is_complete(tmp_path)


def test_foreign_files_beside_a_result_stay(tmp_path):
    out = tmp_path / "out"
    make_run(out, {"frames.parquet": "old"})
    (out / "notes.txt").write_text("mine")
    make_run(out, {"frames.parquet": "new"}, overwrite=True)
    assert content(out) == {"frames.parquet": "new", "notes.txt": "mine"}


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("holiday.jpg", "x", "holds files but no result of ttcvid"),
        ("frames.parquet", "x", "holds files but no result of ttcvid"),
        ("manifest.json", '{"name": "web app"}', "manifest.json that is not ttcvid's"),
    ],
)
def test_folder_of_another_origin_is_never_overwritten(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(OutputError, match=words):
        OutputFolder.create(tmp_path, overwrite=True)
    assert os.listdir(tmp_path) == [name]
    assert (tmp_path / name).read_text() == text


def test_foreign_file_with_a_name_that_the_run_needs_is_found_before_the_run(tmp_path):
    make_run(tmp_path / "out", {"frames.parquet": "old"})
    (tmp_path / "out" / "overlay.mp4").write_text("mine")
    with pytest.raises(OutputError, match=r"overlay\.mp4: not a file of a former run"):
        OutputFolder.create(tmp_path / "out", overwrite=True)


def test_edited_manifest_cannot_make_us_delete_elsewhere(tmp_path):
    (tmp_path / "precious").write_text("mine")
    out = tmp_path / "out"
    make_run(out, {"frames.parquet": "old"})
    text = (out / "manifest.json").read_text()
    (out / "manifest.json").write_text(text.replace('"frames.parquet"', '"../precious": 1, "frames.parquet"'))
    make_run(out, {"frames.parquet": "new"}, overwrite=True)
    assert (tmp_path / "precious").read_text() == "mine"


def test_file_in_place_of_the_folder_or_of_its_parent_is_refused(tmp_path):
    (tmp_path / "file").write_text("x")
    for overwrite in (False, True):
        with pytest.raises(OutputError, match="is not a folder"):
            OutputFolder.create(tmp_path / "file", overwrite)
        with pytest.raises(OutputError, match="a part of the path is a file"):
            OutputFolder.create(tmp_path / "file" / "out", overwrite)
        with pytest.raises(OutputError, match="a part of the path is a file"):
            OutputFolder.create(tmp_path / "file" / "deep" / "out", overwrite)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_parent_that_cannot_be_written_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="permission denied"):
        OutputFolder.create(tmp_path / "out")


@pytest.mark.parametrize("code", [errno.EACCES, errno.EROFS, errno.ENOSPC])
def test_folder_that_cannot_be_made_is_one_line_with_remedy(tmp_path, monkeypatch, code):
    def fail(*_, **__):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(Path, "mkdir", fail)
    with pytest.raises(OutputError, match=r"out: cannot be written, .*-o") as caught:
        OutputFolder.create(tmp_path / "out")
    assert "\n" not in str(caught.value)


def test_full_disk_while_preparing_leaves_nothing(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(folder_module, "_write_names", full)
    with pytest.raises(OutputError, match="the disk is full"):
        OutputFolder.create(tmp_path / "out")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("step", ["_sync_file", "write_manifest", "sync_folder", "_remove"])
def test_failed_publication_leaves_no_manifest_that_lies(tmp_path, monkeypatch, step):
    out = tmp_path / "out"
    make_run(out, {"frames.parquet": "old", "overlay.mp4": "old"})
    folder = OutputFolder.create(out, overwrite=True)
    (folder.partial / "frames.parquet").write_text("newer")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(folder_module, step, full)
        with pytest.raises((OutputError, OSError)):
            folder.publish(MANIFEST)
    folder.abandon()
    if is_complete(out):
        assert content(out) == {"frames.parquet": "old", "overlay.mp4": "old"}
    assert not (out / PARTIAL_NAME).exists()


def test_manifest_that_is_not_json_is_found_before_the_former_result_is_touched(tmp_path):
    out = tmp_path / "out"
    make_run(out, {"frames.parquet": "old"})
    with OutputFolder.create(out, overwrite=True) as folder:
        (folder.partial / "frames.parquet").write_text("new")
        with pytest.raises(ValueError, match="not JSON compliant"):
            folder.publish({"fps": float("nan")})
    assert content(out) == {"frames.parquet": "old"}
    assert is_complete(out)


def test_unannounced_file_is_a_programming_error(tmp_path):
    with OutputFolder.create(tmp_path / "out") as folder:
        (folder.partial / "surprise.bin").write_text("x")
        with pytest.raises(ValueError, match="surprise"):
            folder.publish(MANIFEST)


def test_second_run_into_the_same_folder_is_refused_while_the_first_works(tmp_path):
    out = tmp_path / "out"
    with OutputFolder.create(out) as first:
        (first.partial / "frames.parquet").write_text("first")
        with pytest.raises(OutputError, match="another run is writing there"):
            OutputFolder.create(out)
        with pytest.raises(OutputError, match="another run is writing there"):
            OutputFolder.create(out, overwrite=True)
        first.publish(MANIFEST)
    assert content(out) == {"frames.parquet": "first"}


# Runs into out1, out2, ...; the i-th is killed at the i-th moment at which it is about to change the disk.
KILLED_RUNS = """
import os, signal, sys
from pathlib import Path
from ttcvid.sinks import folder as module

def run(out, kill_at):
    n_calls = 0

    def dies_at_its_turn(function):
        def wrapped(*args, **kwargs):
            nonlocal n_calls
            n_calls += 1
            if n_calls == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*args, **kwargs)
        return wrapped

    for owner, name in [(Path, "mkdir"), (Path, "unlink"), (Path, "replace"), (Path, "rmdir"), (Path, "write_text"),
                        (Path, "open"), (os, "fsync"), (os, "open"), (module.shutil, "rmtree"), (module.json, "dump")]:
        setattr(owner, name, dies_at_its_turn(getattr(owner, name)))
    with module.OutputFolder.create(out, overwrite=True) as folder:
        for name in ("frames.parquet", "clusters.parquet"):
            (folder.partial / name).write_text("new")
        folder.publish({"state": "complete"})

for i in range(1, int(sys.argv[2]) + 1):
    child = os.fork()
    if child == 0:
        run(Path(sys.argv[1]) / f"out{i}", i)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
N_MOMENTS = 42  # more than a run has, so that the last ones are not killed


@pytest.mark.parametrize("former", ["none", "complete", "killed while publishing"])
def test_killed_at_any_moment_nothing_passes_for_complete_and_the_next_run_mends_it(tmp_path, former):
    outs = [tmp_path / f"out{i}" for i in range(1, N_MOMENTS + 1)]
    for out in outs if former != "none" else []:
        make_run(out, {"frames.parquet": "former", "overlay.mp4": "former"})
        if former == "killed while publishing":
            (out / "manifest.json").unlink()
            (out / PARTIAL_NAME).mkdir()
            (out / PARTIAL_NAME / ".lock").write_text('["frames.parquet", "overlay.mp4", "clusters.parquet"]')
    command = [sys.executable, "-c", KILLED_RUNS, str(tmp_path), str(N_MOMENTS)]
    runs = subprocess.run(command, capture_output=True, text=True, check=True)
    exit_codes = [int(line) for line in runs.stdout.split()]
    assert set(exit_codes) == {-signal.SIGKILL, 0}, runs.stderr
    assert exit_codes[-1] == 0

    seen = set()
    for out, exit_code in zip(outs, exit_codes, strict=True):
        if out.exists() and is_complete(out):
            result = content(out)
            assert result in (
                {"frames.parquet": "former", "overlay.mp4": "former"},
                {"frames.parquet": "new", "clusters.parquet": "new"},
            )
            seen.add(result["frames.parquet"])
        else:
            assert exit_code == -signal.SIGKILL
            seen.add("incomplete")
        make_run(out, {"frames.parquet": "third"}, overwrite=True)
        assert content(out) == {"frames.parquet": "third"}, out
        assert is_complete(out)
    assert seen == {"new", "incomplete"} | ({"former"} if former == "complete" else set())
