"""Build what is released, where nothing contradicts the version in pyproject.toml.

    python .ci/release.py FOLDER    writes wheel and source distribution into a folder, which is made anew

`make release` calls it, and installs both in an empty environment. Exit code 1, and nothing is built, where the tag of
the commit, CITATION.cff or CHANGELOG.md has another version, or where a file is not committed.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

from flit_core import buildapi

ROOT = Path(__file__).resolve().parents[1]

#: What a release has in CHANGELOG.md, its heading included.
MOST_LINES = 40


def version_of(root: Path) -> str:
    """The version, which pyproject.toml alone states."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return str(project["version"])


def contradictions(root: Path) -> list[str]:
    """What forbids a release, each with what to do."""
    version = version_of(root)
    found = []
    cited = re.search(r"^version: (\S+)$", (root / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    if cited is None or cited[1] != version:
        found.append(
            f"CITATION.cff has version {cited[1] if cited else 'none'}, pyproject.toml {version}. "
            f"Try: version: {version} in CITATION.cff"
        )
    log = re.search(r"^## \[?([^\]\s]+)", (root / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    if log is None or log[1] != version:
        found.append(
            f"CHANGELOG.md begins with {log[1] if log else 'no version'}, pyproject.toml has {version}. "
            f"Try: ## [{version}] with the date as its topmost heading"
        )
    told = _told(root)
    if told > MOST_LINES:
        found.append(
            f"CHANGELOG.md tells {version} in {told} lines, at most {MOST_LINES}. Try: what a user notices alone"
        )
    tags = _git(root, "tag", "--points-at", "HEAD").split()
    found += [
        f"The tag of this commit is {tag}, pyproject.toml has {version}. Try: git tag v{version}"
        for tag in tags
        if tag != f"v{version}"
    ]
    changed = [line[3:] for line in _git(root, "status", "--porcelain").splitlines()]
    if changed:
        more = ", …" * (len(changed) > 3)
        found.append(
            f"Files are not committed: {', '.join(changed[:3])}{more}. Try: git commit, or git stash"
        )
    return found


def _told(root: Path) -> int:
    """Lines of the topmost version in CHANGELOG.md."""
    parts = re.split(r"^(?=## )", (root / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    return len(parts[1].strip().splitlines()) if len(parts) > 1 else 0


def _git(root: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=True)
    return done.stdout


def build(root: Path, folder: Path) -> list[Path]:
    """Wheel and source distribution, alone in their folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    here = Path.cwd()
    os.chdir(root)  # the build system's interface has the project in the current folder
    try:
        return [folder / make(str(folder)) for make in (buildapi.build_wheel, buildapi.build_sdist)]
    finally:
        os.chdir(here)


def main(arguments: list[str]) -> int:
    """Say what forbids it, or build."""
    if found := contradictions(ROOT):
        print("\n".join(f"Not released: {each}" for each in found), file=sys.stderr)
        return 1
    for file in build(ROOT, Path(arguments[0] if arguments else "dist").resolve()):
        print(file)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
