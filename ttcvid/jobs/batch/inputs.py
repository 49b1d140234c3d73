"""Which clips a batch has: files, folders, patterns, lists and tables of clips, each clip with a name of its own."""

from __future__ import annotations

import csv
import difflib
import glob
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ttcvid.errors import InputError, UsageError, quoted
from ttcvid.jobs.settings.layers import Layer
from ttcvid.jobs.settings.options import ANALYSIS_SECTIONS, AUTO_HORIZON, PATH_OPTIONS, SHORTCUTS
from ttcvid.sinks.folder import PARTIAL_NAME
from ttcvid.sinks.manifest import MANIFEST_NAME

LIST_SUFFIXES = (".txt", ".lst")
VIDEO_SUFFIXES = frozenset(
    f".{kind}"
    for kind in (
        *("mp4", "m4v", "mov", "mkv", "webm", "avi", "wmv", "flv", "3gp", "ogv"),
        *("ts", "m2ts", "mts", "mpg", "mpeg", "mjpeg", "h264", "h265", "hevc", "y4m"),
    )
)
"""What a folder is searched for. A video of another name is analysed where it is named itself."""

FOLDER_JOINT = "__"
"""Stands in a clip's name where its path below the given folder has a slash."""
CLIP, NAME = "clip", "name"
_OWN_PLACE = ("overwrite",)
"""Options that a batch decides itself."""


@dataclass(frozen=True)
class BatchClip:
    """One clip: ``name`` is that of its output folder, ``place`` who named it, ``layer`` the settings of its row."""

    name: str
    input: str
    place: str
    layer: Layer
    is_row: bool


def read_inputs(inputs: Sequence[str], out: Path) -> tuple[BatchClip, ...]:
    """All clips that ``inputs`` name, sorted by name; ``out`` and other results are not searched for clips.

    Raises
    ------
    InputError
        An input is not there, or holds no clip.
    UsageError
        A table cannot be used, or two clips have one name.
    """
    if not inputs:
        raise UsageError(
            "no INPUT: expected clips, folders, patterns, a list of clips (.txt) or a table of clips (.csv)"
        )
    return _distinct([clip for given in inputs for clip in _clips_of(given, out)])


def _clips_of(given: str, out: Path) -> Iterator[BatchClip]:
    path = Path(given)
    if not given.strip():
        raise UsageError("an INPUT is empty: expected a clip, a folder, a pattern, a list or a table")
    if path.is_dir():
        yield from _in_folder(path, out, given)
    elif path.suffix.lower() in LIST_SUFFIXES and path.is_file():
        yield from _in_list(path, out)
    elif path.suffix.lower() == ".csv" and path.is_file() and _is_table_of_clips(path):
        yield from _in_table(path)
    elif path.exists() or "%" in given:
        yield _clip(given, given)
    elif glob.has_magic(given):
        yield from _of_pattern(given, out)
    else:
        raise InputError(f"{given}: no such file or folder: expected a clip, a folder, a pattern, a list or a table")


def _in_folder(folder: Path, out: Path, place: str) -> Iterator[BatchClip]:
    """Videos in a folder and those below it; a folder of pictures alone is one clip."""
    found = list(_searched(folder, out))
    if not found:
        raise InputError(
            f"{folder}: holds no video and no folder of pictures: expected names such as *{', *'.join(_EXAMPLES)}"
        )
    for path in found:
        relative = path.relative_to(folder)
        name = folder.resolve().name if relative == Path() else _flat(relative, path)
        yield _clip(str(path), place, name)


_EXAMPLES = (".mp4", ".mkv", ".png")


def _searched(folder: Path, out: Path) -> Iterator[Path]:
    from ttcvid.sources.images import IMAGE_SUFFIXES

    for parent, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        is_result = MANIFEST_NAME in files or (Path(parent) / PARTIAL_NAME).exists()
        if is_result or Path(parent).resolve() == out.resolve():
            folders.clear()
            continue
        paths = [Path(parent, name) for name in sorted(files) if not name.startswith(".")]
        videos = [path for path in paths if path.suffix.lower() in VIDEO_SUFFIXES]
        yield from videos
        if not videos and any(path.suffix.lower() in IMAGE_SUFFIXES for path in paths):
            yield Path(parent)


def _of_pattern(pattern: str, out: Path) -> Iterator[BatchClip]:
    from ttcvid.sources.images import IMAGE_SUFFIXES

    paths = [Path(found) for found in sorted(glob.glob(pattern, recursive=True))]
    if not paths:
        raise InputError(f"{pattern}: no file fits the pattern")
    root = Path(*_plain_parts(Path(pattern)))
    for path in paths:
        if path.is_dir():
            found = _searched(path, out)
            yield from (_clip(str(clip), pattern, _flat(clip.relative_to(root), clip)) for clip in found)
        elif path.suffix.lower() in IMAGE_SUFFIXES:
            raise InputError(f"{path}: a picture is no clip: give its folder instead of {pattern}")
        else:
            yield _clip(str(path), pattern, _flat(path.relative_to(root), path))


def _plain_parts(pattern: Path) -> Iterator[str]:
    """The parts of a pattern before the first that is one."""
    for part in pattern.parts:
        if glob.has_magic(part):
            return
        yield part


def _in_list(path: Path, out: Path) -> Iterator[BatchClip]:
    """The clips, folders and patterns of a text file, one a line, relative to its folder.

    A missing path is a clip too, whose analysis will fail: lists are long, and the rest is to go on.
    """
    lines = [line.strip() for line in _text(path).splitlines()]
    named = [(number, line) for number, line in enumerate(lines, 1) if line and not line.startswith("#")]
    if not named:
        raise InputError(f"{path}: names no clip: expected a path a line")
    for number, line in named:
        place, given = f"{path}: line {number}", str(path.parent / line)
        if Path(given).is_dir():
            yield from _in_folder(Path(given), out, place)
        elif not Path(given).exists() and glob.has_magic(given):
            yield from _of_pattern(given, out)
        else:
            yield _clip(given, place)


def _is_table_of_clips(path: Path) -> bool:
    """Whether a CSV file lists clips; else it is a table of point tracks, a clip itself."""
    with path.open("rb") as file:
        header = file.readline(_LONGEST_HEADER_BYTES).decode("utf-8-sig", "replace")
    return CLIP in _header(header)


_LONGEST_HEADER_BYTES = 10_000


def _header(line: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=_delimiter(line)), [])]


def _delimiter(header: str) -> str:
    return max(",;\t", key=header.count)


def _in_table(path: Path) -> Iterator[BatchClip]:
    """A clip a row, its own settings in columns named like options or ``section.key``; an empty cell says nothing."""
    lines = _text(path).splitlines()
    reader = csv.reader(lines, delimiter=_delimiter(lines[0]))
    columns = [cell.strip() for cell in next(reader)]
    known = _known_columns()
    for column in columns:
        if column not in known:
            nearest = difflib.get_close_matches(column, known, n=1)
            remedy = f"did you mean {nearest[0]!r}?" if nearest else "expected an option of analyze, or SECTION.KEY"
            raise UsageError(f"{path}: unknown column {quoted(column)}: {remedy}")
        if columns.count(column) > 1:
            raise UsageError(f"{path}: column {column!r} stands there twice: keep one")
    is_empty = True
    for row in reader:
        cells = [cell.strip() for cell in row]
        if not any(cells):
            continue
        is_empty = False
        place = f"{path}: line {reader.line_num}"
        if len(cells) > len(columns):
            raise UsageError(f"{place}: {len(cells)} cells for {len(columns)} columns: put text with a comma in quotes")
        yield _clip_of_row(path, place, {column: cell for column, cell in zip(columns, cells, strict=False) if cell})
    if is_empty:
        raise InputError(f"{path}: names no clip: expected a row for each below the names of the columns")


def _clip_of_row(path: Path, place: str, cells: dict[str, str]) -> BatchClip:
    if CLIP not in cells:
        raise UsageError(f"{place}: column 'clip' is empty: expected the path of a clip")
    layer = Layer(f"table {path}", is_text=True)
    for column, cell in cells.items():
        if column in (CLIP, NAME):
            continue
        section, dot, key = column.partition(".")
        is_path = column in PATH_OPTIONS and (column, cell) != AUTO_HORIZON
        value = str(path.absolute().parent / cell) if is_path else cell
        layer.add(section if dot else "analyze", key if dot else column, value, f"{place}: column {column!r}")
    return _clip(str(path.parent / cells[CLIP]), place, cells.get(NAME), layer)


def _known_columns() -> list[str]:
    options = [*(name for name in ANALYSIS_SECTIONS["analyze"].model_fields if name not in _OWN_PLACE), *SHORTCUTS]
    stages = [
        f"{section}.{key}"
        for section, parameters in ANALYSIS_SECTIONS.items()
        if section != "analyze"
        for key in parameters.model_fields
    ]
    return [CLIP, NAME, *options, *stages]


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not text in UTF-8: save it as such") from None


def _clip(given: str, place: str, name: str | None = None, layer: Layer | None = None) -> BatchClip:
    """A clip by the path of its file, folder or pattern; its name is the file's own, unless one is given."""
    name = _printable(_stem(given) if name is None else name)
    if name.startswith(".") or "/" in name or "\\" in name or not name.strip():
        raise UsageError(
            f"{place}: clip {given!r} would be called {name!r}: expected a name that can be a folder's "
            "(column 'name' of a table)"
        )
    return BatchClip(name, os.path.abspath(given), place, layer or Layer("table", is_text=True), layer is not None)


def _stem(given: str) -> str:
    path = Path(given)
    if path.is_dir():
        return path.resolve().name
    return path.parent.resolve().name if "%" in path.name and not path.exists() else path.stem


def _flat(relative: Path, path: Path) -> str:
    """A path below a folder as one name."""
    return FOLDER_JOINT.join((relative if path.is_dir() else relative.with_suffix("")).parts)


def _printable(name: str) -> str:
    """The name with bytes that are no UTF-8 spelled out, as tables and pages can hold it."""
    return os.fsencode(name).decode("utf-8", "backslashreplace").replace("\\", "_")


def _distinct(clips: Iterable[BatchClip]) -> tuple[BatchClip, ...]:
    """The clips by name. What is found again in another way counts once, and a row of a table goes before the rest.

    Names that differ in case alone are one name: they are one folder on some disks.
    """
    clips = list(clips)
    seen = {clip.input for clip in clips if clip.is_row}
    by_name: dict[str, BatchClip] = {}
    for clip in clips:
        if not clip.is_row and clip.input in seen:
            continue
        seen.add(clip.input)
        former = by_name.setdefault(clip.name.casefold(), clip)
        if former is not clip:
            raise UsageError(
                f"two clips are called {clip.name!r}: {former.input} ({former.place}) and {clip.input} ({clip.place}): "
                "give them names of their own in a table of clips (column 'name'), or the folder that holds both"
            )
    return tuple(by_name[key] for key in sorted(by_name))
