"""Public results print in a line and show as a small table in a notebook."""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.notebook import Summarised, names_text, number_text, table_html

LONGEST = 600  # characters of a repr: a few lines of a terminal


@pytest.fixture(scope="module")
def results() -> dict[str, object]:
    robot = fh.paper_arm()
    problem = robot.problem([70.0, 18.0, 60.0, 18.0, 320.0])  # on every state, so that there is a region
    solution = fh.linear_law(problem, 1.5 * fh.smallest_gamma(problem))
    check = solution.sampled_region()
    return {
        "name: paper": robot,
        "link_position": robot.plant(),
        "link_position_integral": problem,
        "degrees": problem.expand(3),
        "degree of V": solution,
        "level of V": check,
        "definite: yes": solution.checked_margin(),
    }


def test_every_result_is_shown_in_a_line_and_in_a_table(results: dict[str, object]) -> None:
    for fact, result in results.items():
        assert isinstance(result, Summarised)
        text, html = repr(result), result._repr_html_()
        assert fact in text
        assert "\n" not in text
        assert len(text) < LONGEST
        assert html.count("<tr>") == len(result.summary())
        assert f"<b>{type(result).__name__}</b>" in html


def test_names_and_texts_are_escaped_and_long_lists_are_cut() -> None:
    assert "<script>" not in table_html("<script>", {"<script>": "<script>"})
    assert names_text(()) == "none"
    assert names_text([f"q{i}" for i in range(28)]) == "28 (q0, q1, q2, q3, q4, q5, …)"
    assert number_text(np.pi, "rad") == "3.142 rad"
