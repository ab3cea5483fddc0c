"""docs/notation.md names things that the code has."""

from __future__ import annotations

import re
from pathlib import Path


def test_every_name_of_the_page_is_in_the_code(repository: Path) -> None:
    code = "\n".join(file.read_text(encoding="utf-8") for file in (repository / "src").rglob("*.py"))
    words = set(re.findall(r"\w+", code))
    rows = (repository / "docs" / "notation.md").read_text(encoding="utf-8").splitlines()
    cells = [re.split(r"(?<!\\)\|", row) for row in rows if row.startswith("|")]
    names = {
        name
        for row in cells
        for text in re.findall(r"`([^`]+)`", row[2])
        for name in re.findall(r"[A-Za-z_]\w+", text)
    }
    assert len(names) > 60
    assert names - words == set()
