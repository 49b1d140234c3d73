"""Templates, style and scripts put together to one HTML text that needs nothing but itself."""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ttcvid.report.series import as_json

_PACKAGE = "ttcvid.report"


@cache
def _environment() -> Environment:
    """Every value is escaped: names of files and objects come from outside."""
    environment = Environment(
        loader=PackageLoader(_PACKAGE), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["seconds"] = lambda value: "–" if value is None or value != value else f"{value:.2f} s"
    return environment


def render(template: str, data: Any, **values: Any) -> str:
    """The page of a template, with ``data`` for its scripts as JSON.

    Raises
    ------
    ValueError
        ``data`` holds NaN or infinity.
    """
    return (
        _environment()
        .get_template(template)
        .render(
            data=Markup(as_json(data)),  # as_json leaves nothing that ends a script element
            style=_text("vendor/uPlot.min.css") + _text("templates/style.css"),
            library=_text("vendor/uPlot.iife.min.js"),
            library_licence=_text("vendor/uPlot.LICENSE"),
            **values,
        )
    )


def render_still(template: str, **values: Any) -> str:
    """The page of a template without scripts and plots."""
    return _environment().get_template(template).render(style=_text("templates/style.css"), **values)


def script(name: str) -> Markup:
    """A script of the package, to be put into a page as it is."""
    return _text(f"templates/{name}")


@cache
def _text(name: str) -> Markup:
    return Markup((resources.files(_PACKAGE) / name).read_text(encoding="utf-8"))  # our own files
