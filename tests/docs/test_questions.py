"""Sixty questions of users: each has a page and a heading two clicks away, and the site's search finds it first.

The search is that of the site: Sphinx builds its index of the pages, and the site's script ranks the results.
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


#: The first results by words: each is a name of a page, and its title with the heading at which it opens.
FOUND = """words => words.map(text => {
    history.replaceState(null, "", "?q=" + encodeURIComponent(text));
    return Search._performSearch(...Search._parseQuery(text)).reverse().slice(0, 3).map(result => result.slice(0, 2));
})"""


def assert_found_first(browser: Any, html: Path) -> None:
    """The first result of each search opens at the heading of the answer."""
    page = browser.new_page()
    page.goto((html / "search.html").as_uri())
    page.wait_for_function("typeof Search !== 'undefined' && Search._index !== null")
    found = page.evaluate(FOUND, [each.words for each in QUESTIONS])
    page.close()
    plain = str.maketrans({"“": '"', "”": '"', "’": "'"})
    wrong = [
        f"{each.words}: {results}"
        for each, results in zip(QUESTIONS, found, strict=True)
        if [(page, text.translate(plain).rpartition(" > ")[2]) for page, text in results[:1]]
        != [(each.page, each.heading)]
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.ci("builds the search index of all pages, and searches in a browser")
def test_the_search_finds_each_answer_first(
    browser: Any, website: Callable[[str], Any], tmp_path: Path
) -> None:
    """Neither gallery nor reference is made here; the test of the site as it was built has them."""
    settings = {
        "extensions": "myst_parser,sphinx_design",
        "html_theme": "basic",
        "exclude_patterns": "package.md,website,gallery",
        "html_search_scorer": website("search").write(tmp_path / "scorer.js"),
    }
    words = [sys.executable, "-m", "sphinx", "-C", "-Q", "-b", "html"]
    words += [f"-D{name}={value}" for name, value in settings.items()]
    subprocess.run([*words, str(DOCS), str(tmp_path / "html")], check=True, capture_output=True)
    assert_found_first(browser, tmp_path / "html")


@pytest.mark.ci("a browser, and the site that was built before")
def test_the_search_of_the_whole_site_finds_each_answer_first(browser: Any, repository: Path) -> None:
    html = repository / "build" / "docs" / "html"
    if not (html / "searchindex.js").exists():
        pytest.skip("missing: build/docs/html, which `make docs` makes")
    assert_found_first(browser, html)
