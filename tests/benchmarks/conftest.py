"""The benchmarks are scripts of a folder of their own: their helper functions are imported from there.

What they compute is drawn as the tests of the geometry draw it.
"""

import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
for folder in (REPOSITORY / "benchmarks", REPOSITORY / "tests" / "geometry"):
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
