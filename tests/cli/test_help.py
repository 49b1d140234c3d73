"""Help answers at once and tells the truth."""

import os
import shlex
import subprocess
import sys
from typing import get_args

import pytest

from ttcvid.cli.analysis_options import ESTIMATORS, PLATFORMS
from ttcvid.cli.analyze import analyze
from ttcvid.cli.calibrate_horizon import calibrate_horizon
from ttcvid.cli.clip_options import TRACKERS
from ttcvid.cli.commands import COMMANDS
from ttcvid.cli.main import main
from ttcvid.config import CollisionTimesConfig, TrackingConfig
from ttcvid.jobs.settings.options import SHORTCUTS, AnalyzeOptions
from ttcvid.model import Platform

HEAVY = ("numpy", "cv2", "pandas", "pyarrow", "pydantic", "av", "scipy", "rich", "yaml")


@pytest.mark.parametrize("arguments", [["--help"], ["analyze", "--help"], ["doctor", "--help"], ["--version"]])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    code = (
        "import sys; from ttcvid.cli.main import main; code = main(sys.argv[1:]); "
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
    assert done.stdout


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_is_told_how_to_complete_without_heavy_imports(shell: str) -> None:
    code = (
        f"import atexit, sys; heavy = {HEAVY!r}; sys.argv = ['ttcvid'];"
        "atexit.register(lambda: print([name for name in heavy if name in sys.modules], file=sys.stderr));"
        "from ttcvid.cli.main import main; main()"
    )
    environment = {**os.environ, "_TTCVID_COMPLETE": f"{shell}_source"}
    # bash is asked for its version, which some systems do not have
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stderr.strip().endswith("[]")
    assert "ttcvid" in done.stdout
    assert f"_TTCVID_COMPLETE={shell}_complete" in done.stdout


def test_options_and_their_choices_are_completed() -> None:
    environment = {**os.environ, "_TTCVID_COMPLETE": "bash_complete", "COMP_CWORD": "3"}
    words = {**environment, "COMP_WORDS": "ttcvid analyze --platform ve"}
    done = subprocess.run([sys.executable, "-m", "ttcvid"], env=words, capture_output=True, text=True, check=True)
    assert done.stdout == "plain,vehicle\n"


def test_the_package_runs_as_the_program_does() -> None:
    command = [sys.executable, "-m", "ttcvid"]
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("ttcvid")
    failed = subprocess.run([*command, "analyse"], capture_output=True, text=True, check=False)
    assert failed.returncode == 2
    assert failed.stderr.count("\n") == 1


def test_the_program_says_all_and_ends_without_taking_apart_what_it_has_imported() -> None:
    code = (
        "import sys\n"
        "from ttcvid.cli.main import program\n"
        "class Imported:\n"
        "    def __del__(self): print('taken apart', file=sys.stderr)\n"
        "imported = Imported()\n"
        "sys.argv = ['ttcvid', *sys.argv[1:]]\n"
        "program()\n"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run([*command, "--help"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("Usage: ttcvid")
    failed = subprocess.run([*command, "analyze", "no-such-clip.mp4"], capture_output=True, text=True, check=False)
    assert failed.returncode == 3
    assert failed.stderr.startswith("ttcvid: error: no-such-clip.mp4")
    assert failed.stderr.count("\n") == 1


def test_the_program_runs_where_its_output_is_closed() -> None:
    command = f"{shlex.quote(sys.executable)} -m ttcvid --version >&-"
    assert subprocess.run(command, shell=True, capture_output=True, check=False).returncode == 0


def test_the_list_of_commands_names_every_command_with_its_first_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for name in COMMANDS:
        assert f"\n  {name}" in text


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--help"]) == 0
    assert capsys.readouterr().out.startswith(f"Usage: ttcvid {name}")


def test_choices_and_options_are_those_of_the_configuration() -> None:
    assert get_args(TrackingConfig.model_fields["tracker"].annotation) == TRACKERS
    assert get_args(CollisionTimesConfig.model_fields["estimator"].annotation) == ESTIMATORS
    assert tuple(platform.value for platform in Platform) == PLATFORMS
    of_the_command_alone = {"inputs", "clips", "out", "evidence", "as_json", "quiet", "verbose", "config", "settings"}
    options = {parameter.name for parameter in analyze.params} - of_the_command_alone
    of_calibration = {parameter.name for parameter in calibrate_horizon.params} - of_the_command_alone
    assert options == (set(AnalyzeOptions.model_fields) | set(SHORTCUTS)) - {"moving", "roll_zero"}
    assert of_calibration - {"moving", "roll_zero"} < options


def test_defaults_in_the_help_are_those_of_the_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    main(["analyze", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    for default in ("klt", "multi-frame", "auto", "0", "1", "--overlay"):
        assert f"[default: {default}]" in text.replace("multi- frame", "multi-frame")
    assert TrackingConfig().tracker == "klt"
    assert CollisionTimesConfig().estimator == "multi-frame"
    assert (AnalyzeOptions().seed, AnalyzeOptions().stride, AnalyzeOptions().overlay) == (0, 1, True)
