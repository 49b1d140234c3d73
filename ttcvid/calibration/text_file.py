"""Text of calibration files, read with the care that files from strangers need."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from ttcvid.errors import CalibrationError
from ttcvid.plain_files import open_plain
from ttcvid.strict_yaml import StrictLoader, StrictYamlError, load_yaml

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
        with open_plain(path) as file:
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


class _CameraLoader(StrictLoader):
    """YAML in which OpenCV's mappings may have their tags."""

    mapping_tags = (_OPENCV_TAGS,)


# !!opencv-matrix and its like are mappings; what is in them is checked where it is used.
_CameraLoader.add_multi_constructor(_OPENCV_TAGS, lambda loader, _, node: loader.construct_mapping(node, deep=True))


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
    try:
        return load_yaml(text, loader=_CameraLoader, max_characters=MAX_YAML_CHARACTERS, first_of_many=True)
    except StrictYamlError as error:
        raise CalibrationError(
            f"{path}{error.place}: not acceptable as YAML: {error}; expected plain keys with numbers, text and lists: "
            "correct the file"
        ) from error
