"""A small simulated clip, analysed once and again with something changed: what comparisons are tested on."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import yaml

import ttcvid

SCENE = Path(__file__).parents[1] / "sample_configs/scenes/demo.yaml"
SIZE_PX = [560, 316]
N_FRAMES = 25
DROPPED = 14
FEW_TRACKS = {"tracking": {"max_tracks": 300}, "report": False}
LEFT_OUT = ("right tree", "left post", "far left house", "far right house", "side road", "field house")
"""Whose faces take longer to paint than all pictures to draw."""


def simulated(folder: Path) -> Path:
    """The clip: small pictures with their times, camera and horizon."""
    scene = yaml.safe_load(SCENE.read_text())
    scene["camera"]["image_size"] = SIZE_PX
    scene["bodies"] = [body for body in scene["bodies"] if body["name"] not in LEFT_OUT]
    file = folder.with_suffix(".yaml")
    file.write_text(yaml.safe_dump(scene))
    return ttcvid.simulate(file, folder, png=True, n_frames=N_FRAMES).folder


def analyzed(clip: Path, out: Path, pictures: Path | None = None, **options: Any) -> Path:
    """The folder of a run over the clip's pictures, with its camera and times where nothing else is said."""
    options = {"camera": clip / "camera.yaml", "platform": "vehicle", "overlay": False, **FEW_TRACKS} | options
    options |= {} if "fps" in options else {"timestamps": options.get("timestamps", clip / "timestamps.txt")}
    return ttcvid.analyze(pictures or clip / "frames", out, **options).folder


def without_a_frame(clip: Path, folder: Path) -> tuple[Path, Path]:
    """Pictures and times of the clip without one of them; the pictures are numbered anew."""
    folder.mkdir()
    kept = [path for k, path in enumerate(sorted((clip / "frames").iterdir())) if k != DROPPED]
    for number, path in enumerate(kept):
        shutil.copy(path, folder / f"{number:06d}.png")
    times = (clip / "timestamps.txt").read_text().splitlines()
    file = folder.with_suffix(".txt")
    file.write_text("\n".join(line for k, line in enumerate(times) if k != DROPPED))
    return folder, file


def focal_off(clip: Path, factor: float, path: Path) -> Path:
    """The clip's camera file with another focal length."""
    content = yaml.safe_load((clip / "camera.yaml").read_text())
    content.update({name: content[name] * factor for name in ("fx_px", "fy_px")})
    path.write_text(yaml.safe_dump(content))
    return path


def horizon_off(clip: Path, shift_px: float, path: Path) -> Path:
    """The clip's horizon file, moved down."""
    content = yaml.safe_load((clip / "horizon.yaml").read_text())
    for name in ("y_left_px", "y_right_px"):
        content["horizon"][name] += shift_px
    path.write_text(yaml.safe_dump(content))
    return path


def changed_copy(run: Path, folder: Path, table: str, change: Any) -> Path:
    """A copy of a run in which ``change`` has been made to a table (an Arrow table in, one out)."""
    shutil.copytree(run, folder)
    path = folder / f"{table}.parquet"
    pq.write_table(change(pq.read_table(path)), path)
    return folder


def with_column(table: pa.Table, name: str, values: Any) -> pa.Table:
    """The table with other values in a column (NaN: null)."""
    place = table.schema.get_field_index(name)
    field = table.schema.field(name)
    return table.set_column(place, field, pa.array(values, from_pandas=True).cast(field.type))


def negated(table: pa.Table, name: str) -> pa.Table:
    """The table with the sign of a column swapped."""
    return with_column(table, name, -table.column(name).to_numpy().astype(float))
