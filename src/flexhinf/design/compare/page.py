"""The report of a comparison: one page, and the same numbers as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flexhinf.design.compare.figure import comparison_figure
from flexhinf.design.compare.merits import MERITS, Merit, best
from flexhinf.design.compare.names import BANDWIDTH, PRICE, REFERENCE
from flexhinf.design.compare.numbers import numbers_of
from flexhinf.design.compare.result import Comparison, Row
from flexhinf.design.compare.settings import setting_groups
from flexhinf.design.compare.shown import cell, in_words, knob, reached, unit_of
from flexhinf.design.compare.table import MeritTable
from flexhinf.design.compare.words import against, bests, notes, opponent, same, verdict, versus
from flexhinf.design.page.words import law_name
from flexhinf.report import (
    Column,
    KeyNumber,
    Note,
    Page,
    Paragraph,
    Provenance,
    Section,
    Settings,
    Table,
    to_json,
)

__all__ = ["comparison_files", "comparison_page"]

#: Figures at the top of the page.
KEYS = (
    "step_overshoot_percent", "step_settling_s", "load_deviation", "drawn_worst_move_error", "unstable_corners",
    "input_noise",
)  # fmt: skip

#: The reference's name with hyphens at which no line breaks.
WHOLE = REFERENCE.replace("-", "\u2011")

#: Figures in which another law is told to be worse or better, each.
TOLD = 4

#: What a law needs to know of the state, in the order of the model.
SIGNALS = ("link_position", "link_velocity", "motor_position", "motor_velocity")


def comparison_files(
    comparison: Comparison, command: Sequence[str], warnings: Sequence[str] = ()
) -> dict[str, str]:
    """index.html and comparison.json."""
    return {
        "index.html": comparison_page(comparison, command, warnings).html(),
        "comparison.json": to_json(numbers_of(comparison)),
    }


def comparison_page(comparison: Comparison, command: Sequence[str], warnings: Sequence[str] = ()) -> Page:
    """Everything on one page."""
    reference = comparison.reference
    robot, s, chosen = reference.robot, reference.specification, reference.synthesis.chosen
    joints = f"{len(robot.joint_names)} elastic joint{'s' if len(robot.joint_names) > 1 else ''}"
    asked = (
        f"{robot.name}, {joints}, {robot.drive} driven. {len(comparison.compared)} laws in the same loop, on the same "
        f"plants, disturbances and seeds, {same(comparison)}. {REFERENCE}: preset {reference.synthesis.game.preset}, "
        f"a {law_name(chosen.degree)} law; estimator: {s.estimator}."
    )
    told = [Note(text[:1].upper() + text[1:]) for text in notes(comparison)]
    told += [Note(" ".join(text.split())) for text in warnings]
    sections = (
        Section("Figures of merit", (*told, MeritTable(comparison)), "merits"),
        Section("Step, load and move", (comparison_figure(comparison),), "responses"),
        Section(f"Where {REFERENCE} wins and where it loses", tuple(_balance(comparison)), "balance"),
        Section("The laws and how they were tuned", tuple(_laws(comparison)), "laws"),
    )
    return Page(
        f"Control laws compared on {robot.name}",
        asked.replace(REFERENCE, WHOLE),
        verdict(comparison).replace(REFERENCE, WHOLE),
        sections,
        Settings(setting_groups(comparison)),
        Provenance(tuple(command), s.seed),
        _key_numbers(comparison),
    )


def _key_numbers(comparison: Comparison) -> list[KeyNumber]:
    other = opponent(comparison)
    found = []
    for merit in (merit for key in KEYS for merit in MERITS if merit.key == key):
        mine = comparison.first.figures[merit.key]
        if mine is None:
            continue
        note = "" if other is None else f"{other.name}: {cell(merit, other.figures[merit.key], comparison)}"
        top = _best(comparison, merit)
        note = "; ".join(text for text in (note, top) if text)
        label = f"{WHOLE}: {in_words(merit, comparison)}"
        found.append(KeyNumber(label, cell(merit, mine, comparison), unit_of(merit, comparison), note))
    return found


def _best(comparison: Comparison, merit: Merit) -> str:
    """The best of all laws, with its name; or that none is better."""
    rows = comparison.compared
    marks = best(merit, [row.figures[merit.key] for row in rows])
    tops = [row for row, top in zip(rows, marks) if top]
    if not tops or comparison.first in tops:
        return "none is better"
    return f"best: {cell(merit, tops[0].figures[merit.key], comparison)} ({tops[0].name})"


def _balance(comparison: Comparison) -> list[Any]:
    text = (
        f"Figures that differ by more than 5 %, the clearest first; {REFERENCE} stands first in every pair. "
        "What all laws are tuned to is left out."
    )
    rows = [(row.name, *_sides(comparison, row)) for row in comparison.others]
    count = bests(comparison)
    most = ", ".join(f"{name} {number}" for name, number in count.items())
    table = Table(("against", f"{REFERENCE} is better", f"{REFERENCE} is worse"), rows)
    return [
        Paragraph(text),
        table,
        Paragraph(f"Best of all laws, or sharing it, in so many figures: {most}."),
    ]


def _sides(comparison: Comparison, row: Row) -> tuple[str, str]:
    found = []
    for side in versus(comparison, row):
        told = "; ".join(against(comparison, row, merit) for merit in side[:TOLD])
        more = f"; and {len(side) - TOLD} more" if len(side) > TOLD else ""
        found.append(f"{len(side)}: {told}{more}" if side else "nothing")
    return found[0], found[1]


def _laws(comparison: Comparison) -> list[Any]:
    text = (
        f"Every law but {REFERENCE} has one number that is tuned; {REFERENCE} is as the design makes it. "
        f"{_target(comparison)}All are run in error coordinates about the goal or the move, (x_d, u_d) from the "
        "elastic inverse dynamics. A step is run as each law is commanded: integrals begin such that the input "
        "continues, as in flexhinf design; a law without them sees the whole error at once. All have the "
        "same estimator (lqg: its own). What a law needs of the state is estimated where it is not measured."
    )
    rows = [
        (
            row.name,
            row.kind.what,
            f"R2 × {knob(row, PRICE)}" if row.kind.knob == PRICE else f"{knob(row, BANDWIDTH)} rad/s",
            reached(row),
            "–" if row.tuned is None or not row.tuned.tries else str(row.tuned.tries),
            _needs(row),
            row.kind.model,
            row.kind.source,
        )
        for row in comparison.rows
    ]
    unit = comparison.reference.unit if comparison.target.mode == "peak" else "rad/s"
    columns = (
        "law", "what it is", "tuned number", Column("reached", unit), "tries", "needs of the state", "knows", "source",
    )  # fmt: skip
    return [Paragraph(text), Table(columns, rows)]


def _target(comparison: Comparison) -> str:
    """What the tuned laws have in common, and on which robot."""
    if comparison.target.value is None:
        return ""
    limit = comparison.target.mode == "peak" and comparison.target.origin != "reference"
    worn = (
        " A law that uses all of a limit on the nominal robot may pass it within the tolerances."
        if limit
        else ""
    )
    common = same(comparison)
    common = common if common.startswith("tuned") else f"tuned to be {common}"
    return f"The others are {common}, on the nominal robot.{worn} "


def _needs(row: Row) -> str:
    """States by kind, and integrals."""
    kinds = [name.replace("_", " ") for name in SIGNALS if any(_is(name, state) for state in row.needs)]
    integral = ["integral of the link's error"] if any(s.endswith("_integral") for s in row.needs) else []
    everything = ["all four states"] if len(kinds) == len(SIGNALS) else kinds
    return ", ".join([*everything, *integral]) or "–"


def _is(name: str, state: str) -> bool:
    return not state.endswith("_integral") and (state == name or state.startswith(f"{name}_"))
