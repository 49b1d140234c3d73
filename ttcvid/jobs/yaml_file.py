"""YAML files that people write: tolerances and suites."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from ttcvid.errors import UsageError


def read_yaml(path: Path) -> Any:
    """The content of a YAML file; UsageError where it cannot be read."""
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}): give a YAML file") from None
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError(f"{path}: is no valid YAML: {' '.join(str(error).split())}: mend the file") from None
