"""The report of a comparison of laws, and its verdict: who meets every requirement, then who errs least."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.designs.compare import ComparedController, Comparison
from flexhinf.designs.evidence import JudgedRuns
from flexhinf.designs.judge import missed_by
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.task import Task
from flexhinf.designs.verdict import result_row
from flexhinf.designs.workspace.gain_search import TUNING_MOVES, TUNING_POSES
from flexhinf.designs.workspace.rivals import Gains
from flexhinf.numerals import count_text, number, without_noise
from flexhinf.pages.arm_film import two_arms
from flexhinf.pages.drawing import (
    Line,
    Panel,
    Units,
    draw_figure,
    joint_count,
    line_style,
    listed,
    thin,
)
from flexhinf.pages.page import files_section
from flexhinf.pages.settings import loop_rows, robot_rows
from flexhinf.pages.terminal import Ending, screen
from flexhinf.pages.workspace_summary import range_of, worst_motion
from flexhinf.report import (
    INK,
    Badge,
    Cell,
    Column,
    Figure,
    Note,
    Page,
    Paragraph,
    Section,
    Table,
    finite,
    house_style,
)

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: Errors of laws. The first that the task has ranks laws that meet every requirement; the others are named where a
#: rival has less.
TRACKING, OVERSHOOT, REMAINING = (REQUIREMENTS[name].what for name in ("tracking", "overshoot", "remaining"))
ERRORS = (TRACKING, OVERSHOOT, REMAINING)

#: Differences of errors smaller than this share say nothing: other moves would change them as much.
EQUAL = 0.1


def errors_of(comparison: Comparison) -> list[str]:
    """The errors by which the design is judged: the first ranks, of a step its overshoot."""
    own = {line.what for line in comparison.own.requirements}
    return [what for what in ERRORS if what in own]


def criterion_of(comparison: Comparison) -> str:
    """What is asked first, and what ranks laws that keep it."""
    ranked = [
        f"; then the smallest {what}, the worst of all {'moves' if what == TRACKING else 'steps'}"
        for what in errors_of(comparison)[:1]
    ]
    return f"Criterion: every requirement of a design is met{''.join(ranked)}."


def ordered_rows(comparison: Comparison) -> list[ComparedController]:
    """Laws by the criterion: those that meet all by their errors, then those that miss, the fewest first."""
    ranked = errors_of(comparison)[:1]

    def order(row: ComparedController) -> tuple[bool, int, float]:
        line = next((row.worst(what) for what in ranked), None)
        found = np.inf if line is None else line.found / line.limit
        return not row.met, len(row.missed), found

    return sorted(comparison.compared, key=order)


def comparison_verdict(comparison: Comparison) -> str:
    """The criterion, and the best rival by it beside the design; where the design loses, that stands first."""
    own, ordered, criterion = comparison.own, ordered_rows(comparison), criterion_of(comparison)
    rival = next((row for row in ordered if row is not own), None)
    if rival is None:
        return f"{criterion} No other law could be compared with the design."
    if own.met and not rival.met:
        text = f"The design alone meets every requirement. The best rival is {_misses(comparison, rival)}."
    elif rival.met and not own.met:
        text = (
            f"The best rival, {rival.name}, meets every requirement, and the design does not: it is "
            f"{_misses(comparison, own)}."
        )
    elif not rival.met:
        better = len(rival.missed) < len(own.missed)
        first, last = (rival, own) if better else (own, rival)
        text = f"No law meets every requirement. Least is missed by {_misses(comparison, first)}, more by "
        text += f"{_misses(comparison, last)}."
    else:
        text = f"The best rival, {rival.name}, meets every requirement too{_ranked(comparison, rival)}."
    return f"{criterion} {text} {_single(comparison)}".rstrip()


def _ranked(comparison: Comparison, rival: ComparedController) -> str:
    """How a rival that meets everything stands beside the design that does so too; "" where nothing ranks them."""
    for what in errors_of(comparison)[:1]:
        theirs, mine = (_value_text(comparison, row, what) for row in (rival, comparison.own))
        a, b = (row.worst(what) for row in (rival, comparison.own))
        ratio = a.found / a.limit / (b.found / b.limit) if a and b and b.found else 1.0
        word = "beats" if ratio < 1.0 else "loses to"
        word = f"has about the {what} of" if abs(ratio - 1.0) <= EQUAL else word
        return f", and {word} the design: {theirs} against {mine}"
    return ""


def _misses(comparison: Comparison, row: ComparedController) -> str:
    kinds = {line.what for line in row.missed}
    line = row.missed[0].converted(_degrees(comparison))
    more = f", and {len(kinds) - 1} more" if len(kinds) > 1 else ""
    return f"{row.name}, which misses {line.what} ({line.achieved_text}, required {line.limit_text}{more})"


def _value_text(comparison: Comparison, row: ComparedController, what: str) -> str:
    line = row.worst(what)
    return "–" if line is None else line.converted(_degrees(comparison)).achieved_text


def _single(comparison: Comparison) -> str:
    """Errors of rivals that are smaller than the design's, the smallest of each kind."""
    parts: list[str] = []
    for what in errors_of(comparison):
        mine = comparison.own.worst(what)
        lines = [
            (line.found / line.limit, row, line)
            for row in comparison.compared
            if row is not comparison.own and (line := row.worst(what)) is not None
        ]
        if mine is None or not lines:
            continue
        share, row, line = min(lines, key=lambda one: one[0])
        if share < (1.0 - EQUAL) * mine.found / mine.limit:
            other = "" if row.met else ", which misses a requirement,"
            theirs, own = (each.converted(_degrees(comparison)).achieved_text for each in (line, mine))
            parts.append(f"{row.name}{other} has the smallest {what} ({theirs} against {own})")
    return f"In single numbers rivals are better: {'; '.join(parts)}." if parts else ""


def _judged(comparison: Comparison) -> JudgedRuns:
    """What the design was judged by, which there always is."""
    assert comparison.own.judged is not None
    return comparison.own.judged


def _units(comparison: Comparison) -> Units:
    setup = _judged(comparison).setup
    return Units(setup.model, setup.joints, comparison.specification.in_degrees)


def _degrees(comparison: Comparison) -> bool:
    return _units(comparison).degrees


def _cell(line: Requirement | None, degrees: bool, unit: str = "", limited: bool = False) -> Cell | str:
    """What was found, marked where it is missed; of a law for which there is no such requirement, a dash. It has its
    unit where that is not `unit`; `limited`: its joint and limit too, as those of other laws differ."""
    if line is None:
        return "–"
    line = line.converted(degrees)
    alone = not limited and (not unit or line.unit == unit) and np.isfinite(line.found)
    text = number(without_noise(line.found, line.limit), 3) if alone else line.value_text
    if limited:
        text = f"{text} ({', '.join(filter(None, (line.joint, line.limit_text)))})"
    return Cell(f"{text} ✗", "red") if line.missed else text


def _numbers_text(row: ComparedController) -> str:
    numbers: Gains = {} if row.judged is None else row.judged.numbers
    texts = [
        f"{name.replace('_', ' ')} {listed([number(x, 3) for x in values])}"
        for name, values in numbers.items()
    ]
    return ", ".join(texts) or "–"


def _law_table(comparison: Comparison, brief: bool = False) -> Table:
    degrees, rows = _degrees(comparison), list[Sequence[object]]()
    heads = errors_of(comparison)
    units = {what: _unit(comparison, what) for what in heads}
    for row in ordered_rows(comparison):
        worst = row.missed[0].converted(degrees) if row.missed else None
        verdict = "met"
        if worst is not None:
            verdict = f"{len(row.missed)} missed: {worst.what} {worst.value_text}, {worst.limit_text}"
        measured = () if row.judged is None else row.judged.specification.measured
        bandwidth = None if row.judged is None else row.judged.bandwidth
        speed = "–" if bandwidth is None else number(bandwidth, 3)
        errors = [_cell(row.worst(what), degrees, units[what]) for what in heads]
        if brief:
            rows.append((row.name, speed, *errors, verdict))
            continue
        known = "true state" if comparison.specification.estimator == "none" else ", ".join(measured)
        rows.append(
            (
                row.name,
                f"{row.kind.description} ({row.kind.source})",
                known.replace("_", " "),
                speed,
                f"{_numbers_text(row)}{' (stated)' * row.stated}",
                *errors,
                Cell(verdict, "green" if row.met else "red"),
            )
        )
    columns = [f"{what}\n{units[what]}" if brief else f"{what}, {units[what]}" for what in heads]
    if brief:
        wide = (Column(name, right=True) for name in ("bandwidth\nrad/s", *columns))
        title = f"{comparison.robot.name}: laws over {task_text(comparison)}, the best first (✗ missed)"
        return Table(("law", *wide, "requirements"), rows, title=title)
    return Table(
        (
            "law",
            "what it is",
            "measured",
            "bandwidth, rad/s",
            "other numbers",
            *columns,
            "met, or what it misses most",
        ),
        rows,
        f"{criterion_of(comparison)} ✗: missed.",
        "table-laws",
        stacks=True,
    )


def _unit(comparison: Comparison, what: str) -> str:
    lines = (row.worst(what) for row in comparison.compared)
    return next(line for line in lines if line is not None).converted(_degrees(comparison)).unit


def _requirement_rows(comparison: Comparison, brief: bool = False) -> Table:
    """Each requirement as a row, and what each law has of it; in `brief` without limits that differ between laws."""
    degrees, laws = _degrees(comparison), ordered_rows(comparison)
    known = [
        {(line.what, _kind(line)): line for line in sorted(row.requirements, key=missed_by)} for row in laws
    ]
    keys = dict.fromkeys((line.what, _kind(line)) for row in laws for line in row.requirements)
    rows: list[Sequence[object]] = []
    for key in keys:
        limits = dict.fromkeys(lines[key].converted(degrees).limit_text for lines in known if key in lines)
        name, unlike = f"{key[0]}, {key[1]}" if key[1] else key[0], len(limits) > 1
        unit = next(lines[key].converted(degrees).unit for lines in known if key in lines)
        required = f"of each joint, {unit}".removesuffix(", ") if unlike else next(iter(limits))
        rows.append(
            (name, required, *(_cell(lines.get(key), degrees, "", unlike and not brief) for lines in known))
        )
    return Table(
        ("requirement", "required", *(Column(row.name, right=True) for row in laws)),
        rows,
        "Poses, moves, robots and seeds are those of flexhinf design with each law; other robots are within their "
        "tolerances. ✗: missed.",
        "table-requirements",
    )


def _kind(line: Requirement) -> str:
    """Whose requirement it is, of the two kinds of robots."""
    return "other robots" if "tolerances" in line.where else ""


def _figures(comparison: Comparison) -> list[Figure]:
    """Tracking errors of all moves, where the task has them, else the step of each law; and the arm in a move."""
    errors = TRACKING in errors_of(comparison)
    return [_errors(comparison) if errors else _steps(comparison), *_arms(comparison)]


def _errors(comparison: Comparison) -> Figure:
    """Tracking errors of all moves, in ascending order; of joints that turn, and of those that slide."""
    panels, units = list[Panel](), _units(comparison)
    small, scale = units.small
    limits = [line for row in comparison.compared if (line := row.worst(TRACKING)) is not None]
    for unit, places in units.kinds(small).items():
        factor, lines = units.factor_of(scale, units.joints[places[0]]), list[Line]()
        for k, row in enumerate(comparison.compared):
            if row.judged is None:
                continue
            moves = (*row.judged.moves, *row.judged.sampled)
            errors = [each["tracking_error"] for each in worst_motion(moves, places)]
            values = factor * np.sort(np.array(errors, dtype=float))
            values = values[np.isfinite(values)]
            share = 100.0 * (np.arange(len(values)) + 1) / len(errors)
            lines.append(Line(share, values, None if panels else row.name, line_style(k)))
        own = [line for line in limits if units.of(small, line.joint) in (unit, small)]
        dashed = [(factor * line.limit, INK, None if panels else "allowed") for line in own[-1:]]
        panels.append(Panel("tracking error", unit, lines, across="share of the moves (%)", dashed=dashed))
    caption = "The largest error of each move, in ascending order: 80 % of moves have less than a curve has at 80 %."
    return draw_figure("laws", panels, caption, "Errors along the moves")


def _steps(comparison: Comparison) -> Figure:
    """The step of the nominal robot under each law, of the joint that travels farthest."""
    units, (first, *_) = _units(comparison), _judged(comparison).moves
    joint = int(np.argmax(first.travel))
    factor, lines = float(np.broadcast_to(units.scale, len(units.joints))[joint]), list[Line]()
    for k, row in enumerate(comparison.compared):
        if row.judged is not None:
            run = row.judged.moves[0].response
            part = thin(run.run.time)
            lines.append(
                Line(run.run.time[part], factor * run.positions[part, joint], row.name, line_style(k))
            )
    name = units.joints[joint]
    panel = Panel(f"link position of {name}", units.of(units.angle, name), lines)
    caption = "The nominal robot under each law: the joint that travels farthest."
    return draw_figure("laws", [panel], caption, "The step under each law")


def _arms(comparison: Comparison) -> list[Figure]:
    """The arm in the move of the nominal robot in which a rival errs most, under the design and under that rival."""
    own = _judged(comparison)
    rivals = [row for row in comparison.compared if row is not comparison.own]
    if not rivals or rivals[0].judged is None:
        return []
    rival, moves = rivals[0], (own.moves, rivals[0].judged.moves)
    errors = [row["tracking_error"] for row in worst_motion(moves[1])]
    worst = int(np.argmax(np.nan_to_num(np.array(errors, dtype=float), nan=-1.0)))
    runs = [each[worst].response for each in moves]
    if any(run.diverged_at is not None for run in runs):
        return []
    count = min(len(run.positions) for run in runs)
    pairs = list(zip((comparison.own.name, rival.name), (run.positions[:count] for run in runs), strict=True))
    says = f"The links in the same motion, that with the largest error of {rival.name}."
    figure = two_arms(
        "arms", comparison.robot, runs[0].run.time[:count], pairs, says, "The arm under both laws"
    )
    return [] if figure is None else [figure]


def comparison_notes(comparison: Comparison) -> list[str]:
    """What was not compared, and why."""
    return [
        f"{row.name} was not compared: {row.failure.rstrip('.')}." for row in comparison.rows if row.failure
    ]


def task_text(comparison: Comparison) -> str:
    """The poses of the task, in words."""
    s = comparison.specification
    return range_of(Task.of(comparison.robot, s), s, _units(comparison))


def _rule(comparison: Comparison) -> str:
    return (
        "Each law is designed as flexhinf design does it. One with a bandwidth has the largest, found by bisection, "
        f"whose loops keep every limit with a tenth to spare at {TUNING_POSES[0]} poses of a workspace, and which "
        f"keeps all limits in {TUNING_MOVES} moves of robots at corners of the tolerances; where none does, it is the "
        "one that lacks least. Poses and moves that judge are others. All laws have feedforward, prediction over the "
        "latency, anti-windup and limits; each has the sensors that its proponents would have, and the estimator that "
        "suits both."
    )


def comparison_page(
    comparison: Comparison,
    command: Sequence[str],
    warnings: Sequence[str] = (),
    files: Sequence[str] = (),
) -> Page:
    """The page of a comparison; parameters as for `flexhinf.pages.page.design_page`."""
    robot, setup = comparison.robot, _judged(comparison).setup
    count = count_text(len(comparison.compared), "law")
    met = [row.name for row in comparison.compared if row.met]
    with house_style():
        sections = [
            Section(
                "Laws by the criterion",
                (
                    _law_table(comparison),
                    Paragraph(_rule(comparison)),
                    *map(Note, comparison_notes(comparison)),
                    *(Note(" ".join(text.split())) for text in warnings),
                ),
                "criterion",
                True,
            ),
            Section("Every requirement of every law", (_requirement_rows(comparison),), "requirements", True),
        ]
        lead = _figures(comparison)
    return Page(
        f"Control laws compared on {robot.name}",
        f"{joint_count(len(robot.joint_names)).capitalize()}, {robot.drive} driven. {count} over "
        f"{task_text(comparison)}.",
        comparison_verdict(comparison),
        (*sections, *([files_section(files)] if files else [])),
        command,
        comparison.specification.seed,
        {"Robot": robot_rows(setup.true.robot), "Loop": loop_rows(setup)},
        status=[
            Badge("met", f"Every requirement: {listed(met)}.")
            if met
            else Badge("not met", "No law meets every requirement."),
            Badge("not proved", "Tested on random samples, not proved."),
        ],
        lead=lead,
    )


def comparison_numbers(comparison: Comparison) -> dict[str, object]:
    """Numbers of comparison.json, in SI units; each requirement as in the table [result] of a design file."""
    s = comparison.specification
    return finite(
        {
            "version": 2,
            "robot": comparison.robot.name,
            "joints": list(comparison.robot.joint_names),
            "task": task_text(comparison),
            "seed": s.seed,
            "criterion": criterion_of(comparison),
            "rule": _rule(comparison),
            "order": [row.name for row in ordered_rows(comparison)],
            "laws": [_numbers_of(row) for row in comparison.rows],
        }
    )


def _numbers_of(row: ComparedController) -> dict[str, object]:
    own: dict[str, object] = {
        "name": row.name,
        "law": row.kind.name,
        "what": row.kind.description,
        "source": row.kind.source,
        "compared": row.judged is not None,
        "met": row.met,
        "failure": row.failure,
        "stated": row.stated,
        "requirements": [result_row(line) for line in row.requirements],
    }
    if row.judged is None:
        return own
    e = row.judged
    return own | {
        "bandwidth": e.bandwidth,
        "numbers": {name: list(x) for name, x in e.numbers.items()},
        "measured": list(e.specification.measured),
        "estimator": e.specification.estimator,
        "moves": len(e.moves) + len(e.sampled),
    }


def comparison_ending(comparison: Comparison) -> Ending:
    """What a terminal says at the end: the laws by the criterion, and the verdict."""
    return screen(
        lambda size: _law_table(comparison, brief=True),
        [1],
        [comparison_verdict(comparison)],
        comparison_notes(comparison),
    )


def comparison_details(comparison: Comparison) -> tuple[list[Terminal], list[str], str]:
    """Every requirement of every law, what was not compared, and the rule, for a terminal."""
    return (
        [_requirement_rows(comparison, brief=True).terminal()],
        comparison_notes(comparison),
        _rule(comparison),
    )
