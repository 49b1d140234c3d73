"""What the manual says is so: pages that come from the code are up to date, and names in the others exist."""

import doctest
import importlib
import importlib.util
import pkgutil
import re
import struct
import sys
from pathlib import Path
from types import ModuleType

import click
import pytest
import yaml

import ttcvid
import ttcvid.geometry
from ttcvid.cli.commands import COMMANDS, cli
from ttcvid.cli.main import EXIT_INTERRUPTED
from ttcvid.errors import TtcvidError
from ttcvid.jobs.settings.layers import layer_from_environment, layer_from_file
from ttcvid.model import FrameStatus, Status
from ttcvid.schema import TABLE_NAMES, TABLES, markdown_of

REPOSITORY = Path(__file__).resolve().parent.parent
DOCS = REPOSITORY / "docs"
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
COMMAND_LINE = (DOCS / "command_line.md").read_text(encoding="utf-8")
PAGES = sorted([*REPOSITORY.glob("*.md"), *DOCS.glob("*.md")])
LARGEST_PICTURE_BYTES = 400_000
# Options of other programs, and patterns, in our own pages.
FOREIGN_OPTIONS = {"--write-docs"}


def script(name: str) -> ModuleType:
    """A script of the docs folder as a module."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def blocks(text: str, language: str) -> list[str]:
    """The fenced blocks of a language ("" for none), indented ones too."""
    found, kind, lines = [], None, []
    for line in text.splitlines():
        fence = line.strip().removeprefix("```") if line.strip().startswith("```") else None
        if fence is None:
            lines.append(line)
        elif kind is None:
            kind, lines = fence, []
        else:
            found += ["\n".join(lines)] if kind == language else []
            kind = None
    return found


def options_of(command: str) -> set[str]:
    found = cli.get_command(click.Context(cli), command)
    assert found is not None
    names = {"--help"}
    for parameter in found.params:
        names |= {*parameter.opts, *parameter.secondary_opts}
    return names


def test_page_of_tables_is_what_the_schema_says():
    page = (DOCS / "tables.md").read_text(encoding="utf-8")
    assert page == script("tables").tables_page(), "run: python docs/tables.py"
    for name in TABLE_NAMES:
        assert markdown_of(name) in page
        assert page.count(f"## {name}\n") == 1


def test_page_of_parameters_is_what_their_classes_say():
    page = (DOCS / "configuration.md").read_text(encoding="utf-8")
    assert page == script("tables").configuration_page(), "run: python docs/tables.py"
    assert "| `max_tracks` | whole number >= 20, <= 20000 | `1300` |" in page


@pytest.mark.parametrize("name", sorted(path.name for path in DOCS.glob("*.svg")))
def test_figures_are_what_their_script_draws(name):
    assert (DOCS / name).read_text(encoding="utf-8") == script("figures").FIGURES[name](), "run: python docs/figures.py"


def test_picture_of_the_readme_has_the_size_of_the_demo_and_is_moderate():
    content = (DOCS / "overlay.png").read_bytes()
    assert content.startswith(b"\x89PNG")
    assert struct.unpack(">II", content[16:24]) == (640, 360)
    assert len(content) < LARGEST_PICTURE_BYTES


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_within_the_repository_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith("http"):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        assert file.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.+)$", file.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}, target


def test_tests_named_in_the_page_of_promises_exist():
    page = (DOCS / "reliability.md").read_text(encoding="utf-8")
    named = re.findall(r"`(tests/\w+/test_\w+\.py)(?:::(\w+))?`", page)
    assert named
    for path, function in named:
        assert f"def {function or 'test_'}" in (REPOSITORY / path).read_text(encoding="utf-8"), (path, function)


def test_every_page_is_in_the_navigation_of_the_site():
    listed = re.findall(r"- (?:\w+: )?(\w+\.md)$", (REPOSITORY / "mkdocs.yml").read_text("utf-8"), re.MULTILINE)
    assert sorted(listed) == sorted(
        [*(page.name for page in DOCS.glob("*.md")), *script("site_pages").PAGE_OF.values()]
    )


def test_commands_of_the_pages_exist_with_the_options_shown():
    n_commands = 0
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        shown = [line.split("#")[0].split() for block in blocks(text, "") for line in block.splitlines()]
        commands = [words for words in shown if len(words) > 1 and words[0] == "ttcvid"]
        for _, command, *arguments in commands:
            assert command in COMMANDS, (page.name, command)
            given = {word for word in arguments if word.startswith("-")}
            assert given <= options_of(command), (page.name, command, given)
        n_commands += len(commands)
    assert n_commands >= 40


def test_options_named_in_the_pages_exist():
    known = FOREIGN_OPTIONS.union(*(options_of(command) for command in COMMANDS))
    for page in PAGES:
        for option in re.findall(r"`(--[a-z][a-z0-9-]*)", page.read_text(encoding="utf-8")):
            assert option in known, (page.name, option)


def test_targets_of_make_named_in_the_pages_exist():
    targets = set(re.findall(r"^([a-z]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for page in PAGES:
        assert set(re.findall(r"(?:^|`)make ([a-z]+)", page.read_text(encoding="utf-8"), re.MULTILINE)) <= targets


def test_configuration_shown_is_accepted(tmp_path):
    examples = blocks(COMMAND_LINE, "toml")
    assert examples
    for number, example in enumerate(examples):
        path = tmp_path / f"{number}.toml"
        path.write_text(example, encoding="utf-8")
        assert layer_from_file(path).entries["tracking"]["max_tracks"].value == 800


def test_environment_variables_shown_are_accepted():
    assignments = dict(re.findall(r"`(TTCVID_[A-Z_]+)=([^`]+)`", COMMAND_LINE))
    assert "TTCVID_TRACKING__MAX_TRACKS" in assignments
    layer_from_environment(assignments)


def test_example_of_the_conventions_gives_what_it_says():
    failed, attempted = doctest.testfile(str(DOCS / "conventions.md"), module_relative=False)
    assert attempted >= 4
    assert failed == 0


def test_python_example_uses_names_that_exist():
    (example,) = blocks((DOCS / "python.md").read_text(encoding="utf-8"), "python")
    compile(example, "python.md", "exec")
    for name in re.findall(r"\bttcvid\.(\w+)", example):
        assert hasattr(ttcvid, name), name
    columns = {column.name for column in TABLES["clusters"]}
    assert set(re.findall(r'"(\w+)"', example.split("]]")[0].split("[[")[1])) <= columns


def test_functions_of_the_page_of_equations_exist_and_say_where_they_come_from():
    named = re.findall(r"^::: ([\w.]+)\.(\w+)$", (DOCS / "equations.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(named) >= 8
    for module, function in named:
        documented = getattr(importlib.import_module(module), function).__doc__
        assert "Source: " in documented, function


def test_examples_in_the_docstrings_of_the_geometry_give_what_they_say():
    modules = pkgutil.walk_packages(ttcvid.geometry.__path__, "ttcvid.geometry.")
    results = [doctest.testmod(importlib.import_module(module.name)) for module in modules]
    assert sum(result.failed for result in results) == 0
    assert sum(result.attempted for result in results) >= 50


@pytest.mark.data
@pytest.mark.slow
def test_code_of_the_tutorial_runs_and_draws_its_plots(data_dir, tmp_path, monkeypatch):
    monkeypatch.setenv("TTCVID_DATA", str(data_dir))
    page = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    printed, variables = script("tutorial").run_page(page, tmp_path)
    assert variables["error"].median() < 0.1
    assert variables["run"].events.empty
    assert "changed: configuration.events.max_ttc_s from 4 to 8" in printed
    assert (tmp_path / "both.html").stat().st_size > 0
    pictures = re.findall(r"\]\((tutorial_\w+\.png)\)", page)
    assert len(pictures) == 2
    for picture in pictures:
        assert (tmp_path / picture).read_bytes()[16:24] == (DOCS / picture).read_bytes()[16:24]
        assert (DOCS / picture).stat().st_size < LARGEST_PICTURE_BYTES / 8


def test_every_status_is_explained():
    page = (DOCS / "how_it_works.md").read_text(encoding="utf-8")
    for status in (*(status.name for status in Status), *(status.value for status in FrameStatus)):
        assert f"`{status}`" in page, status


def test_every_table_and_file_of_a_result_is_named_where_results_are_listed():
    results = (DOCS / "results.md").read_text(encoding="utf-8")
    for name in (*(f"{name}.parquet" for name in TABLE_NAMES), "overlay.mp4", "manifest.json"):
        assert f"`{name}`" in README
        assert f"`{name}`" in results


def test_every_command_and_exit_code_is_explained():
    for command in COMMANDS:
        assert f"`{command}`" in README
    for code in {0, 4, EXIT_INTERRUPTED, *(error.exit_code for error in TtcvidError.__subclasses__())}:
        assert f"\n| {code} |" in COMMAND_LINE


def test_citation_names_the_version_of_the_package():
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == ttcvid.__version__
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["references"][0]["title"] == "Monocular Navigation in Large Scale Dynamic Environments"


def test_version_of_the_changelog_is_that_of_the_package():
    newest = re.search(r"^## ([\d.]+)", (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert newest is not None
    assert newest[1] == ttcvid.__version__


def test_each_column_leads_to_the_function_that_makes_it():
    text = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.*) \| \[(\w+)\]\((ttcvid/[\w/]+\.py)\) \|$", text, flags=re.MULTILINE)
    for _, function, path in rows:
        assert re.search(rf"^ *def {function}\(", (REPOSITORY / path).read_text(), flags=re.MULTILINE), (function, path)
    named = {name for columns, *_ in rows for name in re.findall(r"`(\w+)`", columns)}
    assert {column.name for table in TABLES.values() for column in table} - named == set()
