"""How long before a contact a warning comes, and what is warned of for nothing: drawn scenes that are in no test.

python benchmarks/warnings_ahead.py [--first N] [--last N] [--only KIND] [--keep FOLDER]

Of each kind of encounter (benchmarks/warning_scenes.py) the scenes of these numbers are rendered, one that ends in a
collision and one that passes, analysed with their own camera, and evaluated. A scene takes some 10 s.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import yaml
from warning_scenes import KINDS, scene_values

import ttcvid

BAR_S = 2.0
"""A warning comes this long before the contact."""


def judged(kind: str, number: int, folder: Path, *, collides: bool) -> tuple[str, float | None, float]:
    """Name of a scene, how long before the contact its first warning starts (None: none), and its false warnings."""
    values = scene_values(kind, number, collides=collides)
    path = folder / f"{values['name']}.yaml"
    path.write_text(yaml.safe_dump(values, sort_keys=False))
    scene, out = folder / path.stem, folder / f"{path.stem}_run"
    if not scene.exists():
        ttcvid.simulate(path, scene)
    platform = "aircraft" if kind == "aircraft" else "vehicle"
    ttcvid.analyze(
        str(scene / "clip.mp4"),
        out,
        camera=str(scene / "camera.yaml"),
        platform=platform,
        overlay=False,
        overwrite=True,
    )
    metrics = ttcvid.evaluate(out, scene).evaluation.metrics
    return path.stem, metrics["events.lead_s"] if collides else None, float(metrics["events.false"] or 0.0)


def main() -> None:
    """Print a line a scene, and the sums."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=2, help="number of the first scene of each kind")
    parser.add_argument("--last", type=int, default=3, help="number of the last one")
    parser.add_argument("--only", choices=list(KINDS), help="one kind of encounter")
    parser.add_argument("--keep", type=Path, help="folder for scenes and results; scenes that are there are taken")
    arguments = parser.parse_args()
    leads_s: list[float | None] = []
    n_false = 0.0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if arguments.keep is None else arguments.keep
        folder.mkdir(parents=True, exist_ok=True)
        for kind in [arguments.only] if arguments.only else list(KINDS):
            for number in range(arguments.first, arguments.last + 1):
                for collides in (True, False):
                    name, lead_s, false = judged(kind, number, folder, collides=collides)
                    n_false += false
                    if collides:
                        leads_s.append(lead_s)
                    said = "-" if not collides else "none" if lead_s is None else f"{lead_s:.2f} s"
                    print(f"{name:24} warned before the contact: {said:8} false warnings: {false:.0f}", flush=True)
    early = sum(lead_s is not None and lead_s >= BAR_S for lead_s in leads_s)
    print(f"warned {BAR_S:g} s before the contact: {early} of {len(leads_s)}; false warnings: {n_false:.0f}")


if __name__ == "__main__":
    main()
