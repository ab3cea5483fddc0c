"""Cells of the tables of docs/limits.md."""

from __future__ import annotations

from typing import Any

__all__ = ["MISSING", "cells", "digits", "head", "limit_text", "milli", "short_text"]

MISSING = "not measured"


def limit_text(row: dict[str, Any]) -> str:
    """How far beyond, how fast, when back."""
    if row["lost"]:
        return "lost"
    back = "never" if row["back"] is None else f"{row['back']:.2f} s"
    return f"{short_text(row)}, {back}"


def short_text(row: dict[str, Any]) -> str:
    """How far beyond and how fast."""
    return "lost" if row["lost"] else f"{milli(row['beyond'])} mrad, {row['speed']:.1f}"


def milli(value: float) -> str:
    """In thousandths."""
    return digits(1e3 * value)


def digits(value: float) -> str:
    """Two digits, none after the point from ten on; nothing below a hundredth."""
    return "0" if value < 5e-3 else f"{value:.2g}" if value < 9.95 else f"{value:.0f}"


def head(titles: tuple[str, ...]) -> list[str]:
    """The first two lines of a table."""
    return [cells(list(titles)), "|---" * len(titles) + "|"]


def cells(texts: list[str]) -> str:
    """A line of a table."""
    return f"| {' | '.join(texts)} |"
