"""docs/decisions.md says what still binds: a page that grows is a history, and nobody reads it."""

from __future__ import annotations

from pathlib import Path

LONGEST = 5_000
"""Words."""


def test_the_page_is_short(repository: Path) -> None:
    text = (repository / "docs" / "decisions.md").read_text(encoding="utf-8")
    assert 1_000 < len(text.split()) <= LONGEST
