"""What is published: the source distribution is whole, and the package's page needs nothing beside it."""

from __future__ import annotations

import re
import tarfile
import tomllib
from functools import partial
from gzip import GzipFile
from pathlib import Path

import pytest
from flit_core import sdist


@pytest.mark.ci("builds the source distribution")
def test_the_source_distribution_has_docs_and_tests(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sdist, "GzipFile", partial(GzipFile, compresslevel=1))
    archive = sdist.SdistBuilder.from_ini_path(repository / "pyproject.toml").build(tmp_path)
    with tarfile.open(archive) as tar:
        names = {name.partition("/")[2] for name in tar.getnames()}
    for folder in ("docs", "tests", "examples", "benchmarks", "fuzz", "src"):
        files = [f for f in (repository / folder).rglob("*") if f.is_file() and "__pycache__" not in f.parts]
        missing = {file.relative_to(repository).as_posix() for file in files} - names
        assert not missing, folder
    assert {"README.md", "LICENSE", "Makefile", "requirements-dev.lock", ".ci/run"} <= names
    assert not any("__pycache__" in name for name in names)


def test_the_page_of_the_package_has_no_link_into_the_repository(repository: Path) -> None:
    page = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]["readme"]
    links = re.findall(r"\]\(([^)]+)\)", (repository / page).read_text(encoding="utf-8"))
    assert [link for link in links if not link.startswith("https://")] == []


@pytest.mark.parametrize("page", ["README.md", "docs/package.md"])
def test_every_extra_is_named(page: str, repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (repository / page).read_text(encoding="utf-8")
    assert [
        name
        for name in project["optional-dependencies"]
        if name not in ("test", "docs") and f"`{name}`" not in text
    ] == []


@pytest.mark.parametrize("page", ["README.md", "docs"])
def test_links_between_pages_lead_somewhere(page: str, repository: Path) -> None:
    pages = [repository / page] if page.endswith(".md") else (repository / page).glob("*.md")
    for file in pages:
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", file.read_text(encoding="utf-8")):
            assert link.startswith("http") or (file.parent / link).exists(), (file.name, link)
