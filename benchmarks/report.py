"""What a benchmark says: lines, tables and figures against their bars, printed as they come and kept for the docs."""

from __future__ import annotations

import math
import platform
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Bar:
    """A limit that a figure has to keep: not above ``limit``, or with ``at_least`` not below it, nor above ``most``."""

    limit: float
    at_least: bool = False
    most: float = math.inf

    def is_kept_by(self, value: float) -> bool:
        """False for NaN: no figure, no pass."""
        return self.limit <= value <= self.most if self.at_least else value <= self.limit

    def __str__(self) -> str:
        if self.most < math.inf:
            return f"{self.limit:g}-{self.most:g}"
        return f"{'>=' if self.at_least else '<='} {self.limit:g}"


class Report:
    """The findings of one or several benchmarks, in the order in which they were made."""

    def __init__(self) -> None:
        self.missed: list[str] = []
        self._markdown: list[str] = []

    def heading(self, text: str) -> None:
        """Begin a section."""
        print(f"\n{text}\n{'-' * len(text)}")
        self._markdown.append(f"\n## {text}\n")

    def say(self, text: str) -> None:
        """A line of prose."""
        print(text)
        self._markdown.append(f"{text}\n")

    def command(self, words: list[str]) -> None:
        """The exact command behind the figures that follow."""
        line = " ".join(words)  # unquoted: $TTCVID_DATA is to be expanded by the shell
        print(f"$ {line}")
        self._markdown.append(f"```\n{line}\n```\n")

    def figure(self, name: str, value: float, unit: str = "", bar: Bar | None = None) -> None:
        """One number, with its bar where it has one."""
        shown = f"{value:.3g}" if math.isfinite(value) else "none"
        text = f"{shown} {unit}".rstrip()
        verdict = ""
        if bar is not None:
            is_kept = bar.is_kept_by(value)
            verdict = f"bar {bar} {unit}".rstrip() + (": kept" if is_kept else ": MISSED")
            if not is_kept:
                self.missed.append(name)
        print(f"{name}: {text}" + (f"   ({verdict})" if verdict else ""))
        self._markdown.append(f"- {name}: **{text}**" + (f" ({verdict})" if verdict else ""))

    def table(self, header: list[str], rows: list[list[str]]) -> None:
        """Columns of text under a header."""
        widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
        for row in [header, *rows]:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
        lines = [header, ["---"] * len(header), *rows]
        self._markdown.append("\n" + "\n".join(f"| {' | '.join(row)} |" for row in lines) + "\n")

    def write_docs(self, name: str, title: str) -> None:
        """Write the page ``docs/NAME``, with the machine that the figures come from."""
        command = (
            f"python {Path(sys.argv[0]).resolve().relative_to(REPOSITORY)} {shlex.join(_without_places(sys.argv[1:]))}"
        )
        head = f"# {title}\n\nWritten by `{command}` on {machine()}; do not edit.\n"
        path = REPOSITORY / "docs" / name
        page = "\n".join([head.rstrip(), *self._markdown])
        path.write_text(page.replace("\n\n\n", "\n\n"), encoding="utf-8")
        print(f"\nwritten: {path}")

    def exit_code(self, check: bool) -> int:
        """1 when a bar was missed and ``check`` asks for it; the missed ones are printed at the end."""
        if self.missed:
            print(f"\nmissed: {'; '.join(self.missed)}", file=sys.stderr)
        return 1 if check and self.missed else 0


_PLACES = ("--keep", "--out", "--pictures")


def _without_places(arguments: list[str]) -> list[str]:
    """The arguments without folders for files: where they were left is nobody's business, and changes no figure."""
    is_place = [argument in _PLACES for argument in arguments]
    return [
        argument
        for k, argument in enumerate(arguments)
        if not is_place[k]
        and not (k > 0 and is_place[k - 1])
        and not argument.startswith(tuple(f"{name}=" for name in _PLACES))
    ]


def machine() -> str:
    """Processor, number of cores and Python of this machine."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        names = [line.partition(":")[2].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = f"{len(names)} x {names[0]}" if names else model
    return f"{model}, Python {platform.python_version()}"
