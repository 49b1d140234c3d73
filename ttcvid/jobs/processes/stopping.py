"""Ctrl-C and SIGTERM as a wish that is granted between two frames, so that what is done is kept."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Iterable, Iterator
from types import FrameType, TracebackType
from typing import Any, Self, TypeVar

T = TypeVar("T")

SIGNALS = (signal.SIGINT, signal.SIGTERM)
_LOG = logging.getLogger(__name__)


class StopSignals:
    """While entered, the first signal sets ``is_requested``; a second one raises KeyboardInterrupt at once.

    ``note`` is what is logged at the first. Python delivers signals to its main thread only; in any other thread this
    does nothing.
    """

    def __init__(self, note: str = "stopping: what has been analysed is being kept; once more discards it") -> None:
        self.is_requested = False
        self._note = note
        self._former: dict[signal.Signals, Any] = {}

    def until_requested(self, items: Iterable[T]) -> Iterator[T]:
        """The items, ending early when a stop is requested."""
        for item in items:
            if self.is_requested:
                return
            yield item

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self.is_requested:
            raise KeyboardInterrupt
        self.is_requested = True
        _LOG.warning("%s", self._note)

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._former = {number: signal.signal(number, self._on_signal) for number in SIGNALS}
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        for number, former in self._former.items():
            signal.signal(number, former)
