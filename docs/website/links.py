"""Links of the pages that leave the folder of the docs, and keys of the bibliography."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.nodes import make_refnode

from website.gallery import label_of

#: Files beside the docs that have a page of the site.
PAGES = {
    "CONTRIBUTING.md": "/project/contributing.md",
    "CHANGELOG.md": "/project/changelog.md",
    "CITATION.cff": "/references.md",
    "README.md": "/index.md",
    "examples": "/gallery/index.rst",
}
_OUTSIDE = re.compile(r"\[([^\]]*)\]\(\.\./([^)#]+)(?:#[^)]*)?\)")
_LINK = re.compile(
    r"\[([^\]]*)\]\(((?:docs/|examples|benchmarks|CITATION|CHANGELOG|CONTRIBUTING|README|LICENSE|fuzz|src)[^)]*)\)"
)
_KEYS = re.compile(r"\[((?:[a-z]+\d{4}[a-z]?)(?:, *[a-z]+\d{4}[a-z]?)*)\]")
_ENTRY = re.compile(r"^@\w+\{(\w+),", re.MULTILINE)


def keys_of(bibliography: Path) -> tuple[str, ...]:
    """The keys of a BibTeX file, in its order."""
    return tuple(_ENTRY.findall(bibliography.read_text(encoding="utf-8")))


def inside(text: str) -> str:
    """The text of a page with links that lead into the site; what has no page there is its path as code."""
    return _OUTSIDE.sub(lambda link: _inside(link[1], link[2]), text)


def _inside(text: str, path: str) -> str:
    path = path.rstrip("/")
    if path in PAGES:
        return f"[{text}]({PAGES[path]})"
    if path.startswith("examples/"):
        return f"[{text}](#{label_of(Path(path).stem)})"
    name = text.strip("`")
    return f"`{path}`" if name in path else f"{text} (`{path}`)"


def of_the_repository(text: str) -> str:
    """The text of a file of the repository's folder, its links those of a page of `project`."""
    return _LINK.sub(lambda link: _of_the_repository(link[1], link[2]), text)


def _of_the_repository(text: str, path: str) -> str:
    if path.startswith("docs/"):
        return f"[{text}](/{path.removeprefix('docs/')})"
    return _inside(text, path)


class Citations(SphinxPostTransform):
    """Keys in square brackets become links to the page of references."""

    default_priority = 5

    def run(self, **_: Any) -> None:
        """Replace the texts of one page."""
        if self.env.docname == "references":
            return
        known = set(self.config.flexhinf_keys)
        for text in list(self.document.findall(nodes.Text)):
            if isinstance(text.parent, (nodes.literal, nodes.literal_block, nodes.raw, nodes.math)):
                continue
            parts = self.parts(text.astext(), known)
            if len(parts) > 1:
                text.parent.replace(text, parts)

    def parts(self, text: str, known: set[str]) -> list[nodes.Node]:
        """The text, its keys replaced by links."""
        found: list[nodes.Node] = []
        end = 0
        for match in _KEYS.finditer(text):
            keys = [key.strip() for key in match[1].split(",")]
            if not known.issuperset(keys):
                continue
            found.append(nodes.Text(text[end : match.start()] + "["))
            for number, key in enumerate(keys):
                found += [nodes.Text(", ")] if number else []
                found.append(self.link(key))
            found.append(nodes.Text("]"))
            end = match.end()
        return [*found, nodes.Text(text[end:])] if found else [nodes.Text(text)]

    def link(self, key: str) -> nodes.Node:
        """A link to the entry of one key."""
        assert self.env.docname
        return make_refnode(
            self.app.builder, self.env.docname, "references", key, nodes.inline("", key, classes=["citation"])
        )


def read_source(app: Sphinx, name: str, source: list[str]) -> None:
    """Handler of ``source-read``."""
    if "/" not in name and Path(app.env.doc2path(name)).suffix == ".md":
        source[0] = inside(source[0])


def include_read(_: Sphinx, path: Path, __: str, content: list[str]) -> None:
    """Handler of ``include-read``."""
    if Path(path).parent.name != "docs":
        content[0] = of_the_repository(content[0])


def setup(app: Sphinx) -> None:
    """Register all of this file."""
    app.add_config_value("flexhinf_keys", (), "env")
    app.connect("source-read", read_source)
    app.connect("include-read", include_read)
    app.add_post_transform(Citations)
