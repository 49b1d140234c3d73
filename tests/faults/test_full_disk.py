"""A disk that is full at a drawn moment: one line with the exit code of output, and no part of a result."""

import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from attacked_commands import SoundInputs, arguments_of
from attacked_runs import ORPHAN_S, Attacker, assert_sound, is_whole

ATTACKED = ["analyze", "calibrate-horizon", "collision-map", "evaluate", "report", "sensitivity", "simulate"]
DISK_BYTES = 4 << 20
N_ALL_SIZES = 6


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own, in memory."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("a file system can be mounted by root alone: the limit of file sizes is tried instead")
    yield disk
    _unmount(disk)


def _unmount(disk: Path) -> None:
    """Helpers of a process that has ended may hold files there for some seconds more."""
    for _ in range(round(2.0 * ORPHAN_S)):
        if subprocess.run(["umount", str(disk)], capture_output=True, check=False).returncode == 0:
            return
        time.sleep(1.0)
    subprocess.run(["umount", str(disk)], check=True)


def fill_but(n_bytes: int, disk: Path) -> None:
    filler = disk / "filler"
    filler.unlink(missing_ok=True)
    filler.write_bytes(bytes(max(shutil.disk_usage(disk).free - n_bytes, 0)))


def used_bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def fill_at_moments(command: str, n_sizes: int, attacker: Attacker, sound: SoundInputs, disk: Path) -> None:
    """The parts of a disk of which a run needs all are drawn: less than it needs, down to nothing."""
    out = disk / "out"
    out.mkdir()
    arguments = arguments_of(command, sound, out)
    first = attacker.run(arguments, disk)
    needed = used_bytes(out)
    rng = np.random.default_rng([ord(letter) for letter in command])
    for part in [0.0, *rng.uniform(0.0, 0.95, n_sizes)]:
        shutil.rmtree(out)
        out.mkdir()
        fill_but(int(part * needed), disk)
        attacked = attacker.run(arguments, disk)
        if attacked.exit_code == 2:
            assert len(attacked.errors) == 1, attacked.stderr
            assert "cannot be written" in attacked.errors[0]
        else:
            assert (attacked.exit_code, part > 0) == (first.exit_code, True)
        assert_sound(out)
    (disk / "filler").unlink()
    assert attacker.run(arguments, disk).exit_code == first.exit_code
    assert_sound(out)


@pytest.mark.parametrize("command", ["analyze", "simulate", "evaluate"])
def test_a_full_disk(command: str, attacker: Attacker, sound: SoundInputs, small_disk: Path) -> None:
    fill_at_moments(command, 1, attacker, sound, small_disk)


@pytest.mark.exhaustive
@pytest.mark.parametrize("command", ATTACKED)
def test_a_disk_that_is_full_at_drawn_moments(
    command: str, attacker: Attacker, sound: SoundInputs, small_disk: Path
) -> None:
    fill_at_moments(command, N_ALL_SIZES, attacker, sound, small_disk)


def test_files_that_may_not_grow(attacker: Attacker, sound: SoundInputs, tmp_path: Path) -> None:
    """For where no file system can be mounted."""
    done = attacker.run(arguments_of("analyze", sound, tmp_path), tmp_path, largest_file_bytes=3000)
    assert done.exit_code == 2
    assert len(done.errors) == 1, done.stderr
    assert "cannot be written" in done.errors[0]
    assert not is_whole(tmp_path / "run")
