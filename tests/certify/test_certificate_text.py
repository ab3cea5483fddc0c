"""What the text of a certificate says is true: its inequalities hold along runs; what nothing checks stands apart."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.refusals import refused_with, unnamed

import flexhinf.certify.checker as checker
from flexhinf.certify import Certificate, Parameter, Signal, Start, Term, load_certificate
from flexhinf.certify.certificate import AUTHOR, theorem_parts, theorem_text
from flexhinf.errors import InvalidInput, NotDetectable, NotStabilisable

from .a_cubic import CUBIC

#: The cubic with its one parameter known, so that the budget is claimed too: V = x\u00b2/2, k = \u2212x, z = (x/2, u).
KNOWN = replace(CUBIC, parameters=(Parameter("softening", 0.5, 0.5, "N/m3"),), starts=())
SIGNALS: dict[str, Callable[[float], float]] = {
    "none": lambda t: 0.0,
    "a pulse": lambda t: 0.2 * (t < 1.0),
    "a negative pulse": lambda t: -0.15 * (0.5 < t < 2.0),
    "a sine": lambda t: 0.1 * np.sin(2.0 * t) * (t < 6.0),
    "a decay": lambda t: 0.25 * np.exp(-2.0 * t),
}


def energies(x0: float, d: Callable[[float], float], v: Callable[[float], float]) -> dict[str, float]:
    """Of a run of x\u2032 = x\u00b3/2 + u + d with u = \u2212x + v: what the printed inequality names."""

    def rates(t: float, y: np.ndarray) -> list[float]:
        x, u = y[0], -y[0] + v(t)
        return [0.5 * x**3 + u + d(t), 0.25 * x * x + u * u, d(t) ** 2, v(t) ** 2]

    run = solve_ivp(rates, (0.0, 20.0), [x0, 0.0, 0.0, 0.0], max_step=0.05, rtol=1e-9, atol=1e-12)
    return {
        "z": run.y[1, -1], "d": run.y[2, -1], "v": run.y[3, -1], "start": 0.5 * x0 * x0,
        "largest": float(np.max(0.5 * run.y[0] ** 2)),
    }  # fmt: skip


def bound(text: str, found: dict[str, float]) -> float:
    """The right side of a sentence's "(energy of z) <= \u2026", evaluated as it is printed."""
    said = re.search(r"\(energy of z\) <= (.*?2 V\(x\(0\)\))", text)
    assert said is not None, text
    expression = said[1]
    for words, value in (
        ("gamma^2 (energy of d)", KNOWN.gamma**2 * found["d"]),
        ("(integral of v'R2 v)", found["v"]),
        ("2 V(x(0))", 2.0 * found["start"]),
    ):
        expression = expression.replace(words, repr(float(value)))
    return sum(map(float, expression.split(" + ")))


def sentence(name: str) -> str:
    (text,) = (t for t in theorem_text(KNOWN, KNOWN.check(threads=1)).splitlines() if f". {name}: " in t)
    return text


@pytest.mark.quick_cases(5)
@pytest.mark.oracle
@pytest.mark.parametrize("v", SIGNALS)
@pytest.mark.parametrize("d", SIGNALS)
def test_the_printed_budget_holds_along_runs(d: str, v: str) -> None:
    for x0 in (0.0, 0.2):
        found = energies(x0, SIGNALS[d], SIGNALS[v])
        spent = found["start"] + 0.5 * KNOWN.gamma**2 * found["d"] + 0.5 * found["v"]
        if spent <= KNOWN.level:
            assert found["z"] <= bound(sentence("Budget"), found) * (1 + 1e-6) + 1e-9
            assert found["largest"] <= KNOWN.level
            if v == "none":
                assert found["z"] <= bound(sentence("Gain"), found) * (1 + 1e-6) + 1e-9
    if v == "a pulse" and d == "none":
        found = energies(0.0, SIGNALS[d], SIGNALS[v])
        assert found["z"] > 0.01  # from rest, without disturbance: the bound without v would be 0
        assert bound(sentence("Budget"), found) == pytest.approx(found["v"])


def test_one_budget_on_terminal_page_and_in_the_theorem(repository: Path) -> None:
    stated = KNOWN.stated
    terminal = sentence("Budget").partition("Budget: ")[2]
    assert terminal in next(t for t in dict(theorem_parts(KNOWN, stated))["Proved"] if "Budget" in t)
    shown = str(
        [s for s in import_module("flexhinf.pages.certificate")._theorem(KNOWN) if s.title == "Proved"]
    )
    assert unnamed(shown, "Budget", "γ²", "vᵀR2 v", "2 V(x(0))") == []
    said = "∫|z|² ≤ γ²∫|d|² + ∫vᵀR2v + 2V(x(0))"
    assert said in (repository / "docs" / "theorem.md").read_text(encoding="utf-8")


def test_what_its_author_says_is_no_hypothesis() -> None:
    lie = replace(
        CUBIC, about="every robot, any estimator", starts=(replace(CUBIC.starts[0], rule="from anywhere"),),
    )  # fmt: skip
    text = theorem_text(lie, lie.stated)
    before, heading, after = text.partition(f"\n{AUTHOR}\n")
    assert heading
    for words in ("every robot", "anywhere"):
        assert words not in before
        assert words in after
    parts = dict(theorem_parts(lie, lie.stated))
    assert any("anywhere" in one for one in parts[AUTHOR])
    assert all("anywhere" not in one for name, lines in parts.items() for one in lines if name != AUTHOR)
    assert (
        "anywhere"
        not in replace(lie, starts=(replace(lie.starts[0], amplitude=0.6),)).check(threads=1).reason
    )


def test_r2_v_and_the_law_are_printed_with_every_digit() -> None:
    third = replace(CUBIC, r2=((1 / 3,),), value=(((2,), 0.1 + 0.2),), law=((((1,), -2 / 3),),))
    text = theorem_text(third, third.stated)
    for line in (f"R2 = [{1 / 3!r}]", f"pull = -{2 / 3!r} position", f"V = {0.1 + 0.2!r} position^2"):
        assert f"    {line}\n" in text
    long = replace(CUBIC, states=(Signal("a"), Signal("b")), drift=((), ()), g1=(((),), ((),)), g2=(((),), ((),)),
                   value=tuple(((i, k - i), 1.5) for k in range(2, 11) for i in range(k + 1)), starts=(), parameters=(),
                   penalty=(), law=((((1, 0), 1.0),),), coordinates=((1.0, 0.0), (0.0, 1.0)))  # fmt: skip
    assert "V: 63 monomials" in theorem_text(long, long.stated)
    whole = dict(theorem_parts(long, long.stated))["Hypotheses"]
    (value,) = (one for one in whole if one.strip().startswith("V = "))
    assert value.count("1.5") == 63


@pytest.mark.oracle
def test_the_largest_input_is_a_bound_of_runs() -> None:
    """Of the cubic the bound is the start itself: u = \u2212x, and x falls."""
    found = CUBIC.check(threads=1)
    assert found.peaks == CUBIC.stated.peaks
    (peak,) = found.peaks
    assert 0.499 <= peak <= 0.499 * 1.002
    assert "Largest input" in theorem_text(CUBIC, found)
    start = Start(
        "", 0.3, ((Term(-1.0, (1,), (("softening", 1),)),),)
    )  # each plant its own: up to 0.3 at softening 1
    (peak,) = replace(CUBIC, starts=(start,)).stated.peaks
    assert 0.3 <= peak <= 0.3 * 1.002
    cubic_law = replace(CUBIC, law=((((1,), -1.0), ((3,), -0.1)),))
    quartic = replace(CUBIC, value=(((2,), 0.5), ((4,), 0.01)))
    assert replace(CUBIC, starts=()).stated.peaks == cubic_law.stated.peaks == quartic.stated.peaks == ()
    assert "Largest input" not in theorem_text(quartic, quartic.stated)


@pytest.mark.parametrize("place", ["states", "parameters", "drift", "starts", "path", "functions", "top"])
def test_a_key_that_nothing_reads_is_refused(place: str, tmp_path: Path) -> None:
    content = json.loads(CUBIC.text())
    content["functions"] = [{"name": "sin", "slope": ["0x1p+0"], "offset": "0x0p+0", "pi_halves": 0}]
    targets = {
        "states": content["states"][0], "parameters": content["parameters"][0], "drift": content["drift"][0][0],
        "starts": content["starts"][0], "path": content["starts"][0]["path"][0][0],
        "functions": content["functions"][0], "top": content,
    }  # fmt: skip
    file = tmp_path / "c.json"
    file.write_text(json.dumps(content), encoding="utf-8")
    load_certificate(file)
    targets[place]["only_where"] = "x < 0"
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InvalidInput, match="certificate") as caught:
        load_certificate(file)
    assert "only_where" in str(caught.value)


def _pendulum(gamma: float, level: float) -> Certificate:
    from .test_quadratic import LEVEL, upright

    sound = upright(level=LEVEL / 4)
    return replace(sound, gamma=gamma * sound.gamma, level=level * sound.level)


@pytest.mark.parametrize(("gamma", "level"), [(0.8, 1.0), (1.0, 40.0), (0.8, 10.0)])
def test_a_false_claim_of_quadratic_forms_is_refuted_at_a_corner(gamma: float, level: float) -> None:
    claim = _pendulum(gamma, level)
    claim = replace(claim, reach=claim.reach * level**0.5)
    found = claim.check(threads=1)
    assert not found.proved
    assert re.match("a corner .*: r > 0 .*angle = ", found.reason)
    assert found.cells == 0


def test_cells_after_a_corner_that_fails_have_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    from .test_quadratic import LEVEL, upright

    sound = upright(level=0.999 * LEVEL)  # a corner fails, and cells prove it
    assert sound.definite_corners() == 0
    assert sound.check(threads=1).proved
    monkeypatch.setattr(checker, "_MOST_AFTER_CORNERS", 10)
    found = sound.check(threads=1)
    assert not found.proved
    assert unnamed(found.reason, "corner", "undecided", "10 cells") == []


def test_a_corner_that_fails_is_named_with_its_parameters() -> None:
    from .test_checker import uncertain

    found = uncertain(0.2).check(threads=1)
    assert not found.proved
    named = re.search(r"[aA] corner.*\((\w+ = [0-9.]+[^,()]*(, )?)+\)", found.reason)
    assert named, found.reason


def test_a_region_beyond_the_reach_is_refused_without_cells() -> None:
    """V is a quadratic form, so how far {V <= c} goes is known; 100 million cells were looked at before."""
    from .test_quadratic import LEVEL, upright

    claim = upright(level=LEVEL / 4)
    found = replace(claim, reach=0.1 * claim.reach).check(threads=1, tick=_no_cells)
    assert not found.proved
    assert unnamed(found.reason, "level set", "reach", "angle =") == []


def _no_cells(cells: int) -> None:
    raise AssertionError


FARTHER = pytest.mark.ci("short pieces up to 64, as they are used")


@pytest.mark.parametrize(
    ("short", "farthest"),
    [(8, 20), pytest.param(64, 65, marks=FARTHER), pytest.param(64, 1000, marks=FARTHER)],
)
def test_the_quotient_of_a_sine_is_known_however_far_a_box_reaches(
    short: int, farthest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flint import fmpq

    from flexhinf.certify import Function
    from flexhinf.certify.checker import residual
    from flexhinf.certify.checker.residual import quotient_range

    monkeypatch.setattr(residual, "_NEAR", short)
    sine = Function("sin", (1.0,))
    near, far = quotient_range(sine, fmpq(6) ** 2), quotient_range(sine, fmpq(farthest) ** 2)
    assert far is not None
    assert near == far  # its ends are at 0 and at 4.49


@pytest.mark.ci("the pieces of 65 units")
def test_the_quotient_of_an_exponential_is_known_beyond_the_short_pieces() -> None:
    from flint import fmpq

    from flexhinf.certify import Function
    from flexhinf.certify.checker.residual import quotient_range

    exp = quotient_range(Function("exp", (1.0,)), fmpq(65) ** 2)
    assert exp is not None
    assert float(exp[1].p) / float(exp[1].q) >= (np.exp(65.0) - 1.0) / 65.0


def test_the_largest_level_of_a_weak_spring_is_a_number_whose_digits_are_printed() -> None:
    """x' = -10 x + 0.1 sin x: definite for all quotients of the sine, up to where the checker encloses them."""
    from flexhinf.certify import Function
    from flexhinf.certify.proof import _largest

    entry = ((Term(1.0, (0,)),),)
    weak = Certificate(
        "a weak spring", (Signal("x"),), (Signal("u"),), (Signal("d"),),
        drift=((Term(-10.0, (1,)), Term(0.1, (0,), (), 0)),), g1=(entry,), g2=(entry,), penalty=(),
        r2=((1.0,),), value=(((2,), 0.5),), law=((((1,), -1.0),),), gamma=10.0, level=1.0,
        coordinates=((1.0,),), reach=2.0, functions=(Function("sin", (1.0,)),),
    )  # fmt: skip
    found = _largest(weak)
    assert found.level > 1000.0
    assert type(found.level) is float
    assert "np." not in theorem_text(found, found.stated)


@pytest.mark.ci("looks for the largest level; its sibling of a weak spring is quick")
@pytest.mark.parametrize("share", [0.01, 0.25])
def test_the_largest_level_is_stated_whatever_level_was_asked_for(share: float) -> None:
    from flexhinf.certify.proof import _largest

    from .test_quadratic import LEVEL, upright

    found = _largest(upright(level=share * LEVEL))
    assert found.level >= share * LEVEL
    assert found.definite_corners()
    assert found.check(threads=1).proved
    more = replace(found, level=1.06 * found.level, reach=10.0 * found.reach)
    assert more.definite_corners() == 0


def test_a_mode_decays_however_slowly_it_does() -> None:
    """Out of the input's and of the sensors' reach, it needs no law and no gain; at 0 it would."""
    from flexhinf.estimation.stationary import check_detectable
    from flexhinf.hinf.linear_part import LinearPart

    for rate in (-1e-6, -1e-9, -1e-12, 0.0, 1e-9):
        a, b = np.diag([rate, -0.5]), np.array([[0.0], [1.0]])
        linear = LinearPart(a, b, b, np.array([[0.0, 1.0]]), ("slow", "fast"))
        if rate < 0.0:
            linear.check()
            check_detectable(a, b.T, ("slow", "fast"))
            continue
        with pytest.raises(NotStabilisable, match="'slow'"):
            linear.check()
        with pytest.raises(NotDetectable, match="slow"):
            check_detectable(a, b.T, ("slow", "fast"))
    for slow in (np.zeros((2, 2)), np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0, 1.0], [-4.0, 0.0]])):
        chain = np.zeros((3, 3))  # what does not decay: an integrator, a double one, an oscillation
        chain[:2, :2], chain[2, 2] = slow, -0.5
        turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
        unit = np.eye(3)[:, 2:]
        linear = LinearPart(turn @ chain @ turn.T, turn @ unit, turn @ unit, unit.T @ turn.T, ("a", "b", "c"))
        with pytest.raises(NotStabilisable):
            linear.check()


PROSE = (
    "every input whatever, also saturated,", "two words", "a=b", "a,b", "", "0", "2*mass", "mass^2", "-x", "joint-1.x",
    "m\u0430ss",  # the second letter is Cyrillic
)  # fmt: skip
UNITS = (
    "rad], proved for all robots and delays [rad",
    "kg, any",
    "N m",
    "rad\nProved",
    "x" * 21,
    "000",
    "*0",
    "^2",
)


def test_no_name_and_no_unit_can_be_read_as_a_part_of_the_theorem(tmp_path: Path) -> None:
    for name in PROSE:
        for made in (lambda: Signal(name), lambda: Parameter(name, 1.0, 2.0)):  # noqa: B023
            with pytest.raises(InvalidInput, match="name"):
                made()
    for unit in UNITS:
        for made in (lambda: Signal("a", unit), lambda: Parameter("a", 1.0, 2.0, unit)):  # noqa: B023
            with pytest.raises(InvalidInput, match="unit"):
                made()
    for unit in ("", "N·m·s/rad", "kg·m²", "µV^2", "rad/s³", "°", "m⁻¹", "1/s", "%"):
        assert Signal("link_position", unit).unit == unit
    path = tmp_path / "edited.json"
    text = CUBIC.text().replace(f'"name":"{CUBIC.inputs[0].name}"', f'"name":"{PROSE[0]}"')
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match="certificate") as caught:
        load_certificate(path)
    assert caught.value.found
    assert caught.value.advice


def test_a_name_stands_for_one_thing_in_the_whole_theorem(tmp_path: Path) -> None:
    """Old code printed a parameter that had the name of a state, or of a function, as if it were that."""
    (state,), (push,), (wind,) = CUBIC.states, CUBIC.inputs, CUBIC.disturbances
    for names in ({"states": (Signal("pi"),)}, {"inputs": (Signal("sin"),)}, {"states": (Signal("V"),)}):
        with refused_with(InvalidInput, "certificate", next(iter(names.values()))[0].name):
            replace(CUBIC, **names)
    for name in (state.name, push.name, wind.name, "cos", "a"):
        with refused_with(InvalidInput, "certificate", name):
            replace(CUBIC, parameters=(Parameter(name, 1.0, 1.0),))
    path = tmp_path / "renamed.json"
    path.write_text(CUBIC.text().replace(f'"name":"{state.name}"', '"name":"0"'), encoding="utf-8")
    with refused_with(InvalidInput, "renamed.json", "'0'"):
        load_certificate(path)


def test_rounding_of_the_penalty_is_no_part_of_a_claim() -> None:
    from flexhinf.certify.problem_to_claim import _without_rounding

    row = (((1, 0), 2.0), ((0, 1), -1.3e-16), ((0, 2), 1e-3))
    assert _without_rounding(row) == (row[0], row[2])
    assert _without_rounding(()) == ()
