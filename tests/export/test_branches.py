"""What a step of exported C may decide by data: every branch and every loop of the text is of a listed kind."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from tests.builders import arm_controller

import flexhinf as fh
from flexhinf.codegen.c.statements import POINTERS
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.search import tuned_setup
from flexhinf.export.controller_c import code_of
from flexhinf.robot.workspace import workspace_of

#: A name, an element of an array, a number: what is known without computing.
NAME = r"(?:(?!\d)\w+(?:\[[\w+* -]+\])?)"
NUMBER = r"\(?-?\d[\w.+-]*\)?"
VALUE = rf"(?:-?{NAME}|\(-{NAME}\)|\(?-?\d[\w.]*(?:e[+-]\d+f?)?\)?)"
SIZE = r"[\w+*% -]+"  # of integers that are constants where the function is called

#: A choice between two numbers that are both computed before takes as long whatever it chooses. So does a condition of
#: two such.
CHOICE = rf" \? {VALUE} : {VALUE}(?=[;,)])"
CONDITION = (
    rf"(?:!?c\d+|\(isnan\({VALUE}\) != 0\)|\({VALUE} (?:<|<=|>) {VALUE}\)|!?\(fabsf?\({VALUE}\) <= {VALUE}\))"
)
BOTH = rf"{CONDITION} (?:&&|\|\|) {CONDITION}"
SIGN = rf"\({VALUE} < {VALUE}\) \? {VALUE} : \(\({VALUE} > {VALUE}\) \? {VALUE} : {VALUE}\)"

#: Others that are written by hand.
CHOICES = (
    r"const int \w+ = \([\w -]+ < \d+\) \? [\w -]+ : \w+;",  # sizes, not data
    r"const real inverse = \(row\[j\] <= least && row\[j\] >= -tolerance \* moved\) \? .*;",  # a pivot that is zero
    rf"const real inverse(\d) = \(a\1\1 <= least\1 && a\1\1 >= -{NUMBER} \* moved\1\) \? .*;",
    r"return \(fabsf?\(\(a \+ b\) \+ \(c \+ d\)\) <= 0[.e+0]*f?\) \? 1 : 0;",  # whether all numbers are finite
    r"const real (share|inverse) = \(whole <= .*\) \? .*;",
    r"const real norm = \(diagonal < 0[.e+0]*f?\) \? -size : size;",
    r"const real [sc]v = \(m \* .*\) \? [sc] : [sc];",
    r"(return|sine\[l\] =|cosine\[l\] =) \(?\(.*\) \? -[sc]v : [sc]v(\) \* copysignf?\(.*\))?;",
    r"return \(\(quarter % 4u\) < 2u\) \? r : -r;", r"return \(x < 0[.e+0]*f?\) \? -sine : sine;",
    r"far \+= \(fabs\(x\[l\]\) <= .*\) \? 0 : 1;", r"rows\[.*l < left \? l : left - 1.*;",
    r"const int rows = \(triangle > 0\) \? m - triangle \+ c \+ 1 : m;",
    r"target\[.*\] = \(whole <= .*\) \? diagonal : norm;",
    r"target\[q \* p \+ i\] = \(fabsf?\(low - low\) <= 0[.e+0]*f?\) \? high \+ low : high;",
)  # fmt: skip

#: Loops, all with bounds that are constants.
LOOPS = (
    rf"for \(int \w+ = {SIZE}; \w+( \+ \d+)? (<|<=|>=) {SIZE}; (\+\+|--)?\w+( \+= \d+)?\) {{",
    r"for \(int e = 0; e < \(\([\w -]+ < \d+\) \? [\w -]+ : \d+\); \+\+e\) {",
)

#: Branches: numbers that are not finite, sine and cosine far away, and steps that are left out where a flag is zero.
BRANCHES = (
    r"if \(arm_finite\([\w +]+, \w+\) == 0\) {", r"if \(isfinite\(\w+\[i\]\) (==|!=) 0\) {",
    r"if \(!\(fabs\(x\) <= reach\)\) {", r"if \(size <= 1.0e4f\) {", r"if \(isfinite\(size\) == 0\) {",
    r"if \(turns < 0x2000000000000000u\) {", r"if \(\(quarter % 2u\) == 0u\) {",
    r"if \(far > 0\) {", r"if \(!\(fabsf?\(\w+\[0\]\) <= 0[.e+0]*f?\)\) {",
    r"if \(source < target\) {", r"if \(left < \d+\) {", r"if \(size > best\) {", r"if \(j < n\) {", r"}? ?else {",
)  # fmt: skip

#: What stands in every export: rules of samples, which the header describes, and functions that no step calls.
RULES = re.compile(
    r"int arm_(exact|init|start|check|step|predict|rest|at_rest|may_act|start_faults)\(|"
    r"int arm_(same|went_back|possible_input|counted)\(|"
    r"void arm_(limit|begin|hold|reasons)\(|real arm_(larger|smaller|number|slipped)\(|"
    r"arm_type_of_constants|int arm_is\(|ranges\[RANGES\]"
)


def functions(text: str) -> list[tuple[str, list[str]]]:
    """Head and lines of each function, without comments and lines that are folded."""
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    code = re.sub(r",\n +", ", ", code)
    code = re.sub(r"\n +(?=(\?|:|&&|\|\||=|\+|-) )", " ", code)
    found = re.findall(r"^(\w[^;#]*?)\n?{\n(.*?)^}", code, flags=re.DOTALL | re.MULTILINE)
    return [(head, [line.strip() for line in body.splitlines()]) for head, body in found]


def decisions(text: str) -> list[str]:
    """Lines that decide, of functions that belong to this controller alone."""
    lines = [line for head, body in functions(text) if not RULES.search(head) for line in body]
    decides = re.compile(r"^[^#]*(\b(if|else|for|while|do|switch|goto)\b|\?)")
    return [line for line in lines if decides.match(line)]


def is_choice(line: str) -> bool:
    """Whether a line assigns a value, and chooses between values that are computed before alone."""
    without = re.sub(BOTH, "", re.sub(CHOICE, "", re.sub(SIGN, "", line)))
    assigns = re.match(r"(?:const (?:real|bool) )?[\w+* \[\]-]+ = ", line)
    return assigns is not None and not re.search(r"[?]|&&|\|\|", without)


@cache
def two_links() -> fh.Controller:
    return arm_controller("planar-two-link", degree=4, r=1e-6, p0=1e-8, limit=200.0)


@cache
def seven_links() -> fh.Controller:
    noise, sensors = np.tile([0.0, 0.0, 1e-7, 1e-7], 7), ("link_position", "motor_position")
    return arm_controller("seven-link", measured=sensors, q=noise, r=1e-8, p0=1e-9, limit=24.0)


@cache
def source_of(made: Callable[[], fh.Controller], real: str) -> str:
    """The source of a controller, which takes some seconds for several joints."""
    return code_of(made(), "arm", real).source


def check(text: str) -> None:
    kinds = [re.compile(f"{kind}( else {{)?") for kind in (*CHOICES, *LOOPS, *BRANCHES)]
    found = decisions(text)
    assert len(found) > 80
    others = [line for line in found if not is_choice(line)]
    assert len(found) - len(others) > 20
    assert [line for line in others if not any(kind.fullmatch(line) for kind in kinds)] == []
    assert max(map(len, text.splitlines())) <= 132
    # sizes are integers, and no number becomes one
    helpers = re.findall(r"static \w* ?(?:void|int) (arm_\w+)\([^)]*\bint \w+\)", text)
    assert "arm_copy" in helpers
    for name in {*helpers} - {"arm_predict"}:
        for call in re.findall(
            rf"^ +(?:if \()?{name}\((.*)\)", re.sub(r",\n +", ", ", text), flags=re.MULTILINE
        ):
            assert re.fullmatch(
                r"\d+|left|ARM_\w+( \+ ARM_INPUTS)?|count|\w+ \* \d+|n - k",
                call.split(", ")[-1].split(")")[0],
            ), call


@pytest.mark.ci("exports a controller for each type")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("real", ["double", "float"])
def test_one_link_decides_nothing_by_data_but_what_is_listed(real: str, controller: fh.Controller) -> None:
    check(code_of(controller, "arm", real).source)


@pytest.mark.ci("writes the code of two joints")
@pytest.mark.parametrize("real", ["double", "float"])
def test_two_links_decide_nothing_by_data_but_what_is_listed(real: str) -> None:
    check(source_of(two_links, real))


@pytest.mark.ci("writes the code of seven joints")
def test_seven_links_decide_nothing_by_data_but_what_is_listed() -> None:
    check(source_of(seven_links, "double"))


def test_another_loop_or_branch_is_found() -> None:
    text = (
        "static void arm_f(const real *x)\n{\n    while (x[0] > 0) {\n    }\n    if (x[1] > 2) {\n    }\n}\n"
    )
    kinds = [re.compile(kind) for kind in (*CHOICES, *LOOPS, *BRANCHES)]
    assert len([line for line in decisions(text) if not any(kind.fullmatch(line) for kind in kinds)]) == 2


@pytest.mark.parametrize(
    ("line", "plain"),
    [
        ("const real v1 = c1 ? x[AT_U + 1] : -HUGE_VAL;", True),
        ("u[0] = ((v1 < v2) || (isnan(v2) != 0)) ? v1 : v2;", True),
        ("terms[0] = FMA(v1, !(fabs(x[0]) <= 0.0) ? v2 : (-1.0), (c1 && c2) ? 0.0 : v3);", True),
        ("const real v1 = c1 ? arm_sin(v2) : 0.0;", False),
        ("const real v1 = c1 ? v2 + v3 : 0.0;", False),
        ("const real v1 = c1 ? v2 : (c2 ? v3 : v4);", False),
        ("const bool c1 = (v1 + v2 < v3) && (v4 < v5);", False),
    ],
)
def test_what_is_computed_only_sometimes_is_found(line: str, plain: bool) -> None:
    assert is_choice(line) == plain


@pytest.mark.ci("exports a controller of its own")
def test_stages_stand_under_what_they_compute(controller: fh.Controller) -> None:
    """Of a filter and a law that are one trace."""
    source = code_of(controller, "arm", "double").source
    said = "Rows with the same T^TT", "The law u = k(x - x*)", "The input within its limits"
    assert [text for text in said if f"    /* {text}" not in source] == []
    bodies = {
        found[0]: body for head, body in functions(source) if (found := re.findall(r"void arm_(\w+)\(", head))
    }
    assert {"deviation", "feedback", "limited_input"} <= bodies.keys()
    assert 40 < max(map(len, bodies.values())) <= 120


def whole_functions(text: str) -> list[str]:
    """Functions with their heads and braces."""
    return [
        found[0] for found in re.finditer(r"^\w[^;{}#]*\)\n{\n.*?^}", text, flags=re.DOTALL | re.MULTILINE)
    ]


def unused(function: str) -> list[str]:
    """Pointers that it declares and does not use."""
    code = re.sub(r"/\*.*?\*/", "", function, flags=re.DOTALL)
    declared = re.findall(r"\*const (\w+) = ", code)
    return [name for name in declared if len(re.findall(rf"\b{name}\b", code)) < 2]


def of_a_workspace(links: str) -> fh.Controller:
    robot, limits = fh.load_robot(links), fh.Specification(workspace="limits")
    setup = tuned_setup(robot, limits, Task(workspace_of(robot, limits.workspace)))
    return setup.controller(setup.workspace.home, supervision=setup.supervision)


SEVEN = "workspace of seven joints"
SENSORS = ("link_position", "motor_position", "joint_torque")

#: Controllers with short and long steps, and types.
LONG = {
    "paper": (lambda: arm_controller(), "float"),
    "takeover": (lambda: arm_controller(start="bumpless"), "float"),
    "sensors": (lambda: arm_controller(measured=SENSORS, limit=20.0, latency=2), "double"),
    "two links in float": (two_links, "float"),
    "two links": (two_links, "double"),
    "two links, extended": (lambda: arm_controller("planar-two-link", fh.ExtendedKalmanFilter), "double"),
    "takeover in double": (lambda: arm_controller(degree=4, start="bumpless"), "double"),
    "seven links": (seven_links, "double"),
    "workspace": (lambda: of_a_workspace("planar-two-link"), "float"),
    SEVEN: (lambda: of_a_workspace("seven-link"), "double"),
}


def is_short(kind: str) -> bool:
    every = whole_functions(source_of(*LONG[kind]))
    assert [name for function in every for name in unused(function)] == []
    assert max(len(re.findall(r"\*const \w+ = ", function)) for function in every) <= POINTERS
    return 40 < max(len(function.splitlines()) for function in every) <= 120


def test_no_function_is_longer_than_a_page() -> None:
    assert is_short("takeover")


@pytest.mark.ci("writes the code of controllers of several joints")
@pytest.mark.parametrize("kind", [kind for kind in LONG if kind not in ("takeover", SEVEN)])
def test_no_function_of_several_joints_is_longer_than_a_page(kind: str) -> None:
    assert is_short(kind)


@pytest.mark.nightly("designs a law for the workspace of seven joints")
def test_no_function_of_a_workspace_of_seven_joints_is_longer_than_a_page() -> None:
    assert is_short(SEVEN)


@pytest.mark.ci("exports a controller for each type")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("real", ["double", "float"])
def test_stages_are_functions_with_named_arguments_and_results(real: str, controller: fh.Controller) -> None:
    """The takeover's equal passes are one function in a loop, and what is of a buffer's whole size has its constant."""
    code = code_of(controller.fresh(start="bumpless"), "arm", real)
    source, header = code.source, code.header
    assert re.findall(r"\b(?:kept\[|data\[\d|p\[\d).*", source) == []
    lines = [*source.splitlines(), *header.splitlines()]
    assert [line for line in lines if len(line) > 120] == []
    sample = [line for head, body in functions(source) if " arm_sample" in head for line in body]
    at = next(k for k, line in enumerate(sample) if line.startswith("for (int k0 = 0;"))
    called = re.findall(
        r"^arm_(\w+)\(", "\n".join(sample[at + 1 : sample.index("}", at)]), flags=re.MULTILINE
    )
    assert called
    assert "arm_copy(after, memory, ARM_MEMORY);" in sample
    for name in called:
        assert sum(f" arm_{name}(" in head for head, _ in functions(source)) == 1
