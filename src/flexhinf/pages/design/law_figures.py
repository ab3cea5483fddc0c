"""The figures of every law: label, unit and which way is better, and the table with one column for each law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flexhinf.design.result import ComparedLaw, Comparison
from flexhinf.pages.design.requirements import limit_text
from flexhinf.pages.drawing import pose_text, units_of
from flexhinf.report import number
from flexhinf.report.blocks import escape, prose

#: Two figures are equally good within this relative difference, or the smallest difference that counts.
SHARED = 0.005

Kind = Literal["input", "small input", "length", "%", "s", "ms", "rad/s", ""]


@dataclass(frozen=True)
class LawFigure:
    """A figure of a law.

    Attributes
    ----------
    key : str
        Of `LawEvaluation.metrics`.
    group : str
        What was run; see `_title`.
    unit : str
        "input": V or N·m. Shown in thousandths: "small input", "length" (of rad or m), "ms" (of s).
    better : int
        −1: less is better; 1: more is better; 0: neither.
    least : float
        The smallest difference that counts, in the unit of the value.
    brief : bool
        Whether a terminal shows it too.
    """

    key: str
    group: str
    label: str
    unit: Kind
    better: int = -1
    least: float = 0.0
    brief: bool = True


STEP, LOAD, MOVE, SAMPLES, LINEAR, COST = "step", "load", "move", "samples", "linear", "cost"

#: In the order of the table.
FIGURES = (
    LawFigure("step_peak_input", STEP, "peak input", "input"),
    LawFigure("step_overshoot_percent", STEP, "overshoot", "%", least=0.5),
    LawFigure("step_settling_s", STEP, "settling time", "s", least=0.01),
    LawFigure("step_remaining", STEP, "remaining error", "length", least=1e-4),
    LawFigure("load_deviation", LOAD, "largest deviation", "length"),
    LawFigure("load_recovery_s", LOAD, "recovered after", "s", least=0.01),
    LawFigure("load_remaining", LOAD, "remaining deviation", "length", least=1e-4),
    LawFigure("move_error", MOVE, "largest error", "length", least=1e-4),
    LawFigure("move_remaining", MOVE, "remaining error", "length", least=1e-4, brief=False),
    LawFigure("move_peak_input", MOVE, "peak input", "input"),
    LawFigure("drawn_unsettled", SAMPLES, "steps not settled", "", least=0.5),
    LawFigure("drawn_overshoot_percent", SAMPLES, "median overshoot", "%", least=0.5, brief=False),
    LawFigure("drawn_worst_overshoot_percent", SAMPLES, "worst overshoot", "%", least=0.5),
    LawFigure("drawn_settling_s", SAMPLES, "median settling time", "s", least=0.01, brief=False),
    LawFigure("drawn_worst_settling_s", SAMPLES, "worst settling time", "s", least=0.01),
    LawFigure("drawn_worst_peak_input", SAMPLES, "worst peak input", "input", brief=False),
    LawFigure("drawn_move_error", SAMPLES, "median move error", "length", least=1e-4, brief=False),
    LawFigure("drawn_worst_move_error", SAMPLES, "worst move error", "length", least=1e-4),
    LawFigure("unstable_corners", LINEAR, "unstable corners", "", least=0.5),
    LawFigure("peak_sensitivity", LINEAR, "peak sensitivity", "", least=0.01),
    LawFigure("gain_margin", LINEAR, "gain margin, ×", "", 1, 0.01),
    LawFigure("delay_margin_s", LINEAR, "delay margin", "ms", 1),
    LawFigure("damping", LINEAR, "smallest damping ratio", "", 1, 0.0005),
    LawFigure("input_noise", LINEAR, "input noise, rms", "small input"),
    LawFigure("bandwidth_rad_s", LINEAR, "bandwidth", "rad/s", 0, brief=False),
    LawFigure("operations", COST, "operations per sample", ""),
)

GROUPS = (STEP, LOAD, MOVE, SAMPLES, LINEAR, COST)

#: Titles where there is little room.
SHORT = {
    STEP: "step as deployed", LOAD: "torque on the links", MOVE: "planned move", SAMPLES: "sampled robots",
    LINEAR: "running loop, linearised", COST: "cost",
}  # fmt: skip


def _title(group: str, comparison: Comparison) -> str:
    """What was run for a group of figures."""
    own, units = comparison.own.evaluation, comparison.units()
    assert own is not None
    runs, setup = own.scenario, own.setup
    assert runs is not None
    loads = ", ".join(number(float(value), 3) for value in runs.load)
    slides, degrees = setup.robot.links.slides, setup.specification.in_degrees
    way = f"{pose_text(setup.start, slides, degrees)} → {pose_text(setup.goal, slides, degrees)}"
    moved = "the same way" if setup.specification.move is None else "the stated waypoints"
    return {
        STEP: f"Step {way} as the controller is deployed, the run of flexhinf design",
        LOAD: f"Torque of {loads} {units['torque']} on the links, at the goal",
        MOVE: f"Planned move of {number(float(runs.plan.duration), 3)} s over {moved}, with feedforward",
        SAMPLES: f"{len(runs.robots)} robots sampled within their tolerances: step and move",
        LINEAR: "Running loop, linearised at the goal, with its estimator and delay",
        COST: "Cost",
    }[group]


def unit_of(figure: LawFigure, comparison: Comparison) -> str:
    """The unit that is shown."""
    units = comparison.units()
    if figure.unit == "input":
        return units["input"]
    if figure.unit == "small input":
        return f"m{units['input']}"
    if figure.unit == "length":
        return units["error"]
    own = comparison.own.evaluation
    if figure.key == "drawn_unsettled" and own is not None and own.scenario is not None:
        return f"of {len(own.scenario.robots)}"
    if figure.key == "unstable_corners" and own is not None and own.corners is not None:
        return f"of {own.corners.count}"
    return figure.unit


def cell(figure: LawFigure, value: float | None, comparison: Comparison) -> str:
    """One figure without its unit."""
    if value is None:
        return "–"
    if np.isinf(value):
        return _without_number(figure, comparison)
    if figure.unit in ("length", "ms", "small input"):
        value *= 1e3
    if figure.unit == "%":
        return number(value, decimals=1)
    if figure.unit == "" and value == round(value):
        return number(int(value))
    if abs(value) >= 1e3:
        return number(round(value))
    if 0.0 < abs(value) < 1e-2:
        return number(value, 2)
    size = 0 if value == 0.0 else int(np.floor(np.log10(abs(value))))
    return number(value, decimals=min(max(2 - size, 0), 3))


def _without_number(figure: LawFigure, comparison: Comparison) -> str:
    own = comparison.own.evaluation
    if "settling" in figure.key and own is not None and own.scenario is not None:
        return f"> {own.scenario.step_duration:g}"
    if figure.key == "load_recovery_s":
        return "never"
    return "∞" if figure.better > 0 else "diverges"


def best_of(figure: LawFigure, values: Sequence[float | None]) -> tuple[bool, ...]:
    """Which values share the best; none where all are alike."""
    known = [value for value in values if value is not None]
    if not figure.better or len(known) < 2:
        return tuple(False for _ in values)
    top = min(known) if figure.better < 0 else max(known)
    width = max(SHARED * abs(top), figure.least) if np.isfinite(top) else 0.0
    found = tuple(value is not None and (value == top or abs(value - top) <= width) for value in values)
    return tuple(False for _ in values) if sum(found) == len(known) else found


@dataclass(frozen=True)
class TableLine:
    """A line of the table: a title, or a figure of every law with whether it is the best."""

    label: str
    unit: str = ""
    cells: tuple[str, ...] = ()
    best: tuple[bool, ...] = ()


def table_lines(comparison: Comparison, rows: Sequence[ComparedLaw], short: bool = False) -> list[TableLine]:
    """All lines for some of the laws; the best is that of all laws.

    Parameters
    ----------
    rows : sequence of ComparedLaw
        With an evaluation.
    short : bool
        For a terminal.
    """
    found = [TableLine("criterion" if short else "Criterion and limits")]
    found.append(_plain("criterion, design = 1", "", [_cost(row) for row in rows]))
    own = comparison.own.evaluation
    assert own is not None
    degrees = units_of(own).degrees
    judged = [{(line.what, line.where): line for line in row.requirements} for row in rows]
    for key, first in {key: line for row in judged for key, line in row.items()}.items():
        lines = [row.get(key) for row in judged]
        sampled = ", sampled" if "robots sampled" in first.where else ""
        label = f"{first.what} {limit_text(first.shown(degrees))}{sampled}"
        found.append(_plain(label, "", ["–" if line is None else line.judgement for line in lines]))
    for group in GROUPS:
        figures = [
            f for f in FIGURES if f.group == group and (f.brief or not short) and _known(f, comparison)
        ]
        if figures:
            found.append(TableLine(SHORT[group] if short else _title(group, comparison)))
        found += [_line(figure, comparison, rows) for figure in figures]
    return found


def _plain(label: str, unit: str, cells: Sequence[str]) -> TableLine:
    return TableLine(label, unit, tuple(cells), tuple(False for _ in cells))


def _cost(row: ComparedLaw) -> str:
    assert row.tuned is not None
    return number(row.tuned.cost, 3) if np.isfinite(row.tuned.cost) else "diverges"


def _known(figure: LawFigure, comparison: Comparison) -> bool:
    return any(row.metrics.get(figure.key) is not None for row in comparison.compared)


def _line(figure: LawFigure, comparison: Comparison, rows: Sequence[ComparedLaw]) -> TableLine:
    everyone = comparison.compared
    marks = best_of(figure, [row.metrics.get(figure.key) for row in everyone])
    tops = dict(zip((row.name for row in everyone), marks))
    return TableLine(
        figure.label,
        unit_of(figure, comparison),
        tuple(cell(figure, row.metrics.get(figure.key), comparison) for row in rows),
        tuple(tops[row.name] for row in rows),
    )


@dataclass(frozen=True, eq=False)
class FigureTable:
    """The table as a block of a page."""

    comparison: Comparison

    def html(self) -> str:
        """The table, in a frame that scrolls sideways on a narrow screen."""
        rows = self.comparison.compared
        head = "".join(f'<th scope="col" class="number">{escape(_whole(row.name))}</th>' for row in rows)
        body = "".join(_html(line, len(rows) + 1) for line in table_lines(self.comparison, rows))
        return (
            '<div class="table" id="figures-of-merit"><table><caption>Every law with the same commands, load, move, '
            "robots and seeds. “best”: best of its row, or as good as the best</caption>"
            f'<thead><tr><th scope="col"></th>{head}</tr></thead><tbody>{body}</tbody></table></div>'
        )

    def ids(self) -> tuple[str, ...]:
        """The table's anchor."""
        return ("figures-of-merit",)


def _html(line: TableLine, columns: int) -> str:
    if not line.cells:
        return f'<tr><th scope="rowgroup" colspan="{columns}"><strong>{escape(line.label)}</strong></th></tr>'
    unit = f' <span class="unit">{escape(line.unit)}</span>' if line.unit else ""
    cells = "".join(
        f'<td class="number">{_cell_html(text, top)}</td>' for text, top in zip(line.cells, line.best)
    )
    return f'<tr><th scope="row">{prose(line.label)}{unit}</th>{cells}</tr>'


def _cell_html(text: str, top: bool) -> str:
    return f'<strong>{escape(text)}</strong><br><span class="unit">best</span>' if top else escape(text)


def _whole(name: str) -> str:
    """With hyphens at which no line breaks."""
    return name.replace("-", "\u2011")
