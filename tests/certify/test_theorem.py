"""The theorem says what was proved, rounded so that it holds; claims beyond the arithmetic are refused."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.certify import Certificate, Function, Parameter, Signal, Start, Term
from flexhinf.certify.certificate import theorem_text
from flexhinf.certify.checker import Verification

DECAYS = Term(-1.0, (1,))


def line(**changes: Any) -> Certificate:
    """ẋ = −x with V = x²(10 − x)²/100: {V ≤ 1} has a component about 0 and another about 10."""
    fields: dict[str, Any] = {
        "about": "a line", "states": (Signal("x", "m"),), "inputs": (Signal("u", "N"),),
        "disturbances": (Signal("d", "N"),),
        "drift": ((DECAYS,),), "g1": (((),),), "g2": (((),),), "penalty": (), "r2": ((1.0,),),
        "value": (((2,), 1.0), ((3,), -0.2), ((4,), 0.01)), "law": ((),), "gamma": 1.0, "level": 1.0,
        "coordinates": ((1.0,),), "reach": 2.0,
    }  # fmt: skip
    return Certificate(**{**fields, **changes})


def test_the_component_about_the_goal_is_proved() -> None:
    found = line().check(threads=1)
    assert found.proved, found.reason


def test_a_path_in_another_component_is_no_path_of_starts() -> None:
    with pytest.raises(fh.InvalidInput, match=r"from x\(0\) = 0"):
        Start("elsewhere", 1.0, ((),), (), (0.0, 1.0), ((10.0, 10.0),))
    with pytest.raises(fh.InvalidInput, match=r"from x\(0\) = 0"):
        Start("elsewhere", 1.0, ((Term(10.0, (0,)),),))
    Start("a step", 1.0, ((Term(-1.0, (1,)),),))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"level": 1e-300}, "ends of"),
        ({"reach": 3e-162}, "ends of"),
        ({"reach": 1e-11}, "ends of"),
        ({"reach": 1e11}, "ends of"),
        ({"parameters": tuple(Parameter(f"p{i}", 1.0, 2.0) for i in range(13))}, "13 parameters"),
        (
            {
                "functions": (Function("sin", (1.0,)),),
                "drift": ((DECAYS, Term(1.0, (0,), (), 0)),),
                "reach": 1e9,
            },
            " 1000",
        ),
        ({"coordinates": ((1e30,),), "value": (((2,), 1.0), ((10,), 1e30))}, "beyond"),
    ],
)
def test_claims_beyond_the_arithmetic_are_refused_with_a_reason(changes: dict[str, Any], reason: str) -> None:
    found = line(**changes).check(threads=1)
    assert not found.proved
    assert reason in found.reason


def test_the_text_has_the_equations_and_rounds_towards_what_holds() -> None:
    sine = Function("sin", (1.0,), pi_halves=2)
    pendulum = ((DECAYS, Term(-9.8, (0,), (("mass", 1),), 0)),)
    start = Start("it starts anywhere", 0.33333333, ((Term(-1.0, (1,)),),))
    claim = line(
        functions=(sine,), drift=pendulum, parameters=(Parameter("mass", 1.0, 1.0),), starts=(start,),
        level=2 / 3, gamma=1 / 3,
    )  # fmt: skip
    text = theorem_text(claim, Verification(True, gradient_law=True))
    assert "d/dt x = -x - 9.8*mass*[sin(pi + x) - sin(pi)]" in text
    assert unnamed(text, "x = (-a)", "0 <= a <= 0.333333") == []
    assert "<= 0.666666" in text
    assert "0.666667" not in text
    assert f"gamma = {1 / 3!r}" in text
    assert unnamed(text.partition("Not proved")[2], "latency", "instant", "measurement") == []
    several = theorem_text(replace(claim, parameters=(Parameter("mass", 1.0, 2.0),)), Verification(True))
    assert unnamed(text, "each robot") == ["each robot"]
    assert unnamed(several, "each robot", "mass", "[1, 2]") == []


@pytest.mark.parametrize("decay", [0.0, 0.1])
@pytest.mark.parametrize("gradient", [False, True])
@pytest.mark.parametrize("starts", [(), (Start("at rest", 0.3, ((Term(-1.0, (1,)),),)),)])
def test_what_is_stated_is_numbered_without_gaps(
    decay: float, gradient: bool, starts: tuple[Start, ...]
) -> None:
    text = theorem_text(line(decay=decay, starts=starts), Verification(True, gradient_law=gradient))
    found = re.findall(r"^  (\d+)\. ([A-Z][a-z ]+): ", text, re.MULTILINE)
    names = [
        "Region",
        "Gain",
        "Convergence",
        *["Budget"] * gradient,
        *["Disturbances"] * bool(decay),
    ]
    assert [(number, name.split()[0]) for number, name in found] == [
        (str(i), name) for i, name in enumerate([*names, *["Starts"] * bool(starts)], 1)
    ]
    assert ("budget of 4." in text) == gradient


def test_equations_read_as_fractions_with_the_signals_that_drive_them() -> None:
    drift = (Term(-1.0, (1,), (("stiffness", 1), ("mass", -1), ("length", -2))), Term(2.0, (0,), (), 0))
    claim = line(
        drift=(drift,), functions=(Function("sin", (0.5,), 0.25, pi_halves=-1),),
        g1=(((Term(-1.0, (0,)),),),), g2=(((Term(1.0, (0,), (("mass", -1),)),),),),
        parameters=tuple(Parameter(name, 1.0, 1.0, "kg") for name in ("stiffness", "mass", "length")),
    )  # fmt: skip
    rate = "-stiffness*x/(mass*length^2) + 2*[sin(-pi/2 + 0.25 + 0.5*x) - sin(-pi/2 + 0.25)] - d + u/mass"
    assert f"d/dt x = {rate}\n" in theorem_text(claim, Verification(True))
