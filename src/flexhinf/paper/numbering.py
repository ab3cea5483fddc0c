"""Tables and figures of the evidence get numbers, and claims point at the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from flexhinf.paper.claims.judged import Judged
from flexhinf.report import Figure, Table

__all__ = ["numbered"]


def numbered(judged: Sequence[Judged], first_figure: int) -> list[Judged]:
    """The same with Table 1, 2, … and Figure `first_figure`, … in the order of the page."""
    names: dict[str, str] = {}
    tables, figures = 0, first_figure - 1
    blocks: list[tuple[Any, ...]] = []
    for one in judged:
        renamed: list[Any] = []
        for block in one.blocks:
            if isinstance(block, Table) and block.id:
                tables += 1
                names[block.id] = f"table-{tables}"
                caption = f"Table {tables}. {block.caption}"
                renamed.append(replace(block, id=names[block.id], caption=caption))
            elif isinstance(block, Figure):
                figures += 1
                names[block.id] = f"figure-{figures}"
                renamed.append(replace(block, id=names[block.id], label=f"Figure {figures}"))
            else:
                renamed.append(block)
        blocks.append(tuple(renamed))
    return [
        replace(
            one,
            blocks=own,
            claim=replace(one.claim, figures=tuple(names.get(f, f) for f in one.claim.figures)),
        )
        for one, own in zip(judged, blocks, strict=True)
    ]
