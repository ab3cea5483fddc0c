"""The documentation site: what stands on which page. Building it is `make docs`, where warnings are errors."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import flexhinf as fh


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


def test_no_contents_list_names_a_page_twice(repository: Path) -> None:
    for page in (repository / "docs").rglob("*.md"):
        lists = re.findall(
            r"^```\{toctree\}\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
        )
        lines = [
            line for entries in lists for line in entries.splitlines() if line and not line.startswith(":")
        ]
        named = Counter(line.rpartition("<")[2].rstrip("> ") for line in lines)
        assert max(named.values(), default=1) == 1, page.name
