"""YAML that people and strangers write, read strictly: no aliases, no tags that make objects, no key twice.

Aliases can make a file of a kilobyte into gigabytes, and of two values of one key the first would vanish in silence.
"""

from __future__ import annotations

import re
from typing import Any, ClassVar

import yaml

MAX_CHARACTERS = 1_000_000
"""PyYAML needs a second for 50 kB; scenes, suites and baselines have some 30 kB."""
MAX_BYTES = 4 * MAX_CHARACTERS
"""Of a file that is read to be such a text: UTF-8 needs at most 4 bytes for a character."""
_LONGEST_PROBLEM = 200


class StrictYamlError(ValueError):
    """What is wrong with a text, in one short line; ``line`` counts from 1, None where no line is to blame."""

    def __init__(self, problem: object, line: int | None = None) -> None:
        super().__init__(" ".join(str(problem).split())[:_LONGEST_PROBLEM])
        self.line = line

    @property
    def place(self) -> str:
        """What follows the file's name in a message."""
        return "" if self.line is None else f", line {self.line}"


class StrictLoader(yaml.SafeLoader):
    """YAML of numbers, text, lists and mappings; mappings may have tags that begin with ``mapping_tags``."""

    mapping_tags: ClassVar[tuple[str, ...]] = ()

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse aliases and tags before anything is made of them."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        problem = None
        if isinstance(event, yaml.AliasEvent):
            problem = "aliases (*name) are not accepted: write the value out"
        elif event.tag is not None and not event.tag.startswith(self.mapping_tags):
            problem = f"the tag {event.tag} is not accepted: take it out"
        elif event.tag is not None and not isinstance(event, yaml.MappingStartEvent):
            problem = f"the tag {event.tag} stands before something without keys"
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Refuse a key that is given twice."""
        seen: set[object] = set()
        for key, _ in node.value:
            # A key that is a list or mapping is refused by the base class.
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"key {key.value!r} is given twice", problem_mark=key.start_mark)
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
        return super().construct_mapping(node, deep)


# YAML 1.1, which PyYAML follows, takes 1e-05 for text; every other program writes small numbers that way. .Nan is how
# OpenCV spells it.
StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$|^\.Nan$"),
    list("-+.0123456789"),
)


def load_yaml(
    text: str,
    *,
    loader: type[StrictLoader] = StrictLoader,
    max_characters: int = MAX_CHARACTERS,
    first_of_many: bool = False,
) -> Any:
    """The content of a YAML text; with ``first_of_many`` that of its first document.

    Raises
    ------
    StrictYamlError
        Malformed, too long, or it uses aliases, object tags or the same key twice.
    """
    if len(text) > max_characters:
        raise StrictYamlError(f"over {max_characters // 1000} kB of YAML")
    try:
        reader = loader(text)
        try:
            return reader.get_data() if first_of_many else reader.get_single_data()
        finally:
            reader.dispose()
    except yaml.MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        raise StrictYamlError(error.problem, line) from None
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        raise StrictYamlError(error) from None
