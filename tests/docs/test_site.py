"""The documentation site: what stands on which page. Building it is `make docs`, where warnings are errors."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import flexhinf as fh
from flexhinf.robot.kinematics import picture_axes


@pytest.fixture(scope="module")
def contents(website: Callable[[str], Any]) -> Any:
    return website("contents")


def test_every_public_name_is_on_one_page(contents: Any) -> None:
    listed = Counter(name for _, names in contents.NAMES.values() for name in names)
    assert set(listed) == set(fh.__all__)
    assert set(listed.values()) == {1}


def test_the_stub_has_the_names_of_the_reference(contents: Any, repository: Path) -> None:
    stub = (repository / "src" / "flexhinf" / "__init__.pyi").read_text(encoding="utf-8")
    names = set(re.findall(r"^\s+\w+ as (\w+),$", stub, re.MULTILINE))
    names |= set(re.findall(r"import (\w+) as \1$", stub, re.MULTILINE))
    names |= {name for line in re.findall(r"^from .* import (.* as .*,.*)$", stub, re.MULTILINE)
              for name in re.findall(r"(\w+) as \1", line)}  # fmt: skip
    assert names == {name for _, listed in contents.NAMES.values() for name in listed}


def test_every_example_of_a_group_exists_and_is_in_no_other(contents: Any, repository: Path) -> None:
    listed = Counter(stem for _, _, stems in contents.EXAMPLES.values() for stem in stems)
    assert set(listed) <= {file.stem for file in (repository / "examples").glob("*.py")}
    assert set(listed.values()) <= {1}


def test_links_between_pages_lead_to_files(repository: Path) -> None:
    """The build checks anchors too; this one needs no Sphinx."""
    docs, missing = repository / "docs", []
    for page in docs.rglob("*.md"):
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\(([^)#\s]+\.md)(?:#[^)]*)?\)", text):
            base = docs if target.startswith("/") else page.parent
            if "://" not in target and not (base / target.lstrip("/")).exists():
                missing.append(f"{page.relative_to(docs)}: {target}")
    assert missing == []


def test_a_host_builds_what_make_builds(repository: Path) -> None:
    host = (repository / ".readthedocs.yaml").read_text(encoding="utf-8")
    for line in (
        "configuration: docs/conf.py",
        "fail_on_warning: true",
        "requirements: requirements-docs.lock",
    ):
        assert line in host
    make = (repository / "Makefile").read_text(encoding="utf-8")
    assert "-m sphinx -W" in make
    assert "make docs" in (repository / ".ci" / "run").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def site(website: Callable[[str], Any]) -> Any:
    return website("words")


def test_a_user_reads_at_most_so_many_words_and_pages(site: Any) -> None:
    pages = site.users_pages()
    assert sum(pages.values()) <= site.MOST_WORDS
    assert len(pages) <= site.MOST_PAGES
    assert not {"decisions", "mutants", "options", "theorem"} & pages.keys()  # studies, and what is generated


def test_what_counts_as_a_word(site: Any) -> None:
    assert site.words("---\na: b\n---\n# One two\n<!-- no word -->\n```sh\nno word\n```\nthree\n") == 4


def test_every_page_stands_in_one_contents_list(site: Any, repository: Path) -> None:
    docs = repository / "docs"
    named = Counter(site.menu())
    assert set(named) == {page.relative_to(docs).as_posix()[:-3] for page in docs.rglob("*.md")} - {"package"}
    assert set(named.values()) == {1}


def test_the_menu_has_the_reading_order(site: Any) -> None:
    order = [
        "start/index",
        "guides/index",
        "choosing",
        "gallery/index",
        "live",
        "theory/index",
        "reference/index",
    ]
    assert site.listed("index") == [*order, "compared/index", "faq", "benchmarks/index"]
    assert "ros2" in site.listed("guides/index")


def test_a_title_is_no_name_of_a_file(site: Any, repository: Path) -> None:
    """Nor is the text of a link on a page of the user's."""
    for name in site.users_pages():
        text = (repository / "docs" / f"{name}.md").read_text(encoding="utf-8")
        text = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
        title = re.search(r"^# (.+)$", text, re.MULTILINE)
        assert title, name
        assert not re.search(r"\.md|_", title[1]), name
        assert re.findall(r"\[`?[\w/]+\.md`?\]\((?!\.\./)", text) == [], name


def test_a_picture_keeps_the_width_that_its_letters_need(
    website: Callable[[str], Any], tmp_path: Path
) -> None:
    """A drawing 400 wide with letters of 8 needs 550 px, and keys reach what scrolls on a telephone."""
    drawings = website("drawings")
    small, file = (
        '<svg width="400pt" viewBox="0 0 400 300"><text style="font: 8px x"/></svg>',
        tmp_path / "a.svg",
    )
    file.write_text(small)
    frame = ' class="picture" tabindex="0">'
    width = ' style="min-width: 550px"'
    for body, seen in {
        '<p><img alt="x" src="../_images/a.svg" /></p>': f'<p{frame}<img alt="x" src="../_images/a.svg"{width} /></p>',
        small: f"<div{frame}{small.replace(chr(62), width + chr(62), 1)}</div>",
        "<p>no picture</p>": "<p>no picture</p>",
    }.items():
        assert drawings.legible(body, {"a.svg": file}) == seen
    wide = drawings.legible(small.replace("8px", "20px"), {})
    assert "tabindex" not in wide
    assert "min-width: 220px" in wide


def test_the_first_page_has_an_arm_of_two_joints_and_one_of_six_in_space(
    website: Callable[[str], Any], repository: Path
) -> None:
    live, folder = website("live"), repository / "docs" / "website"
    names = list(live.ARMS)[:2]
    text = live.text(list(live.ARMS), "index")
    assert re.findall(r'<iframe class="live" src="live/([\w-]+)\.html"', text) == names
    files = [live.ARMS[name].robot for name in names]
    robots = [fh.load_robot(folder / file if file.endswith(".toml") else file) for file in files]
    assert [len(robot.joint_names) for robot in robots] == [2, 6]
    seen = picture_axes(robots[1])
    assert seen is None or not seen.planar
