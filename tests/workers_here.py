"""A worker that carries out calls in the process of the test: no time for new processes, and faults as one likes."""

from collections.abc import Callable
from typing import Any


class WorkerHere:
    """``before`` is called with function and arguments of each call; whoever is to be avoided takes another name."""

    def __init__(self, before: Callable[..., None] = lambda function, *arguments: None) -> None:
        self.name = "here"
        self.before = before

    def call(self, function: Callable[..., Any], *arguments: Any, on_news: Any = None, avoid: str = "") -> Any:
        if avoid == self.name:
            self.name += "'"
        self.before(function, *arguments)
        return function(*arguments, **({} if on_news is None else {"on_news": on_news}))

    def close(self) -> None:
        pass
