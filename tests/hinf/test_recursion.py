"""The recursion's account: which method each degree used, and that the residual it tells is small."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest

from flexhinf.hinf import smallest_gamma, solve_hji
from flexhinf.hinf.homological import Coordinates
from flexhinf.plant.polynomial_plant import PolynomialPlant


def _jordan_plant(n: int, coupling: float, gap: float) -> PolynomialPlant:
    """A = −I + coupling on the superdiagonal, diagonal entries `gap` apart, h of degree 2 only.

    Then P = 0, the closed loop is A itself, V_3 = 0, and V_4 = ½ ∫ |h(e^{At} x)|² dt.
    """
    unit = np.eye(n, dtype=int)
    a = -np.eye(n) + coupling * np.eye(n, k=1) - gap * np.diag(np.arange(n))
    f = {tuple(unit[j].tolist()): a[:, j] for j in range(n)}
    rng = np.random.default_rng(n)
    h = {tuple((unit[i] + unit[j]).tolist()): rng.standard_normal(2) for i in range(n) for j in range(i + 1)}
    h[tuple(unit[0].tolist())] = np.zeros(2)
    return PolynomialPlant(f, np.ones((n, 1)), np.ones((n, 1)), h, 1.0)


@pytest.mark.oracle
@pytest.mark.parametrize(("coupling", "gap"), [(1.0, 0.0), (1.0, 1e-3), (0.0, 0.1)])
def test_defective_closed_loop_is_solved_to_rounding(coupling, gap):
    """Defective, cond(T) beyond 1e6, and harmless: relative residual ≤ 1e-13, V_4 against quadrature."""
    plant = _jordan_plant(4, coupling, gap)
    solution = solve_hji(plant, math.inf, 6)
    by_degree = {record.degree: record for record in solution.records}
    assert "parity" in by_degree[3].method
    assert by_degree[4].method.startswith("Schur" if coupling else "eigenbasis")
    assert (solution.condition > 1e6) == bool(coupling)
    assert max(record.residual for record in solution.records) <= 1e-13
    from scipy.integrate import quad
    from scipy.linalg import expm

    x, a = np.array([0.3, -0.5, 0.8, 0.4]), plant.f_parts[1]
    exact, _ = quad(lambda t: (plant.fields((expm(a * t) @ x)[None])[3] ** 2).sum() / 2, 0, 40)
    powers = np.prod(x ** solution.exponents(4), axis=1)
    assert solution.coefficient_array(4) @ powers == pytest.approx(exact, rel=1e-9)


def test_both_routes_give_one_solution(monkeypatch, random_plant):
    plant = random_plant(np.random.default_rng(8), 4)
    gamma = 3 * smallest_gamma(plant)
    first = solve_hji(plant, gamma, 5)
    monkeypatch.setattr(Coordinates, "condition", np.inf)
    second = solve_hji(plant, gamma, 5)
    assert [record.method for record in second.records[1:]] == ["Schur"] * 3
    for k in range(2, 6):
        assert second.coefficient_array(k) == pytest.approx(first.coefficient_array(k), rel=1e-8, abs=1e-10)


def test_parity_skips_the_odd_degrees_and_changes_nothing(arm):
    """The same plant with a quadratic term of 1e-300: nothing is skipped, nothing else changes."""
    plant = arm.expand(5)
    gamma = 2 * smallest_gamma(plant)
    quadratic = np.zeros((5, 15))
    quadratic[0, 0] = 1e-300
    full = PolynomialPlant.from_parts(
        5, {**plant.f_parts, 2: quadratic}, plant.g1_parts, plant.g2_parts, plant.h_parts, plant.r2
    )
    odd, even = solve_hji(plant, gamma, 6), solve_hji(full, gamma, 6)
    skipped = [record.degree for record in odd.records if "parity" in record.method]
    assert skipped == [3, 5]
    assert not any("parity" in record.method for record in even.records)
    for k in (2, 4, 6):
        scale = np.abs(odd.coefficient_array(k)).max()
        assert even.coefficient_array(k) == pytest.approx(odd.coefficient_array(k), abs=1e-12 * scale)


_PROGRAM = """
import sys
import numpy as np
import flexhinf as fh
rng, n = np.random.default_rng(0), 20
f = {1: rng.standard_normal((n, n)) / np.sqrt(n) - np.eye(n), 2: 0.05 * rng.standard_normal((n, 210))}
g1, g2 = rng.standard_normal((2, n, 4, 1))
solution = fh.solve_hji(fh.PolynomialPlant.from_parts(n, f, {0: g1}, {0: g2}, {1: np.eye(n)}, np.eye(4)), 40.0, 4)
sys.stdout.buffer.write(b"".join(part.tobytes() for part in solution.value_parts.values()))
"""


@pytest.mark.ci("two processes; test_threads.py has our own threads")
def test_the_number_of_threads_changes_no_bit():
    """Real and complex products beyond the sizes from which BLAS would share them among its threads."""
    results = []
    for threads in ("1", "2"):
        counts = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), threads)
        run = subprocess.run(
            [sys.executable, "-c", _PROGRAM], env={**os.environ, **counts}, capture_output=True, check=True
        )
        results.append(run.stdout)
    assert len(results[0]) == 8 * (210 + 1540 + 8855)
    assert results[0] == results[1]
