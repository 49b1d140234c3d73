"""Files as pages find them."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import quote


def address(file: Path, page: Path) -> str:
    """The address of a file as seen from a page: relative, so that both can move together.

    >>> address(Path("/runs/a run/overlay.mp4"), Path("/runs/pages/both.html"))
    './../a%20run/overlay.mp4'
    """
    relative = Path(os.path.relpath(file.resolve(), page.resolve().parent))
    return "./" + quote(os.fsencode(relative.as_posix()))
