"""Calls in copies (forks) of the test process: nothing that they load or change stays, and nothing is imported anew."""

import multiprocessing
import warnings
from collections.abc import Callable
from typing import Any


def in_copy(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function of a test module returns or raises in a copy of this process."""
    with warnings.catch_warnings():
        # Python 3.12 warns of locks that threads hold while a process is copied: no thread is needed there.
        warnings.simplefilter("ignore", DeprecationWarning)
        with multiprocessing.get_context("fork").Pool(1) as pool:
            return pool.apply(function, arguments)
