"""What is published: the source distribution is whole, and the package's page needs nothing beside it."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from functools import partial
from gzip import GzipFile
from pathlib import Path
from typing import Any

import pytest
from flit_core import sdist

import flexhinf as fh


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


# Releases -------------------------------------------------------------------------------------------
@pytest.fixture
def release(repository: Path) -> dict[str, Any]:
    """The program of `make release`."""
    return runpy.run_path(str(repository / ".ci" / "release.py"))


@pytest.fixture
def ready(tmp_path: Path) -> Path:
    """A repository whose commit can be released as 1.2.3."""
    (tmp_path / "pyproject.toml").write_text('[project]\nversion = "1.2.3"\n')
    (tmp_path / "CITATION.cff").write_text("title: x\nversion: 1.2.3\n")
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## [1.2.3] - 2026-11-27\n\n## [1.2.2]\n")
    git(tmp_path, "init", "-q")
    commit(tmp_path)
    return tmp_path


def git(folder: Path, *words: str) -> None:
    name = ("-c", "user.name=x", "-c", "user.email=x@example.org", "-c", "commit.gpgsign=false")
    subprocess.run(["git", "-C", str(folder), *name, *words], check=True, capture_output=True)


def commit(folder: Path) -> None:
    git(folder, "add", "-A")
    git(folder, "commit", "-q", "-m", "x")


def test_the_version_is_stated_once(repository: Path, release: dict[str, Any]) -> None:
    version = release["version_of"](repository)
    assert fh.__version__ == version
    assert f"\nversion: {version}\n" in (repository / "CITATION.cff").read_text(encoding="utf-8")
    stated = [
        file.name
        for file in (repository / "src" / "flexhinf").glob("__init__.py*")
        if version in file.read_text(encoding="utf-8")
    ]
    assert stated == []


def test_the_classifiers_name_the_python_of_ci_and_no_other(repository: Path) -> None:
    """The oldest one, for which the locks are made. Newer ones may work; nothing tells."""
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    language = "Programming Language :: Python :: "
    named = [each.removeprefix(language) for each in project["classifiers"] if each.startswith(language)]
    assert [f">={each}" for each in named] == [project["requires-python"]]
    if os.environ.get("CI"):
        assert named == [f"{sys.version_info.major}.{sys.version_info.minor}"]


@pytest.mark.costs("starts git for each case")
@pytest.mark.parametrize(
    ("tag", "file", "old", "new", "said"),
    [
        ("v1.2.3", "", "", "", None),
        ("v1.2.4", "", "", "", "tag"),
        ("", "CITATION.cff", "1.2.3", "1.2.2", "CITATION.cff"),
        ("", "CHANGELOG.md", "[1.2.3]", "[Unreleased]", "CHANGELOG.md"),
        ("", "CHANGELOG.md", "2026-11-27\n", "2026-11-27\n" + "- x\n" * 40, "CHANGELOG.md tells"),
    ],
)
def test_a_release_that_differs_is_refused(
    tag: str, file: str, old: str, new: str, said: str | None, ready: Path, release: dict[str, Any]
) -> None:
    if file:
        (ready / file).write_text((ready / file).read_text().replace(old, new))
        commit(ready)
    if tag:
        git(ready, "tag", tag)
    found = release["contradictions"](ready)
    assert len(found) == (said is not None)
    assert all(said in each and "Try: " in each for each in found)


@pytest.mark.costs("starts git")
def test_what_is_not_committed_is_not_released(ready: Path, release: dict[str, Any]) -> None:
    (ready / "new.txt").write_text("x")
    (found,) = release["contradictions"](ready)
    assert "new.txt" in found


@pytest.mark.ci("builds the wheel and the source distribution")
def test_what_is_built_has_the_version(
    repository: Path, release: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sdist, "GzipFile", partial(GzipFile, compresslevel=1))
    version = release["version_of"](repository)
    wheel, archive = release["build"](repository, tmp_path / "dist")
    assert [wheel.name, archive.name] == [
        f"flexhinf-{version}-py3-none-any.whl",
        f"flexhinf-{version}.tar.gz",
    ]
    with zipfile.ZipFile(wheel) as made:
        metadata = made.read(f"flexhinf-{version}.dist-info/METADATA").decode()
        assert f"\nVersion: {version}\n" in metadata
        assert {"flexhinf/__init__.pyi", "flexhinf/py.typed"} <= set(made.namelist())
