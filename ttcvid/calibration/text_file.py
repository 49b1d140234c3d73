"""Text of calibration files, read with the care that files from strangers need."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from ttcvid.errors import CalibrationError

MAX_FILE_BYTES = 1_000_000
"""Camera files have a few kB; with the corners of all boards in it, some 100 kB."""
MAX_YAML_CHARACTERS = 200_000
"""PyYAML needs a second for 50 kB; long lists of numbers are taken out before (`without_long_lists`)."""
MAX_LIST_CHARACTERS = 2000
LONG_LIST = "a long list"

_LONG_LIST = re.compile(r"\[[^\[\]]{%d,}\]" % MAX_LIST_CHARACTERS)  # noqa: UP031 (braces of the pattern)


def read_text(path: Path, kind: str) -> str:
    """Text of a file that is said to be ``kind`` (for the message), without byte order mark, with plain line ends.

    Raises
    ------
    CalibrationError
        The file is missing, no file, unreadable, empty, over 1 MB, or not text.
    """
    try:
        if not path.exists():
            raise CalibrationError(f"{path}: no such file; expected {kind}: check the path")
        if not path.is_file():
            raise CalibrationError(f"{path}: not a file; expected {kind}: give the file itself")
        with path.open("rb") as file:
            content = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read ({error.strerror}); expected {kind}: check the path") from error
    if len(content) > MAX_FILE_BYTES:
        raise CalibrationError(f"{path}: over {MAX_FILE_BYTES // 1_000_000} MB; expected {kind}, which has a few kB")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CalibrationError(
            f"{path}: binary, or text that is not UTF-8; expected {kind}: save it as UTF-8"
        ) from error
    if not text.strip():
        raise CalibrationError(f"{path}: the file is empty; expected {kind}: write or copy it again")
    if "\0" in text:
        raise CalibrationError(f"{path}: binary; expected {kind}")
    return text.replace("\r\n", "\n").replace("\r", "\n")


_OPENCV_TAGS = "tag:yaml.org,2002:opencv-"


class _PlainLoader(yaml.SafeLoader):
    """YAML of numbers, text, lists and mappings: no aliases, no tags that make objects, no key twice."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        problem = None
        if isinstance(event, yaml.AliasEvent):
            problem = "aliases (*name) are not accepted: write the value out"
        elif event.tag is not None and not event.tag.startswith(_OPENCV_TAGS):
            problem = f"the tag {event.tag} is not accepted: take it out"
        elif event.tag is not None and not isinstance(event, yaml.MappingStartEvent):
            problem = f"the tag {event.tag} stands before something without keys"
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen: set[object] = set()
        for key, _ in node.value:
            # A key that is a list or mapping is refused by the base class.
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"key {key.value!r} is given twice", problem_mark=key.start_mark)
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
        return super().construct_mapping(node, deep)


# YAML 1.1, which PyYAML follows, takes 1e-05 for text; every other program writes small coefficients that way. .Nan is
# how OpenCV spells it.
_PlainLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$|^\.Nan$"),
    list("-+.0123456789"),
)


# !!opencv-matrix and its like are mappings; what is in them is checked where it is used.
_PlainLoader.add_multi_constructor(_OPENCV_TAGS, lambda loader, _, node: loader.construct_mapping(node, deep=True))


def without_long_lists(text: str) -> str:
    """The text with lists of numbers that are too long for a camera replaced by words that say so."""
    return _LONG_LIST.sub(f'"{LONG_LIST}"', text)


def parse_yaml(path: Path, text: str) -> Any:
    """First document of a YAML text (ROS separates messages by ``---``).

    Raises
    ------
    CalibrationError
        Malformed, too long, or it uses aliases, object tags or the same key twice.
    """
    if len(text) > MAX_YAML_CHARACTERS:
        raise CalibrationError(f"{path}: over {MAX_YAML_CHARACTERS // 1000} kB of YAML; expected a few kB")
    try:
        loader = _PlainLoader(text)
        try:
            return loader.get_data()
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        line = f", line {mark.line + 1}" if mark is not None else ""
        raise CalibrationError(
            f"{path}{line}: not acceptable as YAML: {_one_line(error.problem)}; expected plain keys with numbers, text "
            "and lists: correct the file"
        ) from error
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        raise CalibrationError(
            f"{path}: not acceptable as YAML: {_one_line(error)}; expected plain keys with numbers, text and lists"
        ) from error


def _one_line(problem: object) -> str:
    return " ".join(str(problem).split())[:200]
