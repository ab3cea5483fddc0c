"""The pages of the site as `make docs` built it, in Chromium: accessibility, letters, width, light and dark.

With ``FLEXHINF_SCREENSHOTS=folder`` the pictures are kept there.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from tests.browser import WINDOWS, keep, opened, serious

pytestmark = pytest.mark.ci("a browser, and the site that was built before")

#: A page of each kind.
PAGES = {
    "first": "index.html",
    "guide": "robots.html",
    "gallery": "gallery/index.html",
    "program": "gallery/arms/pd_against_hinf.html",
    "notebook": "start/paper_arm.html",
    "theory": "theory/game.html",
    "function": "reference/functions/design.html",
    "study": "degrees.html",
    "search": "search.html?q=damping",
    "questions": "faq.html",
}

#: The smallest letters of a page, px.
LEGIBLE = 11.0

#: Texts that are seen, in letters of which size, px; those of drawings and formulas as well.
LETTERS = """() => {
  const found = [];
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const text = walk.currentNode.textContent.trim(), holder = walk.currentNode.parentElement;
    if (!text || holder.closest("script, style") || !holder.checkVisibility({visibilityProperty: true})) continue;
    const box = holder.getBoundingClientRect();
    if (box.width < 2 || box.height < 2) continue;  // for readers of screens
    const drawn = holder.ownerSVGElement ? holder.getScreenCTM() : null;
    const size = parseFloat(getComputedStyle(holder).fontSize) * (drawn ? Math.hypot(drawn.a, drawn.b) : 1);
    found.push([Math.round(size * 10) / 10, text.slice(0, 40)]);
  }
  return found;
}"""

#: Pictures of the text: the width that each has, and the one that its letters need, px.
PICTURES = """() => [...document.querySelectorAll(".picture > *")].map(
  (each) => [each.getBoundingClientRect().width, parseFloat(each.style.minWidth)])"""


class Quiet(SimpleHTTPRequestHandler):
    """Files of a folder, without a line for each request."""

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""


@pytest.fixture(scope="module")
def address(repository: Path) -> Iterator[str]:
    """Where the site is served."""
    folder = repository / "build" / "docs" / "html"
    if not (folder / "searchindex.js").exists():
        pytest.skip("missing: build/docs/html, which `make docs` makes")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.mark.parametrize("kind", PAGES)
def test_a_page_of_the_site_is_accessible_and_legible(browser: Any, address: str, kind: str) -> None:
    """Problems are looked for in the narrowest window, light, and in the widest, dark."""
    with opened(browser, f"{address}/{PAGES[kind]}", min(WINDOWS), reduced_motion="reduce") as page:
        if kind == "search":
            page.wait_for_selector("ul.search li a")
        for (width, height), scheme in zip(WINDOWS.items(), ("light", "light", "dark"), strict=True):
            page.set_viewport_size({"width": width, "height": height})
            for colours in ("light", "dark"):
                page.emulate_media(color_scheme=colours)
                keep(page, f"site-{kind}-{width}-{colours}")
            page.emulate_media(color_scheme=scheme)
            if width != 1280:
                assert serious(page, preload=False) == []
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            assert [each for each in page.evaluate(LETTERS) if each[0] < LEGIBLE] == []
            assert all(wide >= needed - 1 for wide, needed in page.evaluate(PICTURES))
