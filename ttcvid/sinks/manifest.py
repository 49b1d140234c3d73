"""The manifest: what a run was made of and whether it is complete. A folder without it is no result."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from ttcvid.errors import InputError
from ttcvid.plain_files import make_anew, read_plain
from ttcvid.posix import sync_folder
from ttcvid.sinks.failures import output_errors

MANIFEST_NAME = "manifest.json"
MAX_BYTES = 100_000_000
# Tells our manifest from the other things that are called manifest.json.
FORMAT_KEY, FORMAT = "format", "ttcvid-run"


def write_manifest(path: Path, manifest: dict[str, Any]) -> None:
    """Write ``manifest`` as JSON (sorted keys, no NaN or infinity), so that ``path`` is either whole or absent.

    The content goes to a temporary name beside ``path`` and onto the disk before it gets its name.

    Raises
    ------
    OutputError
        Where it cannot be written.
    ValueError, TypeError
        Where the content is not JSON: NaN, infinity, or a type JSON has no word for.
    """
    content = {**manifest, FORMAT_KEY: FORMAT}
    text = json.dumps(content, sort_keys=True, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    temporary = path.with_name(path.name + ".partial")
    with output_errors(path):
        with make_anew(temporary) as file:
            # names of files need not be UTF-8: JSON has an escape for such bytes, which gives the name back
            file.write(text.encode("utf-8", "backslashreplace"))
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_folder(path.parent)


def read_manifest(path: Path) -> dict[str, Any]:
    """The manifest of a run; ``path`` is the file or the folder that holds it.

    Raises
    ------
    InputError
        Where there is none, or where it is not one of ours.
    """
    file = path / MANIFEST_NAME if path.is_dir() else path
    try:
        manifest = json.loads(read_plain(file, MAX_BYTES))
    except FileNotFoundError as error:
        raise InputError(f"{file}: not found, so this is no finished run: run 'ttcvid analyze' again") from error
    except (OSError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{file}: cannot be read as JSON ({reason}): run 'ttcvid analyze' again") from error
    if not isinstance(manifest, dict) or manifest.get(FORMAT_KEY) != FORMAT:
        raise InputError(
            f"{file}: field '{FORMAT_KEY}' is not '{FORMAT}', so ttcvid did not write it: give the folder of a run"
        )
    return manifest
