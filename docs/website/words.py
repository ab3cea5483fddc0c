"""Words and pages of the site that a user reads.

    python docs/website/words.py          prints both
    python docs/website/words.py --each   prints the words of each page too

What is generated (reference, options, changelog, contributing) and the pages of the section Studies are not counted. A
block of code, a comment and the settings of a notebook are no words.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]

#: What a user's site may have.
MOST_WORDS, MOST_PAGES = 40_000, 35

STUDIES = "benchmarks/index"
#: Pages that are made from the code or from other files, and the page of the package, which is not of the site.
GENERATED = {"reference/index", "options", "project/changelog", "project/contributing", "package"}

_TOCTREE = re.compile(r"^(`{3,}|:{3,})\{toctree\}\n(.*?)^\1", re.DOTALL | re.MULTILINE)
_NO_WORDS = re.compile(r"\A---\n.*?^---$|^```.*?^```$|<!--.*?-->", re.DOTALL | re.MULTILINE)


def listed(page: str, docs: Path = DOCS) -> list[str]:
    """Names of the pages that the contents lists of a page name, in their order."""
    text = (docs / f"{page}.md").read_text(encoding="utf-8")
    folder, found = page.rpartition("/")[0], []
    for _, body in _TOCTREE.findall(text):
        for line in body.splitlines():
            entry = line.rpartition("<")[2].rstrip("> ").strip()
            if entry and not line.startswith(":"):
                found.append(entry[1:] if entry.startswith("/") else f"{folder}/{entry}".lstrip("/"))
    return found


def menu(page: str = "index", docs: Path = DOCS) -> list[str]:
    """Names of all pages below a page, in reading order; the gallery's are made by the build."""
    pages = [page]
    for entry in listed(page, docs):
        if (docs / f"{entry}.md").exists():
            pages += menu(entry, docs)
    return pages


def words(text: str) -> int:
    """Words of a page."""
    return len(_NO_WORDS.sub("", text).split())


def users_pages(docs: Path = DOCS) -> dict[str, int]:
    """Words of each page that a user reads, in reading order."""
    studies = set(menu(STUDIES, docs))
    names = [name for name in menu(docs=docs) if name not in studies | GENERATED]
    return {name: words((docs / f"{name}.md").read_text(encoding="utf-8")) for name in names}


def main(arguments: list[str]) -> None:
    """Print them."""
    pages = users_pages()
    if "--each" in arguments:
        for name, count in sorted(pages.items(), key=lambda item: item[1]):
            print(f"{count:6,}  {name}")
    print(
        f"The user's site: {sum(pages.values()):,} words (at most {MOST_WORDS:,}), "
        f"{len(pages)} pages (at most {MOST_PAGES})"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
