"""Which seeds are drawn: those for building, and those of a verdict, which nobody can have looked at."""

from __future__ import annotations

import hashlib
import subprocess
import zlib
from pathlib import Path

import numpy as np
from numpy.random import Generator

BUILDING_SEEDS = range(200)
"""For work on the estimator; a verdict never uses them."""
_REPOSITORY = Path(__file__).resolve().parents[2]


def verdict_seeds(commit: str, n: int) -> list[int]:
    """Seeds of a verdict on a commit (its full hash): the same for everybody, unknown before the commit is made.

    >>> verdict_seeds("0" * 40, 2) == verdict_seeds("0" * 40, 3)[:2]
    True
    """
    seeds: list[int] = []
    for k in range(n):
        digest = hashlib.sha256(f"{commit}:{k}".encode()).digest()
        seeds.append(len(BUILDING_SEEDS) + int.from_bytes(digest[:4], "big"))
    return seeds


def commit_hash(name: str) -> str:
    """The full hash of a commit; ends the program where git does not know it."""
    words = ["git", "rev-parse", "--verify", "--quiet", f"{name}^{{commit}}"]
    done = subprocess.run(words, cwd=_REPOSITORY, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"--verdict {name}: git knows no such commit")
    return done.stdout.strip()


def generator(family: str, seed: int, purpose: str) -> Generator:
    """Random numbers for one purpose of one scene: a change of one purpose leaves the others as they are."""
    return np.random.default_rng([zlib.crc32(family.encode()), seed, zlib.crc32(purpose.encode())])
