"""The terminal says the same within 80 columns."""

from __future__ import annotations

import io
from collections.abc import Callable

import pytest
from rich.console import Console

from flexhinf.design import Design
from flexhinf.design.terminal import design_tables

Make = Callable[[str], Design]


def printed(design: Design) -> str:
    """All tables, as wide as they come."""
    stream = io.StringIO()
    for table in design_tables(design):
        Console(file=stream, width=80).print(table)
    return stream.getvalue()


@pytest.mark.parametrize("name", ["met", "rings", "robust", "cart", "true state"])
def test_eighty_columns_are_enough(page_design: Make, name: str) -> None:
    text = printed(page_design(name))
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "…" not in text


def test_the_specification_comes_first(page_design: Make) -> None:
    design = page_design("met")
    text = printed(design)
    order = [
        "what was asked for", "What it costs", "Search for the weights", "The step on 16 robots", "what oscillates",
        "The sampled loop", "Corners of the tolerances", "spend of the region", "Where each solution",
    ]  # fmt: skip
    places = [text.index(words) for words in order]
    assert places == sorted(places)
    assert "NOT MET" not in text
    assert "NOT MET" in printed(page_design("rings"))
    assert f"{design.guarantee.attained.gain:.4g} found" in text


def test_numbers_are_those_of_the_page(page_design: Make) -> None:
    design = page_design("robust")
    r = design.game.robustness
    assert r is not None
    text = printed(design)
    assert f"{r.gamma_star:.4g}" in text
    assert f"{r.channels} channels, 100 % of the tolerances covered" in text
