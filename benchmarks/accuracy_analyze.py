"""How accurate ``ttcvid analyze`` is where truth is known, and what it makes of every real clip, on one page.

python benchmarks/accuracy_analyze.py [--check] [--write-docs]

Runs equations.py, epipole.py and clips.py one after the other; ``--write-docs`` writes docs/accuracy_analyze.md.
"""

from __future__ import annotations

import argparse
import sys

import clips
import epipole
import equations
from report import Report


def main() -> int:
    """Measure and print; with ``--check`` 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="exit code 1 when a bar is missed")
    parser.add_argument("--write-docs", action="store_true", help="write docs/accuracy_analyze.md")
    arguments = parser.parse_args()
    report = Report()
    for benchmark in (equations, epipole, clips):
        benchmark.measure(report)
    if arguments.write_docs:
        report.write_docs("accuracy_analyze.md", "Accuracy of ttcvid analyze")
    return report.exit_code(arguments.check)


if __name__ == "__main__":
    sys.exit(main())
