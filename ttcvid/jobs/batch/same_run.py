"""Whether a result is that of the same input, version and configuration, so that it need not be made again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ttcvid.errors import InputError
from ttcvid.jobs.clip import open_clip
from ttcvid.jobs.runs.provenance import describe_option_files, digest_of, versions
from ttcvid.jobs.runs.run import Run
from ttcvid.jobs.settings.configuration import TOLD_BY_CLIP, Configuration
from ttcvid.jobs.settings.options import AUTO_HORIZON, PATH_OPTIONS
from ttcvid.model import Platform

FINISHED_STATES = ("complete", "truncated")
"""A truncated input gives the same result each time; an interrupted analysis would go further."""
_NOT_COMPARED = ("overwrite",)
_AUTO = Platform.auto.value


def finished_run(folder: Path, input_: str, configuration: Configuration) -> Run | None:
    """The run in ``folder``, if it is whole and analysing ``input_`` so again would give the same; else None.

    Compared are the versions of all that the numbers can depend on, every setting, the content of the files that
    options name, and last, because it reads all of it, the content of the input.

    Raises
    ------
    TtcvidError
        The input or a file that an option names cannot be read.
    """
    try:
        run = Run.open(folder)
    except InputError:
        return None
    is_same = (
        run.state in FINISHED_STATES
        and run.manifest["versions"] == versions()
        and _settings(run.manifest["configuration"]) == _settings(configuration.as_manifest())
        and _has_its_files(run)
        and run.manifest.get("option_files") == describe_option_files(configuration.options)
    )
    return run if is_same and _is_of_input(run, input_, configuration) else None


def _settings(configuration: Any) -> Any:
    """Values by section and key, as JSON has them; of files that options name the content is compared instead."""
    values = {
        section: {
            key: _as_asked(_mapping(entry))
            for key, entry in _mapping(keys).items()
            if section != "analyze" or not (key in _NOT_COMPARED or _is_file(key, _mapping(entry).get("value")))
        }
        for section, keys in configuration.items()
    }
    return json.loads(json.dumps(values))


def _as_asked(entry: Mapping[str, Any]) -> Any:
    """A value as it was asked for: what the clip told by itself was not given."""
    return _AUTO if entry.get("origin") == TOLD_BY_CLIP else entry.get("value")


def _mapping(value: Any) -> Mapping[str, Any]:
    """What an edited manifest holds in the place of fields is none of them."""
    return value if isinstance(value, Mapping) else {}


def _is_file(key: str, value: Any) -> bool:
    return key in PATH_OPTIONS and value is not None and (key, str(value)) != AUTO_HORIZON


def _has_its_files(run: Run) -> bool:
    files = _mapping(run.manifest.get("files"))
    return bool(files) and all(_size(run.folder / name) == size for name, size in files.items())


def _size(path: Path) -> int | None:
    return path.stat().st_size if path.is_file() else None


def _is_of_input(run: Run, input_: str, configuration: Configuration) -> bool:
    with open_clip(input_, configuration.options) as source:
        digest = digest_of(source.files)
    return bool(run.manifest["input"]["sha256"] == digest.sha256)
