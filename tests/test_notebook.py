"""Public results print in a line and show as a small table in a notebook."""

from __future__ import annotations

import doctest
import enum
import inspect
import re
from base64 import b64decode
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs.requirements import Requirement
from flexhinf.drawers import Drawer
from flexhinf.notebook import PICTURES, Pictured, StatedRepr, Summarised, names_text, stated_text, table_html
from flexhinf.numerals import number_text
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


class Weighed(Pictured):
    """A result of nobody's room."""

    def summary(self) -> dict[str, str]:
        return {"mass": "1 kg"}


class Heavier(Weighed):
    """Of which the picture is that of the class that it derives from, until it has one of its own."""


def test_a_picture_is_drawn_by_what_is_registered_for_the_type() -> None:
    assert Weighed()._repr_html_() == table_html("Weighed", {"mass": "1 kg"})

    @PICTURES.register(Weighed)
    def _(result: Weighed) -> str:
        return f"<p>{result.summary()['mass']}</p>"

    assert Weighed()._repr_html_().endswith("</table><p>1 kg</p>")
    assert Heavier()._repr_html_().endswith("</table><p>1 kg</p>")
    PICTURES.register(Heavier)(lambda result: "<p>heavier</p>")
    assert Heavier()._repr_html_().endswith("</table><p>heavier</p>")
    with pytest.raises(TypeError, match="Weighed"):
        Drawer()(Weighed())


@pytest.mark.ci("a design of one pose")
def test_a_design_shows_its_step() -> None:
    quick: dict[str, Any] = {
        "degrees": (2,),
        "draws": 0,
        "rays": 0,
        "proof_seconds": 0,
        "estimator": "none",
    }
    html = fh.design(
        fh.load_robot("paper"), fh.Specification(pose=(0.17,), start=(0.0,), **quick)
    )._repr_html_()
    assert html.count("<img") == 2
    assert 'alt="The step"' in html


PUBLIC = [
    each
    for name in dir(fh)
    if inspect.isclass(each := getattr(fh, name)) and each.__module__.startswith("flexhinf")
]


def test_every_public_class_has_a_text_of_its_own() -> None:
    """None prints its arrays, or where it lies in memory."""
    others = (Summarised, StatedRepr, Exception, tuple, enum.Flag)
    bare = [each.__name__ for each in PUBLIC if not issubclass(each, others) and "__repr__" not in vars(each)]
    assert bare == ["BlackBox"]  # whose subclasses are a user's
    assert [each.__name__ for each in PUBLIC if each.__repr__ is object.__repr__] == ["BlackBox"]


STATED = [each for each in PUBLIC if issubclass(each, StatedRepr)]


@pytest.mark.ci("a robot's models, and a follower")
def test_what_a_user_states_is_printed_in_a_line() -> None:
    """What the examples of the classes name."""
    found: dict[str, StatedRepr] = {}
    for kind in STATED:
        names: dict[str, Any] = {}
        for example in doctest.DocTestParser().get_examples(inspect.getdoc(kind) or ""):
            exec(example.source, names)
        found |= {type(value).__name__: value for value in names.values() if isinstance(value, StatedRepr)}
    assert {"Braked", "FollowGoal", "Follower", "JerkLimited", "Moving", "Spline", "Waypoints"} <= set(found)
    for each in found.values():
        assert not re.search(r"\.\d{11}| at 0x|\n", repr(each))
        assert len(repr(each)) < LONGEST


def test_numbers_are_stated_in_ten_digits_and_defaults_are_left_out() -> None:
    third = 0.1 + 0.2
    assert repr(fh.Step(third)) == "Step(value=0.3)"
    assert repr(fh.Sensor("link_position", noise=third)) == "Sensor(name='link_position', noise=0.3)"
    assert repr(fh.Specification(pose=(third,))) == "Specification(pose=(0.3,))"
    samples = fh.Samples(np.arange(20.0), np.zeros((20, 2)))
    assert repr(samples) == "Samples(times=<array of 20>, values=<array of 20 × 2>)"
    assert repr(fh.Penalty({"x": third})) == "Penalty(states={'x': 0.3})"
    assert stated_text([np.pi, float("inf"), True, None]) == "[3.141592654, inf, True, None]"


def test_a_requirement_says_where_and_in_what_unit() -> None:
    line = Requirement("overshoot", 5.0, 3.0 * 1.1, "%", where="step, nominal robot")
    for text in (str(line), repr(line)):
        assert all(part in text for part in ("3.3 %", "5 %", "step, nominal", "met"))


def test_controllers_filters_and_status_say_their_units_and_names() -> None:
    filter = fh.ExtendedKalmanFilter(fh.paper_arm().plant(), 1e-3, 1e-6, 1e-8, np.zeros(4), 1e-4)
    assert [each.split()[-1] for each in filter.summary()["process noise"].split(" per ")[0].split(",")] == [
        "rad",
        "rad/s",
    ]
    assert filter.summary()["measurement noise"].endswith(" rad")
    assert str(fh.Status.SATURATION | fh.Status.BLOCKED) == "SATURATION, BLOCKED"
    assert str(fh.Status(0)).replace(" ", "").isalpha()
    assert f"{fh.Status.BLOCKED:d}" == "64"
