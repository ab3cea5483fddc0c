"""How the site's search ranks its results: by headings, guides before theory and reference, studies last."""

from __future__ import annotations

import json
from pathlib import Path

from website.words import DOCS, STUDIES, menu

#: What the pages below a page of the menu, or in a folder that the build makes, are put behind by; a heading that has
#: all words of a search is worth 100.
BEHIND = {
    "theory/index": 8,
    "reference/index": 8,
    "compared/index": 8,
    STUDIES: 60,
    "gallery": 20,
    "reference": 20,
}


def write(file: Path, docs: Path = DOCS) -> str:
    """Write the script into a file, and give its path for ``html_search_scorer``."""
    behind = {
        page: cost
        for name, cost in BEHIND.items()
        for page in (menu(name, docs) if (docs / f"{name}.md").exists() else [name])
    }
    script = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(script.replace("BEHIND", json.dumps(behind)), encoding="utf-8")
    return str(file)
