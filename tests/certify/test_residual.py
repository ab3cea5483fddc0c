"""The checker's residual is r by its definition, in rationals, for plants with everything that a claim may have."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from flint import fmpq, fmpq_mat

from flexhinf.certify import Certificate, Function, Parameter, Signal, Term
from flexhinf.certify.checker.residual import (
    ExactResidual,
    as_rational,
    box_corners,
    positive_definite,
    rounded,
)

from .definition import Definition
from .test_checker import LEVEL, uncertain, upright

quadratic = import_module("flexhinf.certify.checker.residual")

pytestmark = pytest.mark.oracle


def drawn(seed: int, **changes: Any) -> Certificate:
    """Three states, two inputs and disturbances, three functions, five parameters; no theorem, only algebra."""
    rng = np.random.default_rng(seed)

    def number() -> float:
        return float(rng.integers(-40, 41)) / 16.0 or 0.5

    def powers(lowest: int, highest: int) -> tuple[int, int, int]:
        while True:
            e = tuple(map(int, rng.integers(0, 3, 3)))
            if lowest <= sum(e) <= highest:
                return e

    def polynomial(lowest: int, highest: int, count: int) -> Any:
        return tuple((e, number()) for e in {powers(lowest, highest) for _ in range(count)})

    pairs = (("mass", -1), ("length", 2), ("fixed", -2), ("unused", 0), ("drag", 1))

    def term(lowest: int, function: int | None) -> Term:
        used = tuple(pair for pair in pairs if rng.uniform() < 0.4)
        return Term(number(), powers(0 if function is not None else lowest, 2), used, function)

    drift = tuple((term(1, None), term(1, None), term(1, int(rng.integers(3)))) for _ in range(3))
    entries = [tuple(tuple((term(0, None),) for _ in range(2)) for _ in range(3)) for _ in range(2)]
    given: dict[str, Any] = {
        "about": "drawn", "states": tuple(map(Signal, "abc")), "inputs": (Signal("u"), Signal("v")),
        "disturbances": (Signal("d"), Signal("w")), "drift": drift, "g1": entries[0], "g2": entries[1],
        "penalty": (polynomial(1, 2, 2), polynomial(1, 2, 3)), "r2": ((2.0, 0.5), (0.5, 1.5)),
        "value": polynomial(2, 4, 6), "law": (polynomial(1, 3, 3), polynomial(1, 3, 3)),
        "gamma": 1.75, "decay": 0.375, "level": 1.0, "reach": 2.0,
        "coordinates": ((1.0, 0.5, 0.0), (-0.25, 1.0, 0.75), (0.0, 0.5, 2.0)),
        "functions": (
            Function("sin", (1.0, -0.5, 0.0)), Function("exp", (0.0, 0.25, 1.0)), Function("tanh", (0.5, 0.0, 2.0)),
        ),
        "parameters": (
            Parameter("mass", 0.5, 1.25), Parameter("length", 0.75, 1.5), Parameter("fixed", 1.5, 1.5),
            Parameter("unused", 0.0, 3.0), Parameter("drag", -0.5, 0.25),
        ),
    }  # fmt: skip
    return Certificate(**{**given, **changes})


def evaluated(polynomial: Any, z: list[fmpq]) -> fmpq:
    total = fmpq(0)
    for powers, value in polynomial.to_dict().items():
        for number, e in zip(z, powers):
            value = value * number ** int(e)
        total += value
    return total


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize("seed", range(8))
def test_the_residual_is_its_definition(seed: int) -> None:
    """At rational places, parameters and quotients: with S_j ℓ_jᵀx for each function, all is a polynomial."""
    claim = drawn(seed)
    exact = ExactResidual(claim)
    assert len(exact.factors) == len(exact.arguments) == 3
    rng = np.random.default_rng(100 + seed)
    for _ in range(3):
        z, quotients = ([fmpq(int(a), 7) for a in rng.integers(-9, 10, 3)] for _ in range(2))
        at = {p.name: fmpq(int(rng.integers(3, 9)), 6) for p in claim.parameters} | {"fixed": fmpq(3, 2)}
        x = [sum((as_rational(a) * b for a, b in zip(row, z)), fmpq(0)) for row in claim.coordinates]

        def bracket(claim: Certificate, number: int, x: list[Any], quotients: Any = quotients) -> Any:
            slope = claim.functions[number].slope
            return quotients[number] * sum((as_rational(a) * b for a, b in zip(slope, x)), fmpq(0))

        defined = Definition(claim, x, at, as_rational, bracket)
        expected = defined_residual(defined, claim)
        found = fmpq(0)
        for product, plain, row in zip(
            exact.products, exact.plain, zip(*exact.factors, strict=True), strict=True
        ):
            weight = fmpq(1)
            for name, exponent in product:
                weight *= at[name] ** exponent
            found += weight * evaluated(plain, z)
            found += weight * sum((s * evaluated(b, z) for s, b in zip(quotients, row, strict=True)), fmpq(0))
        assert found == expected
        assert evaluated(exact.value, z) == defined.value()
        for argument, function in zip(exact.arguments, claim.functions, strict=True):
            assert evaluated(argument, z) == sum(
                (as_rational(a) * b for a, b in zip(function.slope, x)), fmpq(0)
            )


def defined_residual(at: Definition, claim: Certificate) -> fmpq:
    """V_x (f + g2 k) + ½ |h|² + ½ kᵀR2k + |V_x g1|²/(2γ²) + αV, with differences for V_x that are exact."""
    slope = [_slope(at, claim, i) for i in range(3)]
    law, half = [at.polynomial(k) for k in claim.law], fmpq(1, 2)
    f = [at.terms(row) for row in claim.drift]
    g1, g2 = ([[at.terms(entry) for entry in row] for row in g] for g in (claim.g1, claim.g2))
    r = as_rational(claim.decay) * at.value()
    for i in range(3):
        r += slope[i] * (f[i] + sum((g2[i][j] * law[j] for j in range(2)), fmpq(0)))
    r += half * sum((at.polynomial(h) ** 2 for h in claim.penalty), fmpq(0))
    r += half * sum(
        (law[i] * as_rational(claim.r2[i][j]) * law[j] for i in range(2) for j in range(2)), fmpq(0)
    )
    for j in range(2):
        r += sum((slope[i] * g1[i][j] for i in range(3)), fmpq(0)) ** 2 / (2 * as_rational(claim.gamma) ** 2)
    return r


def _slope(at: Definition, claim: Certificate, i: int) -> fmpq:
    total = fmpq(0)
    for powers, value in claim.value:
        part = as_rational(value) * powers[i]
        for j, e in enumerate(powers):
            part *= at.x[j] ** (e - (i == j)) if e - (i == j) >= 0 else 0
        total += part
    return total


@pytest.mark.parametrize("seed", range(4))
def test_corners_are_all_ends_and_the_zero_between(seed: int) -> None:
    claim = drawn(seed)
    exact = ExactResidual(claim)
    used = {name for product in exact.products for name, _ in product}
    ends = {"mass": (0.5, 1.25), "length": (0.75, 1.5), "drag": (-0.5, 0.0, 0.25)}
    assert used == set(ends)  # of the drawn plants; a known parameter is a number
    expected = set()
    for m in ends["mass"]:
        for l in ends["length"]:
            for d in ends["drag"]:
                at = {"mass": as_rational(m), "length": as_rational(l), "drag": as_rational(d)}
                row = []
                for product in exact.products:
                    weight = fmpq(1)
                    for name, exponent in product:
                        weight *= at[name] ** exponent
                    row.append(weight)
                expected.add(tuple(map(str, row)))
    assert {tuple(map(str, row)) for _, row in box_corners(claim, exact.products)} == expected
    touching = replace(claim, parameters=(*claim.parameters[:-1], Parameter("drag", 0.0, 0.25)))
    assert len(box_corners(touching, ExactResidual(touching).products)) == 8
    beyond = replace(claim, parameters=(*claim.parameters[:-1], Parameter("drag", 0.125, 0.25)))
    assert len(box_corners(beyond, ExactResidual(beyond).products)) == 8


def test_the_gradient_law_is_told_from_others() -> None:
    """R2 k = −g2ᵀV_xᵀ, up to 1e-12 of the largest coefficient of each degree, with a known g2."""
    sound = upright()
    assert ExactResidual(sound).gradient_law
    (law,) = sound.law
    for share, expected in ((1e-13, True), (-1e-13, True), (1e-11, False), (-1e-11, False)):
        for number in range(2):
            moved = tuple((e, v * (1 + share * (i == number))) for i, (e, v) in enumerate(law))
            largest = max(abs(v) for _, v in law)
            judged = abs(law[number][1] * share) <= 1e-12 * largest
            assert judged == expected
            assert ExactResidual(replace(sound, law=(moved,))).gradient_law == expected
    for extra in (1e-14, -1e-14):  # of a degree that the gradient does not have
        assert not ExactResidual(replace(sound, law=((*law, ((0, 3), extra)),))).gradient_law
    assert not ExactResidual(uncertain(0.04)).gradient_law
    one, half = Term(1.0, (0, 0)), Term(0.5, (0, 0))
    two = replace(
        sound, inputs=(Signal("torque"), Signal("second")),
        g2=(((), ()), ((one,), (half,))), r2=((1.0, 0.0), (0.0, 2.0)),
        law=(law, tuple((e, v / 4) for e, v in law)),
    )  # fmt: skip
    assert ExactResidual(two).gradient_law
    for wrong in ((law, law), (tuple((e, v / 2) for e, v in law), two.law[1])):
        assert not ExactResidual(replace(two, law=wrong)).gradient_law
    halved = Parameter("known", 0.5, 0.5)
    known = replace(two, parameters=(halved,), g2=(((), ()), ((one,), (Term(1.0, (0, 0), (("known", 1),)),))))
    assert ExactResidual(known).gradient_law
    unknown = replace(known, parameters=(Parameter("known", 0.5, 0.51),))
    assert not ExactResidual(unknown).gradient_law


def test_a_small_law_is_the_gradient_s_to_its_own_twelve_digits() -> None:
    sound = upright()
    small = replace(
        sound, value=tuple((e, 1e-9 * v) for e, v in sound.value), law=(tuple((e, 1e-9 * v) for e, v in sound.law[0]),)
    )  # fmt: skip
    assert ExactResidual(small).gradient_law
    moved = tuple((e, v * (1 + 1e-9 * (i == 0))) for i, (e, v) in enumerate(small.law[0]))
    assert not ExactResidual(replace(small, law=(moved,))).gradient_law


def test_more_corners_than_are_looked_at_prove_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    sound = upright(level=LEVEL / 4)
    for most, corners in ((2, 2), (1, 0)):
        monkeypatch.setattr(quadratic, "_MOST_CORNERS", most)
        assert sound.definite_corners() == corners
        assert quadratic.look_at_corners(sound, ExactResidual(sound)) == (corners, [])


def test_definite_matrices_are_told_from_singular_ones() -> None:
    def matrix(*rows: tuple[int, ...]) -> fmpq_mat:
        return fmpq_mat([[fmpq(v) for v in row] for row in rows])

    assert positive_definite(matrix((2, 1), (1, 1)))
    assert not positive_definite(matrix((1, 1), (1, 1)))
    assert not positive_definite(matrix((0, 0), (0, 1)))
    assert not positive_definite(matrix((-1, 0), (0, -1)))
    assert not positive_definite(matrix((1, 0, 0), (0, 1, 0), (0, 0, -1)))
    assert not positive_definite(matrix((1, 2, 0), (2, 1, 0), (0, 0, -1)))


def test_rationals_are_the_doubles_and_back() -> None:
    for value in (0.1, -3.0, 2.0**-1074, 1e300):
        assert rounded(as_rational(value)) == value
    assert rounded(fmpq(1, 3)) == 1 / 3


def test_the_reach_holds_all_of_the_level_set_or_nothing_is_said() -> None:
    """The largest |z_i| where V ≤ c is (c (W⁻¹)_ii)^½ for V = zᵀWz: just below it nothing is said, just above it is."""
    claim = upright(level=LEVEL / 4)
    value = ExactResidual(claim).value.to_dict()
    w = np.zeros((2, 2))
    for powers, c in value.items():
        i, j = (k for k, e in enumerate(powers) for _ in range(int(e)))
        w[i, j] += float(c.p) / float(c.q) / 2
        w[j, i] += float(c.p) / float(c.q) / 2
    widest = float(np.sqrt(claim.level * np.linalg.inv(w).diagonal().max()))
    for share, corners in ((0.9999, 0), (1.0001, 2)):
        moved = replace(claim, reach=share * widest)
        assert moved.definite_corners() == corners
