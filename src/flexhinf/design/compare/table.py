"""The table of a comparison: one row per figure, one column per law, the best of each row marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flexhinf.design.compare.asked import asked_label, specification_met
from flexhinf.design.compare.merits import GROUPS, MERITS, Merit, best, judged
from flexhinf.design.compare.names import BANDWIDTH, PRICE
from flexhinf.design.compare.result import Comparison, Row
from flexhinf.design.compare.shown import SHORT, cell, group_title, knob, reached, unit_of
from flexhinf.report.text import escape

__all__ = ["Line", "MeritTable", "lines"]


@dataclass(frozen=True)
class Line:
    """A line of the table: a title of what follows, or a figure of every law.

    Attributes
    ----------
    label, unit : str
    cells : tuple of str
        One per law; none in a title.
    best : tuple of bool
    """

    label: str
    unit: str = ""
    cells: tuple[str, ...] = ()
    best: tuple[bool, ...] = ()


def lines(comparison: Comparison, rows: Sequence[Row], short: bool = False) -> list[Line]:
    """All lines for some of the laws; the best is that of all laws.

    Parameters
    ----------
    comparison : Comparison
    rows : sequence of Row
    short : bool
        Whether there is little room for titles.
    """
    mode, found = comparison.target.mode, [Line("tuning" if short else "Tuning")]

    def told(label: str, unit: str, cells: list[str]) -> None:
        found.append(Line(label, unit, tuple(cells), tuple(False for _ in rows)))

    told("price of the input, R2 ×", "", [knob(row, PRICE) for row in rows])
    told("bandwidth of gains", "rad/s", [knob(row, BANDWIDTH) for row in rows])
    if comparison.target.value is not None:
        what, unit = ("peak input", comparison.reference.unit) if mode == "peak" else ("bandwidth", "rad/s")
        told(f"{what} tuned to", unit, [reached(row) for row in rows])
    asked = [specification_met(comparison, row) for row in rows]
    found.append(Line("specification" if short else "What the specification asks of the step"))
    for mets in zip(*asked):
        told(asked_label(mets[0], short), "", ["met" if met.holds else "not met" for met in mets])
    for group in GROUPS:
        kept = [
            merit
            for merit in MERITS
            if merit.group == group and _known(merit, comparison) and (merit.brief or not short)
        ]
        if kept:
            found.append(Line(SHORT[group] if short else group_title(group, comparison)))
        found += [_line(merit, comparison, rows) for merit in kept]
    return found


def _known(merit: Merit, comparison: Comparison) -> bool:
    """Whether any law has this figure."""
    return any(row.figures[merit.key] is not None for row in comparison.compared)


def _line(merit: Merit, comparison: Comparison, rows: Sequence[Row]) -> Line:
    everyone = comparison.compared
    marks = best(merit, [row.figures[merit.key] for row in everyone])
    tops = dict(zip((row.name for row in everyone), marks)) if merit in judged(comparison.target.mode) else {}
    return Line(
        merit.label,
        unit_of(merit, comparison),
        tuple(cell(merit, row.figures[merit.key], comparison) for row in rows),
        tuple(tops.get(row.name, False) for row in rows),
    )


@dataclass(frozen=True, eq=False)
class MeritTable:
    """The table as a block of a page; names of laws do not break.

    Parameters
    ----------
    comparison : Comparison
    """

    comparison: Comparison

    def html(self) -> str:
        """The table, in a frame that scrolls sideways on a narrow screen."""
        rows = self.comparison.compared
        head = "".join(f'<th scope="col" class="number">{escape(_whole(row.name))}</th>' for row in rows)
        body = "".join(_html(line, len(rows) + 1) for line in lines(self.comparison, rows))
        return (
            '<div class="table" id="figures-of-merit"><table><caption>Every law on the same loop, plants, disturbances '
            f'and seeds; bold with ★: best of its row</caption><thead><tr><th scope="col"></th>{head}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>"
        )

    def ids(self) -> tuple[str, ...]:
        """The table's anchor."""
        return ("figures-of-merit",)


def _html(line: Line, columns: int) -> str:
    if not line.cells:
        return f'<tr><th scope="rowgroup" colspan="{columns}"><strong>{escape(line.label)}</strong></th></tr>'
    unit = f' <span class="unit">{escape(line.unit)}</span>' if line.unit else ""
    cells = "".join(
        f'<td class="number">{f"<strong>★ {escape(text)}</strong>" if top else escape(text)}</td>'
        for text, top in zip(line.cells, line.best)
    )
    return f'<tr><th scope="row">{escape(line.label)}{unit}</th>{cells}</tr>'


def _whole(name: str) -> str:
    """With hyphens at which no line breaks."""
    return name.replace("-", "\u2011")
