"""Writes the reference pages that the code itself knows best: ``python docs/tables.py``.

``docs/tables.md`` comes from ttcvid/schema.py, ``docs/configuration.md`` from ttcvid/config.py. A test fails where the
pages in the repository are not what this writes.
"""

from __future__ import annotations

import types
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import annotated_types
from pydantic.fields import FieldInfo

from ttcvid.config import PipelineConfig
from ttcvid.jobs.settings.options import SECTIONS, SHORTCUTS
from ttcvid.model import Platform
from ttcvid.schema import CALIBRATION_TABLES, SCHEMA_VERSION, STUDY_TABLES, TABLE_NAMES, VERSION_KEY, markdown_of

FOLDER = Path(__file__).parent
_GENERATED = "Written by `python docs/tables.py` from the code; do not edit."
_ROWS = {
    "collision_times": "A row per frame and live track.",
    "epipoles": "A row per frame and cluster: its direction of relative motion.",
    "clusters": "A row per frame and cluster: where it is, how it moves, and its times.",
    "frames": "A row for every frame, those without a result too.",
    "events": "A row per warning.",
    "motions": "`motions.parquet` of `ttcvid calibrate-horizon`: a row per straight motion.",
    "sensitivity": "`sensitivity.parquet` of `ttcvid sensitivity`: a row per value and method.",
    "collision_map": "`collision_map.parquet` of `ttcvid collision-map`: a row per change of own velocity.",
    "evasion": "`evasion.parquet` of `ttcvid collision-map`: a row per frame, and what to do.",
}
_TABLES_HEAD = f"""# The five tables

{_GENERATED}
Words, signs and units: [conventions](conventions.md). Which function makes which column:
[where things are](../CONTRIBUTING.md#where-things-are).

Each table is `NAME.parquet` in the output folder: zstd, sorted by frame and number, types fixed, schema version
{SCHEMA_VERSION} (`{VERSION_KEY}` in the file's metadata). Every column carries its unit and its description in the
metadata of its field. The file's metadata also say how it was made: camera, tracker, estimator, platform, and
`estimates`: `causal`, or `smooth` with `--smooth`. A value that does not exist is null and has a `status`
beside it: never 0, NaN or infinity. A time of an object (`clusters`) is null under `ok` where its interval has no end.

Type `name` is one of the words that the meaning lists, stored as `dictionary<string, int8>`: pandas reads it as
categories, others as text. `int32` with the unit 1 counts or numbers something. `pandas.read_parquet` gives types in
which null is NA, and puts units and descriptions into `attrs`; of an empty table it does not know the categories, as
`ttcvid.Run` does.
"""
_CONFIGURATION_HEAD = f"""# Every parameter

{_GENERATED} Where values come from, and which place wins: [command line](command_line.md#configuration).

In a TOML file each heading below is a section; in the environment `[tracking] max_tracks` is
`TTCVID_TRACKING__MAX_TRACKS`, on the command line `--set tracking.max_tracks=800`, in Python
`tracking={{"max_tracks": 800}}`. What stands under `[analyze]` is an option of the command line as well, an argument
in Python, and `TTCVID_FPS` and so on in the environment.
"""
_ABOUT_OPTIONS = {
    "camera": "camera file",
    "focal_px": "focal length in px",
    "image_size": "size of the pictures behind a track table, such as 1242x375",
    "horizon": "horizon file, or `auto`: estimated from the clip itself; switches planar motion on",
    "max_image_mpx": "picture files whose header claims more, in 10^6 pixels, are skipped unread",
    "mask": "picture, black where nothing is to be analysed",
    "fps": "frame rate of pictures, 1/s",
    "timestamps": "file with the time of each picture",
    "start": "first frame (120) or time (4.5s, 00:01:02.5)",
    "end": "frame or time of the end, itself excluded",
    "overlay": "write overlay.mp4",
    "report": "write report.html",
    "overwrite": "replace an output folder that exists",
    "platform": "what carries the camera: expectations of its own motion",
    "estimator": "from how many views a time is estimated",
    "tracker": "how points are tracked",
    "smooth": "directions and times from frames on both sides",
    "moving": "the camera drives (calibrate-horizon)",
    "roll_zero": "the camera has no roll (calibrate-horizon)",
    "preset": "effort of the H.264 encoder",
}
_BOUNDS = {"ge": ">= {}", "gt": "> {}", "le": "<= {}", "lt": "< {}"}


def tables_page() -> str:
    """``docs/tables.md``."""
    parts = [_TABLES_HEAD]
    names = (*TABLE_NAMES, *CALIBRATION_TABLES, *STUDY_TABLES)
    parts += [f"## {name}\n{_ROWS[name]}\n\n{markdown_of(name)}" for name in names]
    return "\n".join(parts)


def configuration_page() -> str:
    """``docs/configuration.md``."""
    parts = [_CONFIGURATION_HEAD]
    for section, parameters in SECTIONS.items():
        about = " ".join((parameters.__doc__ or "").split("\n\n")[0].split()).replace("``", "`")
        lines = [f"## [{section}]", about, "", "| key | value | default | meaning |", "|---|---|---|---|"]
        lines += [_row(key, field) for key, field in parameters.model_fields.items()]
        if section == "analyze":
            lines += [_shortcut_row(key, *place) for key, place in SHORTCUTS.items()]
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def _row(key: str, field: FieldInfo) -> str:
    default = "" if field.default is None else f"`{_toml(field.default)}`"
    meaning = field.description or _ABOUT_OPTIONS[key]
    return f"| `{key}` | {_values(field)} | {default} | {meaning} |"


def _shortcut_row(key: str, section: str, name: str) -> str:
    stage: Any = PipelineConfig.model_fields[section].annotation
    default = _toml(stage.model_fields[name].default)
    return f"| `{key}` | the same as `[{section}] {name}` | `{default}` | {_ABOUT_OPTIONS[key]} |"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)


def _values(field: FieldInfo) -> str:
    """The values that a parameter can have, as a reader of the table wants them."""
    kinds = [kind for kind in (get_args(field.annotation) or (field.annotation,)) if kind is not types.NoneType]
    if get_origin(field.annotation) is Literal:
        return " ".join(f"`{_toml(kind)}`" for kind in kinds)
    if kinds[0] is Platform:
        return " ".join(f"`{_toml(str(platform))}`" for platform in Platform)
    bounds = [_bound(one) for one in (*field.metadata, *_nested(kinds[0]))]
    name = {"float": "number", "int": "whole number", "bool": "true or false", "Path": "path"}.get(
        getattr(_bare(kinds[0]), "__name__", ""), "text"
    )
    return " ".join([name, *filter(None, [", ".join(bound for bound in bounds if bound)])])


def _bare(kind: Any) -> Any:
    return get_args(kind)[0] if hasattr(kind, "__metadata__") else kind


def _nested(kind: Any) -> tuple[Any, ...]:
    """Bounds that an annotated type brings along."""
    return tuple(
        bound
        for one in getattr(kind, "__metadata__", ())
        for bound in (one.metadata if isinstance(one, FieldInfo) else (one,))
    )


def _bound(one: Any) -> str:
    if not isinstance(one, (annotated_types.Ge, annotated_types.Gt, annotated_types.Le, annotated_types.Lt)):
        return ""
    name = type(one).__name__.lower()
    return _BOUNDS[name].format(getattr(one, name))


def main() -> None:
    """Write both pages."""
    (FOLDER / "tables.md").write_text(tables_page(), encoding="utf-8")
    (FOLDER / "configuration.md").write_text(configuration_page(), encoding="utf-8")


if __name__ == "__main__":
    main()
