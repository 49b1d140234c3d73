"""kill -9 at drawn moments of every command: what is left is sound, nothing runs on, and the next run mends it."""

import signal
from pathlib import Path

import numpy as np
import pytest
from attacked_commands import ATTACKS, SoundInputs, arguments_of
from attacked_runs import Attacker, assert_sound, contents

from ttcvid.cli.commands import COMMANDS

COMMANDS_THAT_WRITE_NOTHING = {"doctor"}
N_MOMENTS, N_ALL_MOMENTS = 2, 30
ONLY_WITH_ALL = {"demo", "regress"}
"""Simulation, analysis and evaluation in a row; and tests/cli/test_regress.py kills a regression."""


def hidden(folder: Path) -> set[Path]:
    """Hidden files: besides the lock of a batch, what was not finished."""
    return {path for path in folder.rglob("*") if path.name.startswith(".")}


def kill_at_moments(command: str, n_moments: int, attacker: Attacker, sound: SoundInputs, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    arguments = arguments_of(command, sound, out)
    first = attacker.run(arguments, tmp_path)
    duration_s = first.duration_s
    assert first.exit_code in (0, 1, 5), first
    before, hidden_at_first = contents(sound.folder), hidden(out)
    rng = np.random.default_rng([ord(letter) for letter in command])
    n_killed = 0
    for part in rng.uniform(0.0, 1.05, n_moments):
        attacked = attacker.run(arguments, tmp_path, kill_after_s=part * duration_s)
        n_killed += attacked.exit_code == -signal.SIGKILL
        if attacked.exit_code == first.exit_code:  # it came before the kill: the first run may have had to compile
            duration_s = min(duration_s, attacked.duration_s)
        assert_sound(out)
    assert n_killed >= n_moments // 3
    assert contents(sound.folder) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    last = attacker.run(arguments, tmp_path)
    assert (last.exit_code, last.errors) == (first.exit_code, first.errors)
    assert hidden(out) == hidden_at_first
    assert_sound(out)


@pytest.mark.parametrize("command", sorted(set(ATTACKS) - ONLY_WITH_ALL))
def test_killed_at_some_moments(command: str, attacker: Attacker, sound: SoundInputs, tmp_path: Path) -> None:
    kill_at_moments(command, N_MOMENTS, attacker, sound, tmp_path)


@pytest.mark.exhaustive
@pytest.mark.parametrize("command", ATTACKS)
def test_killed_at_thirty_moments(command: str, attacker: Attacker, sound: SoundInputs, tmp_path: Path) -> None:
    kill_at_moments(command, N_ALL_MOMENTS, attacker, sound, tmp_path)


def test_every_command_is_attacked() -> None:
    assert set(ATTACKS) | COMMANDS_THAT_WRITE_NOTHING == set(COMMANDS)
