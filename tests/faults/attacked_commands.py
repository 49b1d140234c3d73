"""How each command is called when it is attacked."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class SoundInputs:
    """A folder with two scenes, the pictures of one with truth, two runs over them, a suite of them, and tracks."""

    folder: Path

    @property
    def clip_options(self) -> list[str]:
        """What the pictures need said."""
        clip = self.folder / "clip"
        return ["--camera", str(clip / "camera.yaml"), "--timestamps", str(clip / "timestamps.txt")]


ATTACKS = {
    "analyze": ["{clip}/frames", "{options}", "-o", "{out}/run", "--overwrite"],
    "calibrate-horizon": [
        "{clip}/frames",
        "{options}",
        *("--moving", "-o", "{out}/horizon.yaml", "--evidence", "{out}/evidence", "--overwrite"),
    ],
    "simulate": ["{bare_scene}", "--png", "--frames", "3", "-o", "{out}/scene", "--overwrite"],
    "evaluate": ["{run}", "{clip}", "--html", "{out}/page.html"],
    "sensitivity": ["-o", "{out}/sensitivity", "--overwrite", "--steps", "3", "--trials", "100", "--frames", "5"],
    "collision-map": ["{run}", "-o", "{out}/map", "--overwrite", "--n-cells", "11", "--frame", "10", "--ego-speed=10"],
    "compare": ["{run}", "{other}", "--junit", "{out}/junit.xml"],
    "batch": ["{tracks}", "--image-size", "192x128", "-o", "{out}/batch", "--no-overlay"],
    "report": ["{run}", "-o", "{out}/page.html"],
    "export": ["{run}", "--to", "csv", "-o", "{out}/csv", "--overwrite"],
    "regress": ["{suite}", "-o", "{out}/runs", "--junit", "{out}/junit.xml"],
    "demo": ["--frames", "2", "-o", "{out}/demo", "--overwrite"],
}
"""Arguments of each command; all that it writes goes below {out}."""


def arguments_of(command: str, sound: SoundInputs, out: Path) -> list[str]:
    places = {name: str(sound.folder / name) for name in ("clip", "run", "other")}
    places |= {"bare_scene": str(sound.folder / "bare_scene.yaml"), "out": str(out)}
    places |= {"tracks": str(sound.folder / "tracks.csv"), "suite": str(sound.folder / "suite.yaml")}
    given = [command]
    for argument in ATTACKS[command]:
        given += sound.clip_options if argument == "{options}" else [argument.format(**places)]
    return given
