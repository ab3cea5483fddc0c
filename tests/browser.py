"""Chromium for tests of pages, driven by Playwright; skips, with the reason, where one of them is missing."""

from __future__ import annotations

import os
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

#: The folder in which screenshots are kept; without it they go where pytest keeps temporary files.
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
def opened(browser: Any, file: Path, width: int = 1280, **options: Any) -> Iterator[Any]:
    """A page of a file in a window of this width; it fails if a script of the page fails or something is fetched."""
    options = {
        "bypass_csp": True,
        **options,
    }  # Playwright evaluates texts, which the policy of a page forbids
    context = browser.new_context(viewport={"width": width, "height": WINDOWS[width]}, **options)
    page, errors, fetched = context.new_page(), [], []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("request", lambda request: fetched.append(request.url))
    try:
        page.goto(file.resolve().as_uri())
        yield page
        assert errors == []
        assert [url for url in fetched if not url.startswith("file:")] == []
    finally:
        context.close()


def kept(folder: Path, name: str) -> Path:
    """Where a screenshot is written: in `SCREENSHOTS`, or in a temporary folder."""
    place = Path(os.environ.get(SCREENSHOTS) or folder)
    place.mkdir(parents=True, exist_ok=True)
    return place / f"{name}.png"


def serious(page: Any) -> list[str]:
    """What axe-core finds serious or critical on a page, each with the first element that has it."""
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="missing: axe-playwright-python"
    )
    found = axe.Axe().run(page).response["violations"]
    return [
        f"{each['id']}: {each['nodes'][0]['html'][:200]}"
        for each in found
        if each["impact"] in ("serious", "critical")
    ]
