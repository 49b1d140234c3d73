"""What attacks share: one process that runs all commands, and small inputs that were sound before."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from attacked_commands import SoundInputs
from attacked_runs import Attacker
from moving_clips import write_approaching_tracks

import ttcvid

# The check of a whole result is a benchmark's.
sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))

SCENE = """
name: small
camera: {image_size: [160, 120], hfov_deg: 70, height_m: 1.4, fps: 5, n_frames: 14}
own_motion: {speed_m_s: 5}
ground: {kind: street, road_width_m: 8}
bodies:
  - {name: house, kind: house, at_m: [20, 12, 0], size_m: [12, 9, 7.5]}
  - {name: other house, kind: house, at_m: [22, -12, 0], size_m: [12, 9, 7.5]}
  - {name: car, kind: car, at_m: [25, 0, 0], speed_m_s: 1}
"""
BARE_SCENE = """
name: bare
camera: {image_size: [160, 120], hfov_deg: 70, height_m: 1.4, fps: 5, n_frames: 14}
ground: {kind: none}
bodies:
  - {name: car, kind: car, at_m: [15, 0, 0], speed_m_s: 1}
"""
"""The ground takes longer to paint than all else."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What is exhaustive is slow: without this, ``-m 'not slow'`` would run it."""
    for item in items:
        if item.get_closest_marker("exhaustive"):
            item.add_marker("slow")


@pytest.fixture(scope="session")
def attacker() -> Iterator[Attacker]:
    with Attacker() as attacker:
        yield attacker


@pytest.fixture(scope="session")
def sound(made_once: Callable[..., Path]) -> SoundInputs:
    return SoundInputs(made_once("sound", write_sound_inputs))


def write_sound_inputs(folder: Path) -> None:
    folder.mkdir()
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "bare_scene.yaml").write_text(BARE_SCENE)
    clip = ttcvid.simulate(folder / "scene.yaml", folder / "clip", png=True).folder
    options = {"camera": clip / "camera.yaml", "timestamps": clip / "timestamps.txt", "overlay": False, "report": False}
    for name, platform in (("run", "vehicle"), ("other", "free")):
        ttcvid.analyze(clip / "frames", folder / name, platform=platform, **options)
    calibration = {name: str(options[name]) for name in ("camera", "timestamps")}
    suite = {"name": "small", "clip": str(clip / "frames"), "options": calibration, "baseline": False}
    (folder / "suite.yaml").write_text(yaml.safe_dump({"clips": [suite | {"expectations": ["events: none"]}]}))
    write_approaching_tracks(folder / "tracks.csv", n=5, n_tracks=20)
