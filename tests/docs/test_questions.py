"""Sixty questions of users: each has a page and a heading two clicks away, and the site's search finds it.

The search is that of the site: Sphinx builds its index of the pages, and its own script ranks the results in a browser.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

#: Among so many first results of the search is the page of the answer.
FIRST = 3


class Question(NamedTuple):
    """A question, the page and heading of its answer, and the words that find it."""

    text: str
    page: str
    heading: str
    words: str


DOCS = Path(__file__).resolve().parents[2] / "docs"
QUESTIONS = [
    Question(*entry)
    for entry in tomllib.loads((DOCS / "questions.toml").read_text(encoding="utf-8"))["question"]
]


def test_there_are_sixty_questions() -> None:
    assert len({each.text for each in QUESTIONS}) == len(QUESTIONS) >= 60


@pytest.mark.parametrize("question", QUESTIONS, ids=lambda each: each.text)
def test_an_answer_is_under_its_heading(question: Question) -> None:
    text = (DOCS / f"{question.page}.md").read_text(encoding="utf-8")
    plain = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    assert question.heading in re.findall(r"^#+ (.+)$", plain, re.MULTILINE)


def test_an_answer_is_two_clicks_from_the_first_page(website: Callable[[str], Any]) -> None:
    """One in the bar at the top, one in its contents; headings of a page stand beside it."""
    site = website("words")
    near = set(site.listed("index"))
    for page in tuple(near):
        near |= set(site.listed(page)) if (DOCS / f"{page}.md").exists() else set()
    assert {each.page for each in QUESTIONS} <= near


#: Pages by words: those of the results, best first, each once. Sphinx's own script ranks them.
RANKED = """words => words.map(text => {
    const found = Search._performSearch(...Search._parseQuery(text));
    return [...new Set(found.reverse().map(result => result[0]))];
})"""


@pytest.mark.ci("builds the search index of all pages, and searches in a browser")
def test_the_search_of_the_site_finds_each_answer(
    browser: Any, website: Callable[[str], Any], tmp_path: Path
) -> None:
    """No gallery, notebook or reference is made: these pages are those that have no answer of the list."""
    settings = {
        "extensions": "myst_parser,sphinx_design",
        "html_theme": "basic",
        "exclude_patterns": "package.md,website,gallery",
        "html_search_scorer": website("search").write(tmp_path / "scorer.js"),
    }
    words = [sys.executable, "-m", "sphinx", "-C", "-Q", "-b", "html"]
    words += [f"-D{name}={value}" for name, value in settings.items()]
    subprocess.run([*words, str(DOCS), str(tmp_path / "html")], check=True, capture_output=True)
    page = browser.new_page()
    page.goto((tmp_path / "html" / "search.html").as_uri())
    page.wait_for_function("typeof Search !== 'undefined' && Search._index !== null")
    ranked = page.evaluate(RANKED, [each.words for each in QUESTIONS])
    page.close()
    late = {
        each.words: found[: FIRST + 2]
        for each, found in zip(QUESTIONS, ranked, strict=True)
        if each.page not in found[:FIRST]
    }
    assert not late, "\n".join(f"{text}: {', '.join(found)}" for text, found in late.items())
