"""How the site's search ranks its results: headings first, Studies last."""

from __future__ import annotations

import json
from pathlib import Path

from website.words import DOCS, STUDIES, menu

#: Sphinx's own scores, and what this site adds: a result is a name of a page, a title, …, its score, a file and a kind.
_SCRIPT = """var Scorer = {
  studies: new Set(%s),
  score: ([page, title, anchor, description, score, file, kind]) =>
    score + (kind === "title" ? 20 : 0) - (Scorer.studies.has(page) ? 50 : 0),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: {0: 15, 1: 5, 2: -5},
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
"""


def write(file: Path, docs: Path = DOCS) -> str:
    """Write the script into a file, and give its path for ``html_search_scorer``."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(_SCRIPT % json.dumps(menu(STUDIES, docs)), encoding="utf-8")
    return str(file)
