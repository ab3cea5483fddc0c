"""The report of laws compared over a workspace, and its verdict: who meets every requirement, then who errs least."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.design.requirements import REQUIREMENTS, Requirement
from flexhinf.design.verdict import result_row
from flexhinf.design.workspace.comparison import (
    TUNING_MOVES,
    TUNING_POSES,
    ComparedController,
    WorkspaceComparison,
)
from flexhinf.numerals import number, without_noise
from flexhinf.pages.arm_film import two_arms
from flexhinf.pages.drawing import Line, Panel, count_text, draw_figure, joint_count, line_style, listed
from flexhinf.pages.page import files_section
from flexhinf.pages.settings import loop_rows, robot_rows, settings_in_groups
from flexhinf.pages.terminal import Ending, screen
from flexhinf.pages.workspace_summary import range_of, units_in, worst_motion
from flexhinf.report import (
    INK,
    Badge,
    Cell,
    Column,
    Figure,
    Note,
    Page,
    Paragraph,
    Provenance,
    Section,
    Settings,
    Table,
    finite,
    house_style,
)

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: What laws that meet every requirement are ranked by, and what else is named where a rival has less.
TRACKING, REMAINING = REQUIREMENTS["tracking"].what, REQUIREMENTS["remaining"].what

#: Differences of errors smaller than this share say nothing: other moves would change them as much.
EQUAL = 0.1

CRITERION = "Criterion: every requirement of a design is met; then the smallest tracking error, the worst of all moves."


def ordered_rows(comparison: WorkspaceComparison) -> list[ComparedController]:
    """Laws by the criterion: those that meet all by their tracking errors, then those that miss, the fewest first."""

    def order(row: ComparedController) -> tuple[bool, int, float]:
        line = row.worst(TRACKING)
        found = np.inf if line is None else line.found / line.limit
        return not row.met, len(row.missed), found

    return sorted(comparison.compared, key=order)


def laws_verdict(comparison: WorkspaceComparison) -> str:
    """The criterion, and the best rival by it beside the design; where the design loses, that stands first."""
    own, ordered = comparison.own, ordered_rows(comparison)
    rival = next((row for row in ordered if row is not own), None)
    if rival is None:
        return f"{CRITERION} No other law could be compared with the design."
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
        theirs, mine = _value_text(comparison, rival, TRACKING), _value_text(comparison, own, TRACKING)
        a, b = (row.worst(TRACKING) for row in (rival, own))
        ratio = a.found / a.limit / (b.found / b.limit) if a and b and b.found else 1.0
        word = "beats" if ratio < 1.0 else "loses to"
        word = "has about the tracking error of" if abs(ratio - 1.0) <= EQUAL else word
        text = f"The best rival, {rival.name}, meets every requirement too, and {word} the design: "
        text += f"{theirs} against {mine}."
    return f"{CRITERION} {text} {_single(comparison)}".rstrip()


def _misses(comparison: WorkspaceComparison, row: ComparedController) -> str:
    kinds = {line.what for line in row.missed}
    line = row.missed[0].converted(_degrees(comparison))
    more = f", and {len(kinds) - 1} more" if len(kinds) > 1 else ""
    return f"{row.name}, which misses {line.what} ({line.achieved_text}, required {line.limit_text}{more})"


def _value_text(comparison: WorkspaceComparison, row: ComparedController, what: str) -> str:
    line = row.worst(what)
    return "–" if line is None else line.converted(_degrees(comparison)).achieved_text


def _single(comparison: WorkspaceComparison) -> str:
    """Errors of rivals that are smaller than the design's, the smallest of each kind."""
    parts: list[str] = []
    for what in (TRACKING, REMAINING):
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


def _degrees(comparison: WorkspaceComparison) -> bool:
    judged = comparison.own.judged
    return judged is not None and units_in(judged).degrees


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
    numbers: Mapping[str, tuple[float, ...]] = {} if row.numbers is None else row.numbers
    texts = [
        f"{name.replace('_', ' ')} {listed([number(x, 3) for x in values])}"
        for name, values in numbers.items()
    ]
    return ", ".join(texts) or "–"


def _law_table(comparison: WorkspaceComparison, brief: bool = False) -> Table:
    degrees, rows = _degrees(comparison), list[Sequence[object]]()
    heads = [what for what in (TRACKING, REMAINING) if what in comparison.whats]
    units = {what: _unit(comparison, what) for what in heads}
    for row in ordered_rows(comparison):
        worst = row.missed[0].converted(degrees) if row.missed else None
        verdict = "met"
        if worst is not None:
            verdict = f"{len(row.missed)} missed: {worst.what} {worst.value_text}, {worst.limit_text}"
        measured = () if row.judged is None else row.judged.specification.measured
        speed = "–" if row.bandwidth is None else number(row.bandwidth, 3)
        errors = [_cell(row.worst(what), degrees, units[what]) for what in heads]
        if brief:
            rows.append((row.name, speed, *errors, verdict))
            continue
        known = "true state" if comparison.specification.estimator == "none" else ", ".join(measured)
        rows.append(
            (
                row.name,
                row.kind.description if row is not comparison.own else "the modal law of flexhinf design",
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
        title = f"{comparison.robot.name}: laws over the workspace, the best first (✗ missed)"
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
        f"{CRITERION} ✗: missed.",
        "table-laws",
        stacks=True,
    )


def _unit(comparison: WorkspaceComparison, what: str) -> str:
    lines = (row.worst(what) for row in comparison.compared)
    return next(line for line in lines if line is not None).converted(_degrees(comparison)).unit


def _requirement_rows(comparison: WorkspaceComparison) -> Table:
    """Each requirement as a row, and what each law has of it."""
    degrees, laws = _degrees(comparison), ordered_rows(comparison)
    known = [
        {(line.what, _kind(line)): line for line in (() if row.judged is None else row.judged.requirements)}
        for row in laws
    ]
    keys = dict.fromkeys(key for lines in known for key in lines)
    rows: list[Sequence[object]] = []
    for key in keys:
        limits = dict.fromkeys(lines[key].converted(degrees).limit_text for lines in known if key in lines)
        name, unlike = f"{key[0]}, {key[1]}" if key[1] else key[0], len(limits) > 1
        required = "of each joint" if unlike else next(iter(limits))
        rows.append((name, required, *(_cell(lines.get(key), degrees, "", unlike) for lines in known)))
    return Table(
        ("requirement", "required", *(Column(row.name, right=True) for row in laws)),
        rows,
        "The same poses, moves, robots and seeds for all laws, those of flexhinf design. ✗: missed.",
        "table-requirements",
    )


def _kind(line: Requirement) -> str:
    """Whose requirement it is, of the two kinds of robots."""
    return "robots at corners" if "corner" in line.where else ""


def _figure(comparison: WorkspaceComparison) -> Figure:
    """Tracking errors of all moves, in ascending order; of joints that turn, and of those that slide."""
    judged, panels = comparison.own.judged, list[Panel]()
    assert judged is not None
    units, (small, scale) = units_in(judged), units_in(judged).small
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


def _arms(comparison: WorkspaceComparison) -> list[Figure]:
    """The arm in the move of the nominal robot in which a rival errs most, under the design and under that rival."""
    own = comparison.own.judged
    rows = [row for row in comparison.compared if row.judged is not None and row is not comparison.own]
    if own is None or not rows:
        return []
    rival = rows[0]
    assert rival.judged is not None
    errors = [row["tracking_error"] for row in worst_motion(rival.judged.moves)]
    worst = int(np.argmax(np.nan_to_num(np.array(errors, dtype=float), nan=-1.0)))
    runs = [judged.moves[worst].response for judged in (own, rival.judged)]
    if any(run.diverged_at is not None for run in runs):
        return []
    count = min(len(run.positions) for run in runs)
    pairs = list(zip((comparison.own.name, rival.name), (run.positions[:count] for run in runs), strict=True))
    says = f"The links in the same move, that with the largest error of {rival.name}."
    figure = two_arms(
        "arms", comparison.robot, runs[0].run.time[:count], pairs, says, "The arm under both laws"
    )
    return [] if figure is None else [figure]


def laws_notes(comparison: WorkspaceComparison) -> list[str]:
    """What was not compared, and why."""
    return [
        f"{row.name} was not compared: {row.failure.rstrip('.')}." for row in comparison.rows if row.failure
    ]


def _rule(comparison: WorkspaceComparison) -> str:
    return (
        "Each rival has the largest bandwidth, found by bisection, whose loops keep every limit with a tenth to spare "
        f"at {TUNING_POSES[0]} poses, and which keeps all limits in {TUNING_MOVES} moves of robots at corners of the "
        "tolerances; where none does, it is the one that lacks least. Poses and moves that judge are others. All laws "
        "run in the loop of the design: feedforward by the inverse dynamics along the move and of the dry friction "
        "that the file states, the design's kind of estimator with the sensors that the law's proponents would have, "
        "prediction over the latency, anti-windup and limits."
    )


def laws_page(
    comparison: WorkspaceComparison,
    command: Sequence[str],
    warnings: Sequence[str] = (),
    files: Sequence[str] = (),
) -> Page:
    """The page of a comparison over a workspace; parameters as for `flexhinf.pages.page.design_page`."""
    own, robot, verdict = comparison.own, comparison.robot, laws_verdict(comparison)
    assert own.judged is not None
    count = count_text(len(comparison.compared), "law")
    met = [row.name for row in comparison.compared if row.met]
    with house_style():
        sections = [
            Section(
                "Laws by the criterion",
                (
                    _law_table(comparison),
                    Paragraph(_rule(comparison)),
                    *map(Note, laws_notes(comparison)),
                    *(Note(" ".join(text.split())) for text in warnings),
                ),
                "criterion",
                True,
            ),
            Section("Every requirement of every law", (_requirement_rows(comparison),), "requirements", True),
        ]
        lead = [_figure(comparison), *_arms(comparison)]
    return Page(
        f"Control laws compared over the workspace of {robot.name}",
        f"{joint_count(len(robot.joint_names)).capitalize()}, {robot.drive} driven. {count} over "
        f"{range_of(own.judged)}.",
        verdict,
        (*sections, *([files_section(files)] if files else [])),
        Settings(
            settings_in_groups(
                {
                    "Robot": robot_rows(own.judged.setup.true.robot),
                    "Loop": loop_rows(own.judged.setup),
                }
            )
        ),
        Provenance(shlex.join(command), comparison.specification.seed),
        status=[
            Badge("met", f"Every requirement: {listed(met)}.")
            if met
            else Badge("not met", "No law meets every requirement."),
            Badge("not proved", "Tested on random samples, not proved."),
        ],
        lead=lead,
    )


def laws_numbers(comparison: WorkspaceComparison) -> dict[str, object]:
    """Numbers of comparison.json, in SI units; each requirement as in the table [result] of a design file."""
    return finite(
        {
            "version": 1,
            "kind": "workspace",
            "robot": comparison.robot.name,
            "joints": list(comparison.robot.joint_names),
            "seed": comparison.specification.seed,
            "criterion": CRITERION,
            "rule": _rule(comparison),
            "order": [row.name for row in ordered_rows(comparison)],
            "laws": [
                {
                    "name": row.name,
                    "what": row.kind.description,
                    "compared": row.judged is not None,
                    "met": row.met,
                    "failure": row.failure,
                    "bandwidth": row.bandwidth,
                    "stated": row.stated,
                    "numbers": None
                    if row.numbers is None
                    else {name: list(x) for name, x in row.numbers.items()},
                    "measured": [] if row.judged is None else list(row.judged.specification.measured),
                    "random_torques": None if row.judged is None else list(row.judged.setup.random),
                    "moves": 0 if row.judged is None else len(row.judged.moves) + len(row.judged.sampled),
                    "specification": [
                        result_row(line) for line in (row.judged.requirements if row.judged else ())
                    ],
                }
                for row in comparison.rows
            ],
        }
    )


def laws_ending(comparison: WorkspaceComparison) -> Ending:
    """What a terminal says at the end: the laws by the criterion, and the verdict."""
    return screen(
        lambda size: _law_table(comparison, brief=True),
        [1],
        [laws_verdict(comparison)],
        laws_notes(comparison),
    )


def laws_details(comparison: WorkspaceComparison) -> tuple[list[Terminal], list[str], str]:
    """Every requirement of every law, what was not compared, and the rule, for a terminal."""
    return [_requirement_rows(comparison).terminal(wide=True)], laws_notes(comparison), _rule(comparison)
