"""Each guide begins with a picture and the command that makes it, and ends with what to do when it is not met."""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

#: Its cells draw, and its first one shows the robot.
NOTEBOOK = "start/paper_arm"

#: How far down a picture and the block that makes it may begin, characters without the text of the picture.
FIRST = 1500


@pytest.fixture(scope="module")
def guides(website: Callable[[str], Any]) -> list[str]:
    found: list[str] = website("words").listed("guides/index")
    return found


@pytest.fixture(scope="module")
def pictures(repository: Path) -> dict[str, Any]:
    return runpy.run_path(str(repository / "docs" / "pictures.py"))


def test_a_guide_begins_with_a_picture_and_the_block_that_makes_it(
    guides: list[str], repository: Path, pictures: dict[str, Any]
) -> None:
    assert set(pictures["PICTURES"]) == set(guides) - {NOTEBOOK, "design"}
    for page in guides:
        text = (repository / "docs" / f"{page}.md").read_text(encoding="utf-8")
        if page == NOTEBOOK:
            assert re.search(r"arm = fh.paper_arm\(\)\narm\n```", text)
            continue
        picture = re.search(r"!\[[^]]{20,}\]\(([\w./]+\.(?:svg|png))\)", text)
        assert picture, page
        assert (repository / "docs" / page).parent.joinpath(picture[1]).resolve().is_file(), picture[1]
        block = re.search(r"^```", text, re.MULTILINE)
        assert block, page
        assert max(picture.start(), block.start()) < FIRST, page


def test_pictures_show_what_their_pages_say(repository: Path, pictures: dict[str, Any]) -> None:
    for page, picture in pictures["PICTURES"].items():
        language, block = pictures["begins"](page)
        assert language in (("text",) if page == "studio" else ("sh", "python")), page
        assert "flexhinf" in block, page
        assert f"![{picture.says}](" in (repository / "docs" / f"{page}.md").read_text(encoding="utf-8"), page


def test_a_guide_ends_with_what_to_do_when_it_is_not_met(guides: list[str], repository: Path) -> None:
    for page in guides:
        text = (repository / "docs" / f"{page}.md").read_text(encoding="utf-8")
        *_, last = re.findall(r"^## (.+)$", text, re.MULTILINE)
        assert last.startswith("When "), page


def test_a_drawing_of_a_page_stands_alone(pictures: dict[str, Any]) -> None:
    inside = '<g style="stroke: var(--ink); font-size: calc(9px*var(--text))"/>'
    alone = pictures["alone"](f'<svg viewBox="0 0 1 1" aria-labelledby="a">{inside}</svg>')
    assert "var(" not in alone
    assert "stroke: #1f2328; font-size: 9px" in alone
    assert alone.startswith('<svg xmlns="http://www.w3.org/2000/svg"')
