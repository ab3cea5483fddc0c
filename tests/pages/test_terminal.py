"""A command ends with one screen: 25 lines of 80 columns, the verdict, what is missed, numbers, what to try."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable

import numpy as np
import pytest
from rich.console import Console
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.designs import Comparison, PoseEvidence, Specification
from flexhinf.designs.problem.presets import robust_applies
from flexhinf.designs.requirements import REQUIREMENTS
from flexhinf.designs.result import judged_by
from flexhinf.pages import comparison_ending, ending
from flexhinf.pages.terminal import SCREEN, Ending, advice_text, page_ending, screen, tolerances_text
from flexhinf.report import Page, Section, Table

Make = Callable[[str], PoseEvidence]


def printed(end: Ending) -> list[str]:
    """Lines of a terminal of 80 columns."""
    stream = io.StringIO()
    for part in (*end.tables, end.text):
        Console(file=stream, width=80, highlight=False).print(part)
    return stream.getvalue().splitlines()


@pytest.mark.ci("searches weights and noise of a law of degree 4")
@pytest.mark.parametrize("name", ["met", "rings", "true state", "robust"])
def test_a_design_ends_with_a_screen(report_design: Make, name: str) -> None:
    design = report_design(name)
    lines = printed(ending(judged_by(design)))
    assert len(lines) <= SCREEN
    assert max(map(len, lines)) <= 80
    text = " ".join(" ".join(lines).split())
    missed = {line.what for line in design.requirements if not line.met}
    assert unnamed(text, *missed, "settling time", "peak input", "(law nl-hinf", "--pose") == []
    assert ("Not met:" in text) is ("To try:" in text) is bool(missed)


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_every_kind_that_is_missed_is_named(report_design: Make) -> None:
    design = report_design("met")
    lines = [
        dataclasses.replace(line, found=2.0 * line.limit + 1.0 if line.at_most else 0.0, at=None)
        for line in design.requirements
    ]
    lines = printed(ending(judged_by(dataclasses.replace(design, requirements=tuple(lines)))))
    assert len(lines) <= 40  # a line or two for each kind, however many are missed
    text = " ".join(" ".join(lines).split())
    assert unnamed(text, *{line.what for line in design.requirements}) == []


@pytest.mark.ci("designs of three laws")
def test_a_comparison_ends_with_a_screen(report_comparison: Comparison) -> None:
    lines = printed(comparison_ending(report_comparison))
    assert len(lines) <= SCREEN
    assert max(map(len, lines)) <= 80
    assert unnamed(" ".join(lines), "Criterion", "design", "overshoot", "requirements") == []
    rows = lines[next(k for k, line in enumerate(lines) if "───" in line) + 1 :]
    rows = rows[: next(k for k, line in enumerate(rows) if not line.strip())]
    names = {line.split()[0] for line in rows if line[1] != " "}  # others continue a row
    assert names == {law.name for law in report_comparison.compared}
    assert "…" not in "".join(lines)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("count", [0, 1, 3, 40])
def test_notes_and_rows_are_as_many_as_fit(count: int) -> None:
    def table(size: int) -> Table:
        return Table(("a", "b"), [(str(k), "x") for k in range(size)], title="rows")

    end = screen(table, range(30, 1, -1), ["One sentence. " * 12], ["a note"] * count)
    lines = printed(end)
    assert len(lines) <= SCREEN
    assert sum("Note: a note" in line for line in lines) + count_of(lines) == count
    few = printed(screen(table, [2], ["One."], ["a note"] * count))
    assert sum("Note: a note" in line for line in few) + count_of(few) == count


def count_of(lines: list[str]) -> int:
    """Notes that are only counted."""
    (number,) = [int(line.split()[0]) for line in lines if "on the page" in line] or [0]
    return number


def test_an_option_that_allows_a_limit_cycle_says_so() -> None:
    s = Specification()
    remaining = REQUIREMENTS["remaining"].judge(s, 1e-3, 2e-3, "a move")
    cycle = dataclasses.replace(REQUIREMENTS["limit_cycle"], field="remaining_error").judge(s, 3e-4, 5e-4, "")
    assert unnamed(advice_text([remaining], s, {}, {}), "--remaining-error") == []
    assert unnamed(advice_text([remaining], s, {}, {}), "vibration") == ["vibration"]
    assert (
        unnamed(advice_text([remaining, cycle], s, {}, {}), "--remaining-error", "vibration", "quarter") == []
    )


def test_a_limit_with_which_the_design_is_met_comes_first() -> None:
    s = Specification()
    remaining = REQUIREMENTS["remaining"].judge(s, 1e-3, 1.21e-3, "a move")
    cycle = dataclasses.replace(REQUIREMENTS["limit_cycle"], field="remaining_error").judge(
        s, 2.5e-4, 3.26e-4, ""
    )
    first = {"a new gear": True}
    assert advice_text([remaining], s, first, {}).startswith("To try: --remaining-error 0.0013:")
    assert advice_text([remaining, cycle], s, first, {}).startswith("To try: --remaining-error 0.0014:")
    far = dataclasses.replace(remaining, found=0.01)
    other = REQUIREMENTS["damping"].judge(s, 0.2, 0.1, "")
    for missed in ([far], [remaining, other], [dataclasses.replace(remaining, found=float("inf"))]):
        assert "a new gear" in advice_text(missed, s, first, {}).split(";")[0]


def test_a_damping_that_was_asked_for_is_answered_with_the_one_that_was_found() -> None:
    s = Specification(damping=0.9)
    line = dataclasses.replace(REQUIREMENTS["damping"], at_most=False).judge(s, 0.9, 0.3857, "")
    assert unnamed(advice_text([line], s, {}, {}), "--damping 0.38") == []


def test_narrower_tolerances_name_the_way_to_them() -> None:
    robot = fh.load_robot("planar-two-link")
    assert unnamed(tolerances_text(robot), "flexhinf identify") == []
    assert "payload" not in tolerances_text(robot)
    inertias = [
        dataclasses.replace(p, tolerance=50.0 if p.name.startswith("rotor_inertia") else p.tolerance)
        for p in robot.parameters
    ]
    text = tolerances_text(dataclasses.replace(robot, parameters=tuple(inertias)))
    assert (unnamed(text, "rotor inertia"), unnamed(text, "stiffness")) == ([], ["stiffness"])
    assert "payload" in tolerances_text(fh.load_robot("planar-two-link", payload="0..1kg"))


@pytest.mark.parametrize(
    ("settings", "tolerance", "applies"),
    [
        ({}, "stiffness", True),
        ({"preset": "damped"}, "stiffness", True),
        ({"preset": "robust"}, "stiffness", False),
        ({"effort": 10.0}, "stiffness", False),  # which contradicts it
        ({}, "", False),
        ({}, "gravity", False),  # which does not move the links at this pose
    ],
)
def test_the_preset_robust_is_advised_where_it_changes_the_design(
    settings: dict[str, object], tolerance: str, applies: bool
) -> None:
    robot = fh.load_robot("paper")
    parameters = [
        dataclasses.replace(p, tolerance=p.tolerance if p.name == tolerance else 0.0)
        for p in robot.parameters
    ]
    robot = dataclasses.replace(robot, parameters=tuple(parameters))
    goal = np.full(1, np.pi / 2)
    assert robust_applies(robot, Specification(**settings), goal) is applies


def test_a_page_ends_with_its_first_table_for_a_terminal_what_it_says_and_notes() -> None:
    rows = [(str(k), k) for k in range(40)]
    unnamed_table, table = Table(("a", "b"), rows), Table(("a", "b"), rows, title="Forty rows")
    page = Page("t", "r", "It `holds`.", (Section("s", (unnamed_table, table), "s"),), details=("Both do.",))
    end = page_ending(page, ["Use `--all`."])
    lines = printed(end)
    assert lines[0].strip() == "Forty rows"
    assert len(lines) <= SCREEN
    assert any("more on" in line for line in lines)
    assert end.text.splitlines() == [" ".join(("It holds.", *page.details)), "Note: Use --all."]
