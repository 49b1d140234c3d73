"""Errors on their way from one process to another."""

from __future__ import annotations

import pickle
import traceback


def as_sendable(error: BaseException) -> BaseException:
    """The error as another process can be told of it, with its traceback as a note."""
    trace = "".join(traceback.format_exception(error))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # whatever its class does when it is taken apart and put together
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.add_note(trace)
    return error
