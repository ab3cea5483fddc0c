"""The skeleton of a page in Chromium: folds, contents, enlarged figures, letters on a telephone, paper, no script."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.browser import WINDOWS, opened, sheets
from tests.report.conftest import sample_page

import flexhinf as fh
from flexhinf.pages.arm_film import instants_of, two_arms

pytestmark = pytest.mark.ci("a browser")

#: Smallest letters of a drawing on a telephone, px.
LEGIBLE = 11.0

#: Sizes of all letters in drawings, as they are seen, px.
LETTERS = """() => [...document.querySelectorAll("figure svg text")].map((text) =>
    Math.hypot(text.getScreenCTM().a, text.getScreenCTM().b) * parseFloat(getComputedStyle(text).fontSize))"""

UNFOLD = "() => document.querySelectorAll('details').forEach((fold) => { fold.open = true; })"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, page_html: str) -> Path:
    path = tmp_path_factory.mktemp("page") / "index.html"
    path.write_text(page_html, encoding="utf-8")
    return path


@pytest.mark.parametrize("width", WINDOWS)
def test_letters_of_drawings_are_legible_at_every_width(browser: Any, file: Path, width: int) -> None:
    with opened(browser, file, width) as page:
        page.evaluate(UNFOLD)
        sizes = page.evaluate(LETTERS)
        assert len(sizes) > 40
        assert min(sizes) >= LEGIBLE
        assert max(sizes) <= 20.0
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_a_link_opens_the_fold_that_it_leads_into(browser: Any, file: Path) -> None:
    with opened(browser, file) as page:
        assert not page.evaluate("document.querySelector('#settings details').open")
        page.click("nav a[href='#settings']")
        page.wait_for_function("document.querySelector('#settings details').open")
        page.goto(f"{file.as_uri()}#figure-03")
        page.wait_for_function("document.querySelector('#steps details').open")
        page.wait_for_function(
            "Math.abs(document.querySelector('#figure-03').getBoundingClientRect().top) < 200"
        )


def test_the_contents_stay_in_view_and_mark_the_section(browser: Any, file: Path) -> None:
    marked = "document.querySelector('nav [aria-current]').textContent"
    with opened(browser, file) as page:
        page.evaluate(UNFOLD)
        assert page.evaluate(marked) == "Result"
        page.click("nav a[href='#steps']")
        page.wait_for_function(f"{marked} === 'Step to 180°'")
        assert page.locator("nav a[href='#again']").is_visible()
        assert page.evaluate("document.querySelector('nav').getBoundingClientRect().top") == 0
        page.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
        page.wait_for_function(f"{marked} === 'How to make this again'")


def test_the_contents_of_a_telephone_open_and_close(browser: Any, file: Path) -> None:
    with opened(browser, file, 390) as page:
        entry = page.locator("nav a[href='#steps']")
        assert not entry.is_visible()
        page.click("nav .menu")
        assert entry.is_visible()
        page.keyboard.press("Escape")
        assert not entry.is_visible()
        page.click("nav .menu")
        entry.click()
        page.wait_for_function("document.querySelector('#steps details').open")
        assert not entry.is_visible()


def test_a_figure_fills_the_window_and_comes_back(browser: Any, file: Path) -> None:
    wide = "document.querySelector('[aria-labelledby=\"figure-03-caption\"]').getBoundingClientRect().width"
    with opened(browser, file) as page:
        page.evaluate(UNFOLD)
        before, enlarged = page.evaluate(wide), page.locator("dialog[open] svg")
        for leave in (lambda: page.keyboard.press("Escape"), lambda: page.click("dialog .close")):
            page.click("#figure-03 .drawing")
            assert enlarged.count() == 1
            assert page.evaluate(wide) > 1.2 * before
            leave()
            page.wait_for_function("document.querySelector('#figure-03 .drawing svg') !== null")
            assert not page.evaluate("document.querySelector('dialog').open")
            assert page.evaluate(wide) == pytest.approx(before)
        button = page.locator("#figure-03 .enlarge")
        button.focus()
        page.keyboard.press("Enter")
        assert enlarged.count() == 1
        page.keyboard.press("Escape")
        page.wait_for_function("document.activeElement.className === 'enlarge'")


def test_all_folds_open_and_close_together(browser: Any, file: Path) -> None:
    closed = "document.querySelectorAll('main details:not([open])').length"
    with opened(browser, file) as page:
        folded = page.evaluate(closed)
        assert folded > 2
        page.click("nav .folds")
        page.wait_for_function(
            f"{closed} === 0 && document.querySelector('.folds').textContent === 'Close all'"
        )
        page.click("nav .folds")
        page.wait_for_function(f"{closed} > 2")


def test_paper_has_one_page_or_the_whole_report(browser: Any, file: Path) -> None:
    with opened(browser, file) as page:
        assert sheets(page) == 1
        page.click("nav .folds")
        assert sheets(page) > 2
        assert not page.evaluate("document.documentElement.classList.contains('brief')")


def test_a_page_is_readable_without_its_script(browser: Any, file: Path) -> None:
    with opened(browser, file, 390, java_script_enabled=False) as page:
        assert page.locator("nav a[href='#steps']").is_visible()
        for control in (".enlarge", ".folds", ".menu"):
            assert not page.locator(control).first.is_visible()
        page.locator("#steps summary").click()
        assert page.locator("#figure-03 svg").is_visible()


def test_the_script_runs_under_the_policy_of_the_page(browser: Any, file: Path) -> None:
    with opened(browser, file, bypass_csp=False) as page:
        assert page.locator("html.js").count() == 1


def test_a_film_plays_where_its_poses_are_drawn(browser: Any, tmp_path: Path) -> None:
    """Its last instant lies on the last pose of the drawing; the slider shows any other, and paper none."""
    time = np.linspace(0.0, 1.0, 201)
    arms = [("one", time[:, None] * [1.0, 0.5]), ("other", time[:, None] * [0.8, 0.7])]
    figure = two_arms("arms", fh.load_robot("planar-two-link"), time, arms, "Two arms.", "Arms")
    assert figure is not None
    path = tmp_path / "film.html"
    path.write_text(replace(sample_page(), lead=(figure,)).html(), encoding="utf-8")
    places = """() => [[".film .series-1", "points"], ["[id$='-pose-one-3-0'] path", "d"]].map(
      ([where, what]) => document.querySelector(where).getAttribute(what).match(/-?[\\d.]+/g).map(Number))"""
    with opened(browser, path) as page:
        assert page.inner_text("#figure-arms .player button") == "Play"
        page.evaluate("""() => { const slider = document.querySelector(".player input");
            slider.value = slider.max; slider.dispatchEvent(new Event("input")); }""")
        played, drawn = page.evaluate(places)
        assert played == pytest.approx(drawn, abs=0.2)
        page.click("#figure-arms .player button")
        page.wait_for_function("document.querySelector('.player button').textContent === 'Pause'")
        page.wait_for_function("document.querySelector('.player button').textContent === 'Play'")
        assert page.evaluate(places)[0] == played
        page.emulate_media(media="print")
        assert not page.locator("#figure-arms .player").is_visible()


def test_a_film_ends_where_the_arm_rests_and_is_close_where_it_moves() -> None:
    time = np.linspace(0.0, 20.0, 2001)
    at = instants_of(time, np.minimum(time, 1.0)[:, None])
    assert 0.95 < time[at[-1]] <= 1.0
    assert len(at) > 50
    assert list(instants_of(time, np.zeros((2001, 1)))) == [0]
