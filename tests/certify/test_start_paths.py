"""Paths of starts: V along them in balls against V in doubles, and the amplitude up to which they are inside."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx

from flexhinf.certify import Certificate, Function, Parameter, Signal, Start, Term
from flexhinf.certify.checker import statements as starts
from flexhinf.certify.checker.residual import Refusal, as_rational
from flexhinf.certify.checker.statements import check_start, proved_peaks
from flexhinf.certify.claim import Observer

pytestmark = pytest.mark.oracle

VALUE = (((2, 0), 1.5), ((1, 1), -0.5), ((0, 2), 1.0))
PATH = (
    (Term(-1.0, (1,), (("mass", -1),)), Term(0.25, (2,))),
    (Term(0.5, (1,), (("load", 2),), 0), Term(-0.3, (0,), (("mass", 1),), 1)),
)
START = Start("from rest", 1.5, PATH, (Function("sin", (0.8,), 0.2, 1), Function("exp", (-0.5,), 0.3)))


def claim(value: Any = VALUE, **changes: Any) -> Certificate:
    """Two states; only V, its level and the parameters matter here."""
    fields: dict[str, Any] = {
        "about": "starts", "states": (Signal("a"), Signal("b")), "inputs": (Signal("u"),),
        "disturbances": (Signal("d"),), "drift": ((), ()), "g1": (((),), ((),)), "g2": (((),), ((),)),
        "penalty": (), "r2": ((1.0,),), "value": value, "law": ((),), "gamma": 1.0, "level": 1.0,
        "coordinates": ((1.0, 0.0), (0.0, 1.0)), "reach": 5.0,
        "parameters": (Parameter("mass", 0.8, 1.25), Parameter("load", 0.5, 2.0), Parameter("other", 1.0, 2.0)),
    }  # fmt: skip
    return Certificate(**{**fields, **changes})


def at(start: Start, a: float, values: dict[str, float]) -> np.ndarray:
    """x(a) in doubles."""
    x = []
    for i, row in enumerate(start.path):
        total = 0.0
        for term in row:
            factor = term.coefficient * a ** term.powers[0]
            for name, exponent in term.parameters:
                factor *= values[name] ** exponent
            if term.function is not None:
                f = start.functions[term.function]
                o = f.offset + f.pi_halves * np.pi / 2
                factor *= getattr(np, f.name)(o + f.slope[0] * a) - getattr(np, f.name)(o)
            total += factor
        if start.table and start.table[i]:
            total += np.interp(a, start.amplitudes, start.table[i])
        x.append(total)
    return np.array(x)


def value_at(given: Any, x: np.ndarray) -> float:
    return float(sum(c * x[0] ** e[0] * x[1] ** e[1] for e, c in given))


def largest_value(start: Start, boxes: dict[str, tuple[float, ...]], value: Any = VALUE) -> float:
    """Of V on the path, for parameters at these values."""
    import itertools

    found = 0.0
    for corner in itertools.product(*boxes.values()):
        values = dict(zip(boxes, corner, strict=True))
        grid = np.linspace(0.0, start.amplitude, 400)
        found = max(found, *(value_at(value, at(start, float(a), values)) for a in grid))
    return found


@pytest.mark.parametrize("about", [0.0, 0.3, 1.1])
def test_a_path_and_v_on_it_are_power_series(about: float) -> None:
    values = {"mass": 0.9, "load": 1.6}
    table = Start("table", 1.5, PATH, START.functions, (0.0, 0.5, 1.5), ((0.0, 0.2, -0.4), ()))
    for start, piece in ((START, 0), (table, int(about >= 0.5))):
        with ctx.workprec(128):
            ball = {name: arb(v) for name, v in values.items()}
            x = starts._path(start, piece, arb(about), ball, 2)
            v = starts._value(claim(), x)
        step = 1e-5
        after, before = (at(start, about + s, values) if about + s > 0 else None for s in (step, -step))
        here = at(start, about, values)
        for i in range(2):
            assert float(x[i][0]) == pytest.approx(here[i], abs=1e-13)
        forward = (after - (before if before is not None else here)) / (
            step * (2 if before is not None else 1)
        )
        for i in range(2):
            assert float(x[i][1]) == pytest.approx(forward[i], abs=2e-5)
        assert float(v[0]) == pytest.approx(value_at(VALUE, here), abs=1e-12)
        gradient = np.array([3.0 * here[0] - 0.5 * here[1], -0.5 * here[0] + 2.0 * here[1]])
        assert float(v[1]) == pytest.approx(gradient @ [float(x[0][1]), float(x[1][1])], abs=1e-12)


def test_an_interval_holds_v_at_both_ends_and_little_more() -> None:
    values = {"mass": 0.9, "load": 1.6}
    for left, right in ((0.0, 0.1), (0.7, 0.9), (1.2, 1.5), (0.7, 0.701), (1.3, 1.3001)):
        with ctx.workprec(128):
            ball = {name: arb(v) for name, v in values.items()}
            ends = [as_rational(a) for a in (left, right)]
            for path in (START, replace(START, path=PATH[::-1])):
                for sign in (1.0, -1.0):  # V grows along the path, or falls
                    given = claim(tuple((e, sign * v) for e, v in VALUE))
                    center, whole = starts.enclosed_value(given, path, 0, *ends, ball)
                    exact = [value_at(given.value, at(path, a, values)) for a in (left, right)]
                    middle = value_at(given.value, at(path, (left + right) / 2, values))
                    assert float(center) == pytest.approx(middle, abs=1e-12)
                    assert float(whole.lower()) <= min(exact) + 1e-12
                    assert float(whole.upper()) >= max(exact) - 1e-12
                    assert float(whole.rad()) <= 1.5 * abs(exact[1] - exact[0]) + 2.0 * (right - left) ** 2


def test_v_of_higher_degree_is_its_polynomial() -> None:
    value = (((4, 0), 0.5), ((3, 1), -1.0), ((0, 2), 2.0), ((1, 3), 0.25))
    with ctx.workprec(128):
        x = starts._path(START, 0, arb(0.7), {"mass": arb(1), "load": arb(1)}, 1)
        found = starts._value(claim(value), x)[0]
    expected = value_at(value, at(START, 0.7, {"mass": 1.0, "load": 1.0}))
    assert float(found) == pytest.approx(expected, rel=1e-12)


ENDS = {"mass": (0.8, 1.25), "load": (0.5, 2.0)}


def affine(**changes: Any) -> Start:
    """Affine in mass⁻¹ and in load²."""
    path = ((Term(-1.0, (1,), (("mass", -1),)),), (Term(0.5, (1,), (("load", 2),), 0),))
    return replace(replace(START, path=path), **changes)


def outcome(given: Certificate, start: Start) -> int:
    """How many intervals were shown, or 0."""
    try:
        return check_start(given, start)
    except Refusal:
        return 0


def test_starts_are_inside_up_to_the_largest_v_at_a_corner() -> None:
    largest = largest_value(affine(), ENDS)
    assert outcome(claim(level=largest * 1.001), affine()) >= 4 * 16
    assert outcome(claim(level=largest * 0.999), affine()) == 0
    paid = claim(level=2.0 * largest, feedback="output injection observer", observer=_paying(0.99 * largest))
    assert outcome(paid, affine()) >= 4 * 16
    dear = replace(paid, observer=_paying(1.01 * largest))
    assert outcome(dear, affine()) == 0


def _paying(energy: float) -> Observer:
    unit = ((1.0, 0.0), (0.0, 1.0))
    return Observer(((1.0, 0.0),), (), ((1.0,), (1.0,)), unit, unit, 0.0, energy)


def test_a_box_is_looked_at_by_its_corners_where_that_is_enough_and_whole_elsewhere() -> None:
    def looked(given: Certificate, start: Start) -> list[dict[str, Any]]:
        with ctx.workprec(128):
            found = starts.parameter_values(given, start)
        return [{name: (float(v.lower()), float(v.upper())) for name, v in one.items()} for one in found]

    def point(v: float) -> Any:
        return pytest.approx((v, v), abs=1e-12)

    def whole(low: float, high: float) -> Any:
        return pytest.approx((low, high), abs=1e-6)

    corners = [{"mass": point(m), "load": point(l)} for m in ENDS["mass"] for l in ENDS["load"]]
    assert looked(claim(), affine()) == corners
    balls = [{"mass": whole(0.8, 1.25), "load": whole(0.5, 2.0)}]
    assert looked(claim(), START) == balls  # mass with two exponents
    assert looked(claim((*VALUE, ((4, 0), 1.0))), affine()) == balls
    for low, high in ((-0.5, 2.0), (0.0, 2.0), (-2.0, 0.0)):
        spanning = (Parameter("mass", 0.8, 1.25), Parameter("load", low, high))
        assert looked(claim(parameters=spanning), affine()) == [
            {"mass": whole(0.8, 1.25), "load": whole(low, high)}
        ]
    negative = (Parameter("mass", 0.8, 1.25), Parameter("load", -2.0, -0.5))
    assert len(looked(claim(parameters=negative), affine())) == 4
    known = (Parameter("mass", 1.0, 1.0), Parameter("load", 0.5, 2.0))
    assert len(looked(claim(parameters=known), affine())) == 2
    none = replace(affine(), path=((Term(1.0, (1,), (("mass", 0),)),), ()))
    assert looked(claim(), none) == [{}]


def test_a_table_is_interpolated_between_its_knots() -> None:
    """V = x1² + x2² with x = (a, table(a)): a peak between the ends of the path, at a knot of its own."""
    value = (((2, 0), 1.0), ((0, 2), 1.0))
    path = ((Term(1.0, (1,)),), ())
    knots, table = (0.0, 0.25, 0.5, 0.75), ((), (0.0, -0.1, 0.9, 0.0))
    start = Start("with integrators", 0.75, path, (), knots, table)
    largest = 0.5**2 + 0.9**2
    assert outcome(claim(value, level=largest * 1.001), start) >= 3 * 16
    assert outcome(claim(value, level=largest * 0.999), start) == 0
    inside = replace(start, amplitude=0.5, amplitudes=knots[:3], table=((), table[1][:3]))
    assert outcome(claim(value, level=largest * 1.001), inside) >= 2 * 16
    assert outcome(claim(value, level=largest * 0.999), inside) == 0


def test_a_start_on_the_boundary_takes_halvings_and_one_beyond_is_refused() -> None:
    """V = x² with x = a: equal to the level at the end alone, which rationals decide."""
    value = (((2, 0), 1.0), ((0, 2), 1.0))
    start = Start("at rest", 1.0, ((Term(1.0, (1,)),), ()))
    generous = outcome(claim(value, level=4.0), start)
    assert generous == 16
    tight = outcome(claim(value, level=1.0 + 1e-9), start)
    assert 16 < tight < 100
    with pytest.raises(Refusal, match=r"amplitude 0\.9\d+.* path 1\b"):
        check_start(claim(value, level=0.95), start)


def test_a_peak_far_from_the_middles_of_intervals_is_not_passed_by() -> None:
    """x = 0.2 a + sin(40 a)/3: V has many peaks, each of which counts."""
    value = (((2, 0), 1.0), ((0, 2), 1.0))
    path = ((Term(0.2, (1,)), Term(1 / 3, (0,), (), 0)), ())
    start = Start("wavy", 1.0, path, (Function("sin", (40.0,)),))
    grid = np.linspace(0.0, 1.0, 200_001)
    largest = float(((0.2 * grid + np.sin(40 * grid) / 3) ** 2).max())
    assert outcome(claim(value, level=largest * 1.0001), start) > 16
    assert outcome(claim(value, level=largest * 0.9999), start) == 0


# The largest input ----------------------------------------------------------------------------------------------------
LAW = ((((1, 0), 2.0), ((0, 1), -3.0)), (((0, 1), 0.5),))


def two_inputs(**changes: Any) -> Certificate:
    given: dict[str, Any] = {
        "inputs": (Signal("u"), Signal("v")), "g2": (((), ()), ((), ())), "r2": ((1.0, 0.0), (0.0, 1.0)), "law": LAW,
        "starts": (affine(), affine(amplitude=0.75, path=affine().path[::-1])),
    }  # fmt: skip
    return claim(**{**given, **changes})


def test_the_largest_input_is_bounded_by_v_at_the_starts_and_not_by_much_more() -> None:
    """|K_i x| ≤ (K_i W⁻¹ K_iᵀ V)^½, attained somewhere on {V = c₀}."""
    given = two_inputs()
    largest = max(largest_value(start, ENDS) for start in given.starts)
    w = np.array([[1.5, -0.25], [-0.25, 1.0]])
    found = proved_peaks(given)
    for row, bound in zip(([2.0, -3.0], [0.0, 0.5]), found, strict=True):
        exact = float(np.sqrt(np.array(row) @ np.linalg.inv(w) @ np.array(row) * largest))
        assert exact * (1 - 1e-9) <= bound <= exact * 1.0011
    turned = replace(given, starts=given.starts[::-1])
    assert proved_peaks(turned) == pytest.approx(found, rel=1e-3)
    assert proved_peaks(replace(given, starts=given.starts[1:]))[0] < 0.9 * found[0]


def test_a_peak_of_v_between_knots_counts_for_the_input() -> None:
    value = (((2, 0), 1.0), ((0, 2), 1.0))
    start = Start(
        "table", 0.75, ((Term(1.0, (1,)),), ()), (), (0.0, 0.25, 0.5, 0.75), ((), (0.0, -0.1, 0.9, 0.0))
    )
    (first, second) = proved_peaks(two_inputs(value=value, starts=(start,)))
    largest = 0.5**2 + 0.9**2
    assert np.sqrt(13.0 * largest) * (1 - 1e-9) <= first <= np.sqrt(13.0 * largest) * 1.0011
    assert np.sqrt(0.25 * largest) * (1 - 1e-9) <= second <= np.sqrt(0.25 * largest) * 1.0011


def test_no_input_is_bounded_where_the_law_or_v_is_of_another_kind() -> None:
    given = two_inputs()
    assert len(proved_peaks(given)) == 2
    assert proved_peaks(replace(given, starts=())) == ()
    assert proved_peaks(replace(given, law=(LAW[0], (((0, 1), 0.5), ((0, 3), 0.1))))) == ()
    assert proved_peaks(replace(given, value=(*VALUE, ((0, 4), 0.1)))) == ()
    for indefinite in ((((2, 0), 1.0), ((0, 2), -1.0)), (((2, 0), 1.0), ((1, 1), 2.0), ((0, 2), 1.0))):
        assert proved_peaks(replace(given, value=indefinite)) == ()


def test_a_search_that_ends_early_gives_a_larger_bound_and_not_a_smaller_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    close = proved_peaks(two_inputs())
    monkeypatch.setattr(starts, "_PEAK_HALVINGS", 0)
    assert all(a >= b * (1 - 1e-3) for a, b in zip(proved_peaks(two_inputs()), close, strict=True))


def test_an_input_that_is_attained_is_not_above_its_bound() -> None:
    """x1 stands at 1 along a piece of its table, where V = x1² + x2² has no slope: |u| = 3 there."""
    value = (((2, 0), 1.0), ((0, 2), 1.0))
    start = Start("table", 2.0, ((), ()), (), (0.0, 1.0, 2.0), ((0.0, 1.0, 1.0), ()))
    law = ((((1, 0), 3.0),), (((1, 0), 1.0), ((0, 1), 1.0)))
    (first, second) = proved_peaks(two_inputs(value=value, starts=(start,), law=law))
    assert 3.0 <= first <= 3.0 * 1.0011
    assert Fraction(second) ** 2 >= 2


def test_a_peak_within_the_first_unit_of_a_path_counts_for_the_input() -> None:
    value = (((2, 0), 1.0), ((0, 2), 1.0))
    path = ((Term(1 / 3, (0,), (), 0),), ())
    short = Start("there and back", 0.9, path, (Function("sin", (3.0,)),))  # 1/3 at a = π/6; at the end 0.14
    assert proved_peaks(two_inputs(value=value, starts=(short,)))[0] >= np.sqrt(4.0) / 3 * (1 - 1e-9)
    largest = 1 / 9
    assert outcome(claim(value, level=largest * 1.001), short) >= 16
    assert outcome(claim(value, level=largest * 0.999), short) == 0
