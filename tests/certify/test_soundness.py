"""Bounds are bounds, and what is not true is not proved."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from flint import fmpq

import flexhinf as fh
from flexhinf.certify import Certificate, Signal, Term
from flexhinf.certify.cells import CellBounds, cells_of, search
from flexhinf.certify.inequality import Inequality
from flexhinf.certify.problem_to_claim import nearest_double, rational, statement_of
from flexhinf.certify.proof import prove
from flexhinf.errors import InvalidInput, NumericalFailure

PENALTY = (60.0, 0.0, 0.0, 0.0, 300.0)


def arm_statement(goal: float, degree: int) -> tuple[fh.HJISolution, Certificate]:
    problem = fh.paper_arm().problem(fh.Penalty((75.0, 27.0, 90.0, 27.0, 330.0), effort=10.0), pose=(goal,))
    star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * star, degree=degree)
    return solution, statement_of(solution, 1.6 * star, PENALTY)


def random_cells(bounds: CellBounds, count: int, rng: np.random.Generator) -> np.recarray:
    """Dyadic cells of all sizes, some at the centre and some at the reach."""
    d = bounds.n - 1
    h = np.exp2(-rng.integers(0, 12, (count, d)).astype(float))
    t = np.round(rng.uniform(-1, 1, (count, d)) * (1 / h - 1)) * h
    length = np.exp2(-rng.integers(1, 15, count).astype(float))
    inner = np.floor(rng.uniform(0, 1, count) * (1 / length - 1)) * length
    inner[: count // 10] = 0.0
    return cells_of(rng.integers(0, len(bounds.faces), count), t, h, inner, inner + length)


def points_in(
    bounds: CellBounds, cells: np.recarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """One point z of each cell, often on its boundary, and its radius."""
    corner = rng.uniform(-1.3, 1.3, cells.t.shape).clip(-1, 1)
    share = rng.uniform(-0.3, 1.3, len(cells)).clip(0, 1)
    radius = bounds.reach * (cells.inner + (cells.outer - cells.inner) * share)
    directions = cells.t + corner * cells.h
    z = np.empty((len(cells), bounds.n))
    for i, face in enumerate(cells.face):
        variable, sign = bounds.faces[face]
        z[i] = np.insert(directions[i], variable, sign) * radius[i]
    return z, radius


@pytest.mark.parametrize(("goal", "degree", "cells", "points"), [(1.3, 4, 2500, 4)])
def test_no_point_of_a_random_cell_exceeds_its_bounds(
    goal: float, degree: int, cells: int, points: int
) -> None:
    check_bounds(goal, degree, cells, points)


@pytest.mark.ci("100,000 points for each of three poses")
@pytest.mark.parametrize("goal", [np.pi / 2, np.pi, 0.7])
def test_no_point_of_many_random_cells_exceeds_its_bounds(goal: float) -> None:
    check_bounds(goal, 6, 5000, 20)


def check_bounds(goal: float, degree: int, count: int, points: int) -> None:
    solution, statement = arm_statement(goal, degree)
    bounds = CellBounds(Inequality(statement), 440.0, [8.0])
    rng = np.random.default_rng(0)
    cells = random_cells(bounds, count, rng)
    found = bounds.bound(cells, math.inf)
    inside = bounds.bound(cells, 2e4)
    transform, checked = np.array(statement.coordinates), np.diag(PENALTY)
    for _ in range(points):
        z, radius = points_in(bounds, cells, rng)
        seen = radius > 0
        x = z[seen] @ transform.T
        f, g1, g2, _ = solution.exact_fields(x)
        slope, square = solution.gradient(x), radius[seen] ** 2
        terms = solution.hamiltonian_terms(slope, (f, g1, g2, x @ checked), statement.gamma)
        rounding = 1e-12 * np.abs(terms).sum(0) / square + 1e-13 * np.abs(slope * x).sum(1) / square
        r, value = terms.sum(0) / square, solution.value(x)
        assert (r <= found.upper[seen] + rounding).all()
        assert (r <= inside.upper_inside[seen] + rounding)[value <= 2e4].all()
        assert ((slope * x).sum(1) / square >= found.growth[seen] - rounding).all()
        first = x * (bounds.reach * cells.inner[seen] / radius[seen])[:, None]
        assert (solution.value(first) >= found.least_value[seen] - 1e-12 * np.abs(value)).all()


# Rounding -----------------------------------------------------------------------------------------
def exact_upper(inequality: Inequality, bounds: CellBounds, cells: np.recarray, place: int) -> fmpq:
    """What `upper` bounds before the allowance, for two polynomial states, without any rounding."""
    variable, sign = bounds.faces[cells.face[place]]
    t, h = rational(cells.t[place, 0]), rational(cells.h[place, 0])
    inner, outer = (rational(e[place] * bounds.reach) for e in (cells.inner, cells.outer))
    middle, half = (inner + outer) / 2, (outer - inner) / 2
    moved: dict[tuple[int, int], fmpq] = {}
    for key, value in inequality.polynomial.items():
        k, power = sum(key), key[1 - variable]
        value = rational(nearest_double(value)) * sign ** key[variable]
        for b in range(power + 1):
            c = value * math.comb(power, b) * t ** (power - b) * h**b
            moved[k, b] = moved.get((k, b), fmpq(0)) + c
    total = fmpq(0)
    for b in range(max(key[1] for key in moved) + 1):
        mine = {k - 2: c for (k, power), c in moved.items() if power == b}
        if b > 3:
            value = sum((c * middle**p for p, c in mine.items()), fmpq(0))
            total += max(value, fmpq(0)) if b % 2 == 0 else abs(value)
            total += sum((abs(c) * (outer**p - middle**p) for p, c in mine.items()), fmpq(0))
            continue
        for q in range(max(mine) + 1):
            rows = ((c, p) for p, c in mine.items() if p >= q)
            value = sum((c * math.comb(p, q) * middle ** (p - q) * half**q for c, p in rows), fmpq(0))
            even = b % 2 == 0 and q % 2 == 0
            total += value if b == q == 0 else max(value, fmpq(0)) if even else abs(value)
    return total


def test_rounding_stays_far_within_its_allowance() -> None:
    statement = statement_of(oscillator(6), None, None)
    inequality = Inequality(statement)
    bounds = CellBounds(inequality, 3.0, [])
    cells = random_cells(bounds, 80, np.random.default_rng(1))
    found = bounds.bound(cells, math.inf)
    for place in range(len(cells)):
        exact = exact_upper(inequality, bounds, cells, place)
        error = rational(found.upper[place]) - rational(found.allowance[place]) - exact
        assert abs(error) <= rational(found.allowance[place]) / 5
        assert rational(found.upper[place]) > exact


def oscillator(degree: int, **changes: Any) -> fh.HJISolution:
    """Duffing's and van der Pol's oscillator."""
    flow = {(1, 0): [0, -1], (0, 1): [1, 0.5], (2, 1): [0, -0.5], (3, 0): [0, 0.3]}
    parts: dict[str, Any] = {
        "f": flow,
        "g1": [[0.0], [1.0]],
        "g2": [[0.0], [1.0]],
        "h": {(1, 0): [1.0, 0.0], (0, 1): [0.0, 1.0]},
        "r2": [[1.0]],
    }
    return fh.solve_hji(fh.PolynomialPlant(**{**parts, **changes}), gamma=1.2, degree=degree)


# What is not true ---------------------------------------------------------------------------------
def test_a_true_statement_is_proved_and_any_worse_one_is_not() -> None:
    solution = oscillator(4)
    sampled = solution.sampled_region()
    assert sampled is not None
    statement = replace(statement_of(solution, None, None), level=0.9999 * sampled.level)
    assert prove(statement)[1].proved
    flow = [list(row) for row in statement.drift]
    flow[1] = [
        replace(term, coefficient=1.001 * term.coefficient) if term.powers == (0, 1) else term
        for term in flow[1]
    ]
    worse = {
        "level": replace(statement, level=1.001 * statement.level),
        "gamma": replace(statement, gamma=0.999 * statement.gamma),
        "V": replace(statement, value=tuple((p, 0.999 * v) for p, v in statement.value)),
        "law": replace(statement, law=tuple(tuple((p, 0.98 * v) for p, v in row) for row in statement.law)),
        "penalty": replace(
            statement, penalty=tuple(tuple((p, 1.001 * v) for p, v in row) for row in statement.penalty)
        ),
        "plant": replace(statement, drift=tuple(map(tuple, flow))),
        "decay": replace(statement, decay=1e-3),
    }
    assert [name for name, changed in worse.items() if prove(changed)[1].proved] == []


def ball(radius: float) -> Certificate:
    """ẋ = −x (|x − e₁|² − radius²) in five states: r > 0 in a ball about e₁ only."""
    n = 5
    unit = np.eye(n, dtype=int)
    drift = []
    for i in range(n):
        terms = {tuple(unit[i]): -(1.0 - radius**2), tuple(unit[i] + unit[0]): 2.0}
        for j in range(n):
            terms[tuple(unit[i] + 2 * unit[j])] = -1.0
        drift.append(tuple(Term(value, tuple(map(int, powers))) for powers, value in terms.items()))
    names = [Signal(f"x{i}") for i in range(n)]
    return Certificate(
        about="a ball", states=tuple(names), inputs=(Signal("u"),), disturbances=(Signal("d"),),
        drift=tuple(drift), g1=((((Term(1e-9, (0,) * n),)),),) + ((((),)),) * (n - 1), g2=(((),),) * n,
        penalty=(), r2=((1.0,),), value=tuple((tuple(map(int, 2 * row)), 0.5) for row in unit), law=((),),
        gamma=1.0, level=0.72, coordinates=tuple(map(tuple, np.eye(n).tolist())), reach=1.0,
    )  # fmt: skip


def test_a_violation_that_random_points_miss_is_not_proved_away() -> None:
    statement, radius = ball(1e-3), 1e-3
    rng = np.random.default_rng(0)
    x = rng.standard_normal((100_000, 5))
    x *= (1.2 * rng.uniform(0, 1, len(x)) ** 0.2 / np.linalg.norm(x, axis=1))[:, None]
    assert (np.linalg.norm(x - np.eye(5)[0], axis=1) > 10 * radius).all()  # r < 0 at all of them
    proved, outcome = prove(statement)
    assert not outcome.proved
    assert np.linalg.norm(outcome.point - np.eye(5)[0]) < 0.1
    assert prove(replace(statement, level=0.45))[1].proved
    assert proved.reach >= 1.2


# Numbers at the edge ------------------------------------------------------------------------------
def test_numbers_that_would_overflow_are_refused() -> None:
    huge = {(1, 0): [0, -1], (0, 1): [1, 0.5], (9, 0): [0, -1e29], (3, 0): [0, 1e25]}
    statement = statement_of(oscillator(2, f=huge), None, None)
    inequality = Inequality(replace(statement, coordinates=((1e14, 0.0), (0.0, 1e14))))
    with pytest.raises(NumericalFailure, match="large"):
        CellBounds(inequality, 64.0, [])


def test_a_nan_is_accepted_nowhere() -> None:
    statement = statement_of(oscillator(4), None, None)
    bounds = CellBounds(Inequality(statement), 3.0, [])
    bounds.table[:] = np.nan
    found = bounds.bound(random_cells(bounds, 100, np.random.default_rng(2)), math.inf)
    assert not (found.upper < 0).any()
    assert not (found.upper_inside < 0).any()
    assert not search(bounds, 1.0, most_cells=20_000).proved


def test_a_v_of_subnormal_numbers_is_not_proved_by_losing_them() -> None:
    statement = statement_of(oscillator(2), None, None)
    tiny = tuple((powers, value * 2.0**-1060) for powers, value in statement.value)
    _, outcome = prove(replace(statement, value=tiny, level=2.0**-1061), most_cells=20_000)
    assert not outcome.proved  # with V ≈ 0 the law's effort is not paid for by its decrease


def test_signs_of_zero_and_opposite_faces_do_not_matter() -> None:
    solution = oscillator(4)
    statement = replace(statement_of(solution, None, None), level=1.7)
    both = CellBounds(Inequality(statement), 3.0, [])
    assert both.symmetric
    flipped = replace(statement, coordinates=tuple(tuple(-v for v in row) for row in statement.coordinates))
    other = CellBounds(Inequality(flipped), 3.0, [])
    cells = random_cells(both, 500, np.random.default_rng(3))
    cells.t[:50] = -0.0
    first, second = both.bound(cells, 1.7), other.bound(cells, 1.7)
    for name in ("upper", "least_value", "growth"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_opposite_faces_stand_for_each_other_only_where_what_differs_is_allowed_for() -> None:
    statement = statement_of(oscillator(4), None, None)
    bounds = {}
    for share in (0.0, 1e-13, 1e-5):
        odd = replace(statement, value=(*statement.value, ((3, 0), share)))
        bounds[share] = CellBounds(Inequality(odd), 3.0, [])
    assert [b.symmetric for b in bounds.values()] == [True, True, False]
    cells = random_cells(bounds[0.0], 100, np.random.default_rng(4))
    plain, allowed = (bounds[share].bound(cells, 1.7) for share in (0.0, 1e-13))
    difference = plain.least_value - allowed.least_value
    moved = Inequality(replace(statement, value=(((3, 0), 1e-13),))).value
    odd = sum(abs(nearest_double(value)) for value in moved.values())
    assert (difference >= 0.9 * odd * (3 * cells.outer) ** 3 - 1e-16).all()


@pytest.mark.ci("encloses cells twice")
def test_threads_change_nothing() -> None:
    _, statement = arm_statement(np.pi, 2)
    outcomes = [prove(replace(statement, level=1e4), threads=threads)[1] for threads in (1, 3)]
    assert outcomes[0].proved
    assert [outcome.cells for outcome in outcomes] == [outcomes[0].cells] * 2


# What cannot be taken -----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("flow", "what"),
    [
        (lambda x, u, d, p: np.array([x[1], np.sin(x[0] * x[1]) + u[0] + d[0]]), "sin of"),
        (lambda x, u, d, p: np.array([x[1], x[1] / (1.0 + x[0]) + u[0] + d[0]]), "quotient"),
        (lambda x, u, d, p: np.array([x[1], np.sqrt(1.0 + x[0] ** 2) - 1.0 + u[0] + d[0]]), "operation sqrt"),
        (
            lambda x, u, d, p: np.array([x[1], np.sin(x[0]) * np.cos(x[1]) + u[0] + d[0]]),
            "product",
        ),
    ],
)
def test_what_the_method_cannot_take_is_refused_by_name(flow: Any, what: str) -> None:
    plant = fh.Plant(
        flow, lambda x, u, p: x[:1], states=("a", "b"), inputs=("u",), disturbances=("d",), parameters={}
    )
    problem = plant.with_objective({"a": 1.0, "b": 1.0})
    solution = fh.solve_hji(problem, gamma=10.0, degree=2)
    with pytest.raises(InvalidInput, match=what):
        solution.certify(level=0.1)
