"""Public results print in a line and show as a small table in a notebook."""

from __future__ import annotations

import re
from base64 import b64decode

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.notebook import Summarised, names_text, number_text, table_html
from flexhinf.pages.pictures import robot_picture

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


@pytest.mark.costs("draws the picture of a robot")
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


def test_a_robot_shows_its_arm_below_its_table() -> None:
    """An arrow leads where a joint moves its link: of the hanging arm of the paper to the right."""
    html = fh.load_robot("planar-two-link")._repr_html_()
    picture = b64decode(html.partition("base64,")[2].partition('"')[0]).decode()
    assert html.startswith("<table>")
    assert {"shoulder", "elbow", "height (m)"} <= set(re.findall(r">([^<>]+)</text>", picture))
    assert "22.9°, 34.4°" in html
    seen = robot_picture(fh.paper_arm())
    assert seen is not None
    assert "(0°)" in seen.caption
    (arrow,) = re.findall(r'<path d="M (\S+) (\S+) ?\n?Q \S+ \S+ (\S+) (\S+)', seen.svg)
    (x, y), (to_x, to_y) = np.reshape([float(number) for number in arrow], (2, 2))
    assert (to_x - x) / (y - to_y) == pytest.approx(
        np.sin(np.radians(15)) / (1 - np.cos(np.radians(15))), rel=0.1
    )
    assert "<img" not in fh.load_robot("quanser-rotflex")._repr_html_()  # links without a length


@pytest.mark.costs("a design of one pose")
def test_a_design_shows_its_step() -> None:
    quick = {
        "degrees": "2",
        "draws": 0,
        "rays": 0,
        "proof_seconds": 0,
        "compare_rigid": False,
        "estimator": "none",
    }
    html = fh.design(fh.load_robot("paper"), fh.Specification(pose="10deg", start="0", **quick))._repr_html_()
    assert html.count("<img") == 2
    assert 'alt="The step"' in html
