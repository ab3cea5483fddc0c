"""Chromium for tests of pages, driven by Playwright; skips, with the reason, where one of them is missing."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

#: Widths and heights of a window, px: a telephone, a laptop, a desktop.
WINDOWS = {390: 844, 1280: 800, 1920: 1080}

#: Names of the program.
PROGRAMS = ("chromium", "chromium-browser", "google-chrome")

#: The folder in which screenshots are kept; without it none is taken.
SCREENSHOTS = "FLEXHINF_SCREENSHOTS"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser of Playwright, without a window."""
    api = pytest.importorskip("playwright.sync_api", reason="missing: playwright")
    path = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if path is None:
        pytest.skip("missing: chromium")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield started
        started.close()


@contextmanager
def opened(browser: Any, file: Path | str, width: int = 1280, **options: Any) -> Iterator[Any]:
    """A page in a window of this width; it fails if a script of the page fails or fetches something from elsewhere.

    The page is a file, or has an address of a server.
    """
    address = file if isinstance(file, str) else file.resolve().as_uri()
    home = "file:" if isinstance(file, Path) else "/".join(file.split("/")[:3])
    options = {
        "bypass_csp": True,
        **options,
    }  # Playwright evaluates texts, which the policy of a page forbids
    context = browser.new_context(viewport={"width": width, "height": WINDOWS[width]}, **options)
    page, errors, fetched = context.new_page(), [], []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on(
        "console",
        lambda line: errors.append(f"{line.text} {line.location}") if line.type == "error" else None,
    )
    page.on("request", lambda request: fetched.append(request.url))
    try:
        page.goto(address)
        yield page
        assert errors == [], errors
        assert [url for url in fetched if not url.startswith(home)] == []
    finally:
        context.close()


def keep(page: Any, name: str, **options: Any) -> None:
    """Take a screenshot for somebody who looks at it; `options` are Playwright's."""
    if place := os.environ.get(SCREENSHOTS):
        page.screenshot(path=Path(place) / f"{name}.png", **options)


def sheets(page: Any) -> int:
    """How many sheets of paper a page takes, of Chromium's own size."""
    return len(re.findall(rb"/Type\s*/Page\b", page.pdf(prefer_css_page_size=True)))


def serious(page: Any, **options: Any) -> list[str]:
    """What axe-core finds serious or critical on a page, with the first element of each; `options` are axe's."""
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="missing: axe-playwright-python"
    )
    found = axe.Axe().run(page, options=options).response["violations"]
    return [
        f"{each['id']}: {each['nodes'][0]['html'][:200]}"
        for each in found
        if each["impact"] in ("serious", "critical")
    ]
