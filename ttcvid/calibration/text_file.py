"""Text of calibration files, read with the care that files from strangers need."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from ttcvid.errors import CalibrationError

MAX_FILE_BYTES = 1_000_000
"""Camera files have a few kB; a file of several MB is something else, and takes parsers minutes."""
MAX_YAML_CHARACTERS = 200_000
"""PyYAML needs a second for 50 kB."""
MAX_OPENERS = 5000
"""Brackets, tags and list dashes of a file, and so a bound of their nesting; parsers recurse, and OpenCV's crashes the
process from some ten thousand on."""

_OPENER = re.compile(r"[\[{<]|-[ \t]")


def read_text(path: Path, kind: str) -> str:
    """Text of a file that is said to be ``kind`` (for the message), without byte order mark, with plain line ends.

    Raises
    ------
    CalibrationError
        The file is missing, no file, unreadable, empty, over 1 MB, not text, or nested too deep.
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
    if len(_OPENER.findall(text)) > MAX_OPENERS:
        raise CalibrationError(
            f"{path}: over {MAX_OPENERS} brackets, tags or list items; expected {kind}, which has few"
        )
    return text.replace("\r\n", "\n").replace("\r", "\n")


class _PlainLoader(yaml.SafeLoader):
    """YAML of numbers, text, lists and mappings: no aliases, no tags that make objects, no key twice."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(
                problem="aliases (*name) are not accepted: write the value out", problem_mark=mark
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        names = [key.value for key, _ in node.value if isinstance(key.value, str)]
        twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
        if twice is not None:
            raise yaml.MarkedYAMLError(problem=f"key {twice!r} is given twice", problem_mark=node.start_mark)
        return super().construct_mapping(node, deep)


# YAML 1.1, which PyYAML follows, takes 1e-05 for text; every other program writes small coefficients that way.
_PlainLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"), list("-+.0123456789")
)


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
