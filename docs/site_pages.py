"""What makes a site of the pages (`make docs`): README and its neighbours become pages, links are turned to them.

The pages are written to be read in the repository. A link to a file that is no page (a configuration, a benchmark) has
nothing to lead to on the site; there its text stands alone, with the path of the file.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

REPOSITORY = Path(__file__).resolve().parent.parent
DOCS = "docs"
PAGE_OF = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changes.md"}
"""Pages of the site that stand beside the folder of the others."""
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)")
_PICTURE = re.compile(rf"(!\[[^\]]*\]\(){DOCS}/")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that stand at the root of the repository."""
    from mkdocs.structure.files import File

    for source, name in PAGE_OF.items():
        text = (REPOSITORY / source).read_text(encoding="utf-8")
        files.append(File.generated(config, name, content=_PICTURE.sub(r"\1", text)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn the links of a page from the repository's files to the site's."""
    if page.file.src_uri == "python.md":
        markdown = markdown.replace("::: ttcvid", _public_names())
    at_root = {name: source for source, name in PAGE_OF.items()}
    source = at_root.get(page.file.src_uri, f"{DOCS}/{page.file.src_uri}")

    def turned(link: re.Match[str]) -> str:
        text, target = link.groups()
        if re.match(r"https?:|#", target):
            return link[0]
        path, hash_sign, anchor = target.partition("#")
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        name = PAGE_OF.get(path, path.removeprefix(f"{DOCS}/"))
        if files.get_file_from_path(name) is not None:
            return f"[{text}]({name}{hash_sign}{anchor})"
        if not (REPOSITORY / path).exists():
            return link[0]  # the builder names it as broken
        return f"{text} (`{path}`)"

    return _LINK.sub(turned, markdown)


def _public_names() -> str:
    """Where each public name of the package is defined: some are functions that share their name with a subpackage."""
    from ttcvid import _HOMES, __all__

    classes_last = sorted(__all__, key=lambda name: (name[0].isupper(), name))
    return "\n".join(
        f"::: {_HOMES[name]}.{name}\n    options:\n      heading: ttcvid.{name}\n      toc_label: {name}"
        for name in classes_last
    )
