"""Runs the code of docs/tutorial.md, puts what it prints into the page and its plots beside it.

The command is ``python docs/tutorial.py``. It needs the real clips (TTCVID_DATA, default ../shared/data).
"""

from __future__ import annotations

import io
import os
import re
import shutil
import tempfile
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_suffix(".md")
_BLOCK = re.compile(r"```(python|text)\n(.*?)```", re.DOTALL)


def run_page(text: str, folder: Path) -> tuple[str, dict[str, Any]]:
    """Run the Python blocks of a page one after the other, with ``folder`` as working folder.

    Returns the page with each text block holding what the code before it printed, and the variables that are left.
    """
    variables: dict[str, Any] = {}
    printed = io.StringIO()

    def replaced(block: re.Match[str]) -> str:
        if block[1] == "text":
            said = "\n".join(line.rstrip() for line in printed.getvalue().splitlines())
            printed.seek(0)
            printed.truncate()
            return f"```text\n{said}\n```"
        exec(compile(block[2], PAGE.name, "exec"), variables)
        return block[0]

    with chdir(folder), redirect_stdout(printed):
        return _BLOCK.sub(replaced, text), variables


def main() -> None:
    """Renew the page and its plots."""
    os.environ.setdefault("TTCVID_DATA", str(PAGE.parents[2] / "shared" / "data"))
    with tempfile.TemporaryDirectory() as folder:
        text, _ = run_page(PAGE.read_text(encoding="utf-8"), Path(folder))
        for picture in Path(folder).glob("*.png"):
            shutil.copy(picture, PAGE.parent)
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
