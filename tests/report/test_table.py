"""Tables and the numbers in them."""

from __future__ import annotations

import math
import re
from io import StringIO

import numpy as np
from rich.console import Console
from tests.refusals import refused_with, unnamed

from flexhinf import report
from flexhinf.errors import InvalidInput
from flexhinf.numerals import number


def cells(table: report.Table) -> list[str]:
    return re.findall(r"<td[^>]*>(.*?)</td>", table.html())


def test_units_stand_in_the_header_and_numbers_are_marked_for_the_right() -> None:
    html = report.Table(
        ["law", report.Column("settling time", "s", 2)], [["NL-H∞", 2.0], ["linear", None]]
    ).html()
    assert '<th scope="col" class="number">settling time <span class="unit">s</span></th>' in html
    assert '<td class="number">2.00</td>' in html
    assert '<td class="number">–</td>' in html
    assert "<td>NL-H∞</td>" in html


def test_a_column_of_comparable_numbers_has_common_decimals() -> None:
    assert cells(report.Table(["a"], [[12.3456], [1.5], [-0.25]])) == ["12.35", "1.50", "−0.25"]


def test_a_column_of_wide_range_keeps_the_digits_of_each() -> None:
    assert cells(report.Table(["a"], [[1e-9], [1234.5]])) == ["1·10⁻⁹", "1234"]


def test_kinds_of_cells() -> None:
    row = [np.float64(2.5), True, np.array([1, 2]), "x < y", math.inf]
    assert cells(report.Table(list("abcde"), [row])) == ["2.500", "yes", "1, 2", "x &lt; y", "∞"]


def test_a_number_that_is_none_is_said_to_be_so() -> None:
    assert cells(report.Table(["a"], [[math.nan], [1.0]])) == ["not a number", "1.000"]


def test_a_small_negative_number_is_not_minus_zero() -> None:
    assert number(-0.001, decimals=2) == "0.00"


def test_a_row_that_does_not_fit_is_refused() -> None:
    with refused_with(InvalidInput, "2 cells", "row 1"):
        report.Table(["a", "b"], [[1, 2], [3]])


def test_a_stacked_row_repeats_what_each_cell_is() -> None:
    columns = "claim", report.Column("settling time", "s"), report.Column("overshoot", "°")
    html = report.Table(columns, [("fast", 1.5, None), ("slow", 2.5, 3.5)], stacks=True).html()
    assert '<div class="table stacks">' in html
    assert '<td>fast</td><td class="number" data-label="settling time" data-unit=" s">1.5' in html
    assert re.findall(r'data-label="overshoot"(.*?)</td>', html) == [">–", ' data-unit="°">3.500']
    assert "data-label" not in report.Table(("claim", "s"), [("fast", 1.5)]).html()


def test_a_long_value_takes_several_lines_and_leaves_the_names_their_room_in_a_terminal() -> None:
    name, joint = "largest deviation", "a_joint_of_a_file_with_long_names"
    table = report.Table(
        ("what", report.Column("achieved", right=True)), ["group", (name, f"0.392 rad ({joint}, at 0.683 s)")]
    )
    console = Console(width=60, file=StringIO())
    console.print(table.terminal())
    lines = console.file.getvalue().splitlines()
    assert any(name in line for line in lines)
    assert any(joint in line for line in lines)
    (cell,) = [text for text in cells(table) if joint in text]
    assert f'long">{cell}' in table.html()


def test_long_headings_leave_names_and_values_whole_in_a_terminal() -> None:
    columns = ("joint", *(report.Column(f"a heading of words {k}", right=True) for k in range(6)))
    rows = [(f"gen3_joint_{k}", *["4.92·10⁻⁵"] * 6) for k in (1, 2)]
    file = StringIO()
    Console(width=80, file=file).print(report.Table(columns, rows).terminal())
    text = file.getvalue()
    assert unnamed(text, "gen3_joint_1", "gen3_joint_2", "heading", 5) == []
    assert "…" not in text
