"""A hundred thousand random cells for each program: no point exceeds the bounds of its cell, and some come near.

r is evaluated by its definition, by code that neither program knows: in doubles at every point, and in balls at those
that come nearest to their bounds, where no rounding is left to hide behind.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import flint
import numpy as np
import pytest
from tests.certify.definition import in_balls, in_doubles
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.certify import Certificate
from flexhinf.certify.box import parameter_ranges, tolerance_statement
from flexhinf.certify.cells import CellBounds, cells_of
from flexhinf.certify.checker.bounds import Face, Proof
from flexhinf.certify.inequality import Inequality
from flexhinf.certify.problem_to_claim import statement_of

ARM = fh.paper_arm()
CHECKED = fh.Penalty((60.0, 0.0, 0.0, 0.0, 300.0), effort=10.0)
FINEST, SHORTEST = 12, 15  # binary logarithms of the narrowest and the shortest cells
NEAREST = 60  # points that are looked at again in balls
BATCH = 1000


class Bounded(NamedTuple):
    """r/ρ² ≤ upper, and ≤ inside where V ≤ level; ∂V/∂ρ /ρ ≥ growth; V ≥ least at the inner end; all (cells,)."""

    upper: np.ndarray
    inside: np.ndarray
    growth: np.ndarray
    least: np.ndarray


# Two claims ---------------------------------------------------------------------------------------
def nominal(degree: int) -> Certificate:
    """1.3 rad, where a sine is neither odd nor even and all ten faces count."""
    problem = ARM.problem(fh.Penalty((75.0, 27.0, 90.0, 27.0, 330.0), effort=10.0), pose=(1.3,))
    star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * star, degree=degree)
    return replace(statement_of(solution, 1.6 * star, (60.0, 0.0, 0.0, 0.0, 300.0)), level=2e4, reach=440.0)


def all_tolerances() -> Certificate:
    """90° and V of degree two, parameters anywhere in the box of Tables 1 and 2."""
    pose = (np.pi / 2,)
    problem = ARM.problem(fh.Penalty((80.0, 36.0, 120.0, 36.0, 340.0), effort=10.0), pose=pose)
    solution = fh.solve_hji(problem, gamma=1.5 * fh.smallest_gamma(problem), degree=2)
    about = ARM.problem(CHECKED, pose=pose)
    statement = tolerance_statement(solution, about, parameter_ranges(ARM, about.plant), 20.0)
    return replace(statement, level=50.0, reach=60.0)


# Cells and points -----------------------------------------------------------------------------------
def distinct_cells(count: int, dimension: int, faces: int, rng: np.random.Generator) -> np.recarray:
    """Dyadic cells of all sizes, some at the centre, no two alike."""
    rows = np.zeros((0, 2 * dimension + 3))
    while len(rows) < count:
        more = 2 * count
        h = np.exp2(-rng.integers(0, FINEST, (more, dimension)).astype(float))
        t = np.round(rng.uniform(-1, 1, h.shape) * (1 / h - 1)) * h
        length = np.exp2(-rng.integers(1, SHORTEST, more).astype(float))
        inner = np.floor(rng.uniform(0, 1, more) * (1 / length - 1)) * length
        inner[: more // 10] = 0.0
        made = np.column_stack([rng.integers(0, faces, more), t, h, inner, inner + length])
        rows = np.unique(np.vstack([rows, made]), axis=0)
    rows = rng.permutation(rows)[:count]
    t, h = rows[:, 1 : 1 + dimension], rows[:, 1 + dimension : -2]
    return cells_of(rows[:, 0].astype(np.int64), t.copy(), h.copy(), rows[:, -2].copy(), rows[:, -1].copy())


def random_points(
    cells: np.recarray, reach: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A point of each cell, often on its boundary: directions ω (N, n) with a face at ±1, and ρ > 0."""
    t = cells.t + rng.uniform(-1.3, 1.3, cells.t.shape).clip(-1, 1) * cells.h
    share = rng.uniform(-0.3, 1.3, len(cells)).clip(0, 1)
    share = np.where((cells.inner == 0) & (share == 0), 1.0, share)
    count, n = len(cells), t.shape[1] + 1
    directions = np.empty((count, n))
    fixed = np.arange(n) == cells.face[:, None] // 2
    directions[fixed] = 1.0 - 2.0 * (cells.face % 2)
    directions[~fixed] = t.ravel()
    return directions, reach * (cells.inner + (cells.outer - cells.inner) * share)


# The two programs -----------------------------------------------------------------------------------
def bounds_of_the_search(claim: Certificate, cells: np.recarray) -> Bounded:
    inequality = Inequality(claim)
    extent = 1.1 * claim.reach * np.abs(inequality.forms(inequality.functions)).sum(axis=1)
    bounds = CellBounds(inequality, claim.reach, extent.tolist())
    found, inside = bounds.bound(cells, math.inf), bounds.bound(cells, claim.level)
    return Bounded(found.upper, inside.upper_inside, found.growth, found.least_value)


def bounds_of_the_checker(claim: Certificate, cells: np.recarray) -> Bounded:
    of = Proof(claim)
    result = np.empty((4, len(cells)))
    for face in np.unique(cells.face):
        bounds = Face(of, (int(face) // 2, 1 - 2 * int(face % 2)))
        mine = np.flatnonzero(cells.face == face)
        for places in np.array_split(mine, math.ceil(len(mine) / BATCH)):
            radii = cells.inner[places] * claim.reach, cells.outer[places] * claim.reach
            found = bounds.bounds(cells.t[places].T.copy(), cells.h[places].T.copy(), *radii)
            result[:, places] = (found.largest, found.largest_inside, found.least_growth, found.least_value)
    return Bounded(*result)


FIELDS = {"r": "upper", "r inside": "inside", "growth": "growth", "value": "least"}


# The test -------------------------------------------------------------------------------------------
CASES: dict[str, tuple[Callable[[], Certificate], Callable[[Certificate, np.recarray], Bounded]]] = {
    "search, degree 6": (lambda: nominal(6), bounds_of_the_search),
    "checker, degree 4": (lambda: nominal(4), bounds_of_the_checker),
    "search, all tolerances": (all_tolerances, bounds_of_the_search),
    "checker, all tolerances": (all_tolerances, bounds_of_the_checker),
}


@pytest.mark.parametrize("count", ci_and_night("so many cells of each program", [15_000], [100_000]))
@pytest.mark.parametrize("name", CASES)
def test_no_point_of_many_cells_exceeds_its_bounds(name: str, count: int) -> None:
    check_cells(name, count, 2 if "tolerances" not in name else 1)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", [name for name in CASES if "degree 6" not in name])
def test_no_point_of_some_cells_exceeds_its_bounds(name: str) -> None:
    check_cells(name, 300, 2)


def check_cells(name: str, count: int, points: int) -> None:
    make, program = CASES[name]
    claim, rng = make(), np.random.default_rng(5)
    transform = np.array(claim.coordinates)
    cells = distinct_cells(count, len(claim.states) - 1, 2 * len(claim.states), rng)
    bounds = program(claim, cells)
    assert np.isfinite(bounds.upper).all()
    low, high = np.array([(p.low, p.high) for p in claim.parameters]).T
    near = 0
    for _ in range(points):
        direction, radius = random_points(cells, claim.reach, rng)
        corner = low + (high - low) * rng.uniform(-1.0, 2.0, (count, len(low))).clip(0, 1)
        x = (direction * radius[:, None]) @ transform.T
        found = in_doubles(claim, x, corner)
        slope, value, square = found.slope(), found.value(), radius**2
        r, along = found.residual(slope) / square, (np.array(slope) * x.T).sum(0) / square
        innermost = (direction * (claim.reach * cells.inner)[:, None]) @ transform.T
        least = in_doubles(claim, innermost, corner).value()
        gaps = {  # how far each is from its bound
            "r": bounds.upper - r,
            "r inside": bounds.inside - r,
            "growth": along - bounds.growth,
            "value": least - bounds.least,
        }
        for which, gap in gaps.items():
            seen = (which != "r inside") | ((value <= claim.level) & np.isfinite(bounds.inside))
            size = np.abs(getattr(bounds, FIELDS[which])) + 1e-300
            relative = np.divide(gap, size, out=np.full(count, np.inf), where=seen)
            order = np.argsort(relative)[:NEAREST]
            assert relative[order[-1]] > 1e-9 or which == "value", which  # the others need no balls
            for place in order[np.isfinite(relative[order])]:
                check_point(
                    claim,
                    cells,
                    bounds,
                    which,
                    int(place),
                    direction[place],
                    float(radius[place]),
                    corner[place],
                )
            near += int((relative[order] < 0.05).sum())
    assert near > NEAREST  # and the bounds are no idle ones


def check_point(
    claim: Certificate, cells: np.recarray, bounds: Bounded, which: str, place: int,
    direction: np.ndarray, radius: float, corner: np.ndarray,
) -> None:  # fmt: skip
    """One bound at one point of one cell, in balls of 128 bits."""
    with flint.ctx.workprec(128):
        rho = flint.arb(float(claim.reach * cells.inner[place]) if which == "value" else radius)
        z = [rho * flint.arb(float(v)) for v in direction]
        x = [sum(flint.arb(a) * b for a, b in zip(row, z, strict=True)) for row in claim.coordinates]
        at = in_balls(claim, x, corner)
        slope, bound = at.slope(), flint.arb(float(getattr(bounds, FIELDS[which])[place]))
        if which == "value":
            assert at.value() >= bound
        elif which == "growth":
            assert sum((v * b for v, b in zip(slope, x, strict=True)), flint.arb(0)) / rho**2 >= bound
        else:
            assert at.residual(slope) / rho**2 <= bound
