"""Doctests: a room whose functions are called like their files is imported whole, before pytest imports its files."""

from __future__ import annotations

from pathlib import Path

import flexhinf.identification as _  # noqa: F401


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Files without an example are not imported."""
    if collection_path.suffix != ".py":
        return None
    return True if ">>>" not in collection_path.read_text(encoding="utf-8") else None
