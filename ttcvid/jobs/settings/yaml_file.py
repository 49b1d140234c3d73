"""YAML files that people write: tolerances and suites."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ttcvid.errors import UsageError
from ttcvid.plain_files import read_plain
from ttcvid.strict_yaml import MAX_BYTES, StrictYamlError, load_yaml


def read_yaml(path: Path) -> Any:
    """The content of a YAML file; UsageError where it cannot be read."""
    try:
        return load_yaml(read_plain(path, MAX_BYTES).decode())
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}): give a YAML file") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: is not text in UTF-8: expected YAML: mend the file") from None
    except StrictYamlError as error:
        raise UsageError(f"{path}{error.place}: is no valid YAML: {error}: mend the file") from None
