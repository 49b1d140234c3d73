"""Files and folders with names that mean something to shells, terminals, FFmpeg, printf or patterns."""

import json
from pathlib import Path

import pytest
from attacked_runs import Attacker, contents, is_whole
from moving_clips import write_approaching_tracks

NAMES = ["-v", "two\nlines", "%d", "[a-z]*?", "\x1b[2J\x07"]
MORE_NAMES = [
    *("--help", " around ", "tab\t", 'it\'s "so"', "%06d", "{a,b}", "a:b", "http:x", "file:x", "pipe:0", "concat:x|y"),
    *(
        "~",
        "$HOME",
        ";ls",
        "&|><",
        "a\\b",
        "u\u0308",
        "名前",
        "\u202eabc",
        "x" * 200,
        ".hidden",
        "..x",
        "#1",
        "!x",
        "\x7f",
    ),
]


def attack(name: str, attacker: Attacker, folder: Path) -> None:
    input_ = write_approaching_tracks(folder / f"{name}.csv", n=5, n_tracks=20)
    before = contents(folder)
    options = ["--image-size", "192x128", "--no-overlay", "--no-report"]
    done = attacker.run(["analyze", *options, "-o", name, "--", input_.name], folder)
    assert done.exit_code == 0, done
    assert done.errors == []
    assert done.stdout.count("\n") == 1
    assert is_whole(folder / name)
    assert json.loads((folder / name / "manifest.json").read_text())["input"]["path"] == input_.name
    assert {path: content for path, content in contents(folder).items() if path in before} == before
    assert {path.name for path in folder.iterdir()} == {name, input_.name}
    missing = attacker.run(["analyze", *options, "--", f"{name}.mp4"], folder)
    assert missing.exit_code == 3, missing
    assert len(missing.errors) == 1
    for printed in (done.stdout, done.stderr, missing.stderr):
        assert all(letter.isprintable() or letter in "\n\u202e" for letter in printed)


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_a_hostile_name(name: str, attacker: Attacker, tmp_path: Path) -> None:
    attack(name, attacker, tmp_path)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", MORE_NAMES, ids=ascii)
def test_more_hostile_names(name: str, attacker: Attacker, tmp_path: Path) -> None:
    attack(name, attacker, tmp_path)
