"""Pages that no contents list names: a page that is added or split needs no entry to be found."""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx

_TOCTREE = re.compile(r"^(`{3,}|:{3,})\{toctree\}\n(.*?)^\1", re.DOTALL | re.MULTILINE)
_PLACE = "<!-- made by the build: pages of no other list -->"
#: Pages of the folder that are no pages of the site, and the first one.
_NONE = {"package", "index"}


def listed(folder: Path) -> set[str]:
    """Names of the pages of the folder that a contents list names, from its own pages and those of subfolders."""
    found = set()
    for page in folder.rglob("*.md"):
        for _, body in _TOCTREE.findall(page.read_text(encoding="utf-8")):
            for line in body.splitlines():
                entry = line.rpartition("<")[2].rstrip("> ").strip()
                at_top = entry.startswith("/") or page.parent == folder
                if entry and not line.startswith(":") and at_top:
                    found.add(entry.lstrip("/"))
    return found


def rest(folder: Path) -> list[str]:
    """Names of the other pages."""
    return sorted({page.stem for page in folder.glob("*.md")} - listed(folder) - _NONE)


def read_source(app: Sphinx, name: str, source: list[str]) -> None:
    """Handler of ``source-read``."""
    if name == "all_pages":
        entries = "\n".join(rest(Path(app.srcdir)))
        source[0] = source[0].replace(_PLACE, f"```{{toctree}}\n:hidden:\n{entries}\n```")


def setup(app: Sphinx) -> None:
    """Register all of this file."""
    app.connect("source-read", read_source)
