"""Checks as a JUnit file, which every CI service can show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree


@dataclass(frozen=True)
class Suite:
    """Named cases with their failures (none: passed), and why all of it was skipped (empty: it was not).

    ``error`` says why it could not be checked at all.
    """

    name: str
    cases: Sequence[tuple[str, Sequence[str]]]
    time_s: float = 0.0
    skipped: str = ""
    error: str = ""


def junit_xml(suites: Sequence[Suite]) -> str:
    """The content of a JUnit file: a test suite each, a test case for each check."""
    root = ElementTree.Element("testsuites", name="ttcvid")
    for suite in suites:
        cases = suite.cases or [("result", [])]
        n_failed = sum(bool(failures) for _, failures in suite.cases)
        counts = {"tests": len(cases), "failures": n_failed, "errors": int(bool(suite.error))}
        counts["skipped"] = len(cases) if suite.skipped else 0
        about = {"name": suite.name, "time": f"{suite.time_s:.3f}"}
        about |= {name: str(count) for name, count in counts.items()}
        element = ElementTree.SubElement(root, "testsuite", about)
        for name, failures in cases:
            _add_case(element, suite, name, failures)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _add_case(parent: ElementTree.Element, suite: Suite, name: str, failures: Sequence[str]) -> None:
    case = ElementTree.SubElement(parent, "testcase", classname=suite.name, name=name)
    if suite.skipped:
        ElementTree.SubElement(case, "skipped", message=suite.skipped)
    elif suite.error:
        ElementTree.SubElement(case, "error", message=suite.error)
    elif failures:
        ElementTree.SubElement(case, "failure", message=failures[0]).text = "\n".join(failures)
