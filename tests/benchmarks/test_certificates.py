"""``make bench-certificates``: the rows that are kept, the exact check of sums of squares, and a small case anew."""

from __future__ import annotations

import json

import numpy as np
import pytest
from benchmarks.certificates import published
from benchmarks.certificates.__main__ import KEPT, tables
from benchmarks.certificates.arm import PENALTY, given_storage, linear_inequalities, solution_of
from benchmarks.certificates.identities import (
    Answer,
    Identity,
    Program,
    Solver,
    Square,
    monomials,
    newton_basis,
    proved,
)
from benchmarks.certificates.model import evaluated, even, model_of, quotient_bounds
from flint import fmpq_mpoly_ctx

from flexhinf.certify import prove
from flexhinf.certify.problem_to_claim import statement_of


def answer(matrix: np.ndarray) -> Answer:
    return Answer("optimal", 0.0, 0.0, {}, [matrix])


def test_a_sum_of_squares_is_accepted_within_rounding_and_one_that_is_none_is_refused() -> None:
    """x² + 2b xy + y² has the matrix [[1, b], [b, 1]]: definite for |b| < 1 alone."""
    ring = fmpq_mpoly_ctx.get(["x", "y"])
    x, y = ring.gens()
    for b, holds in ((0.5, True), (1.5, False)):
        polynomial = x * x + y * y + ring.constant(int(4 * b)) * x * y / 2
        identity = Identity(polynomial, [Square(ring.constant(1), monomials(2, 1, 1))])
        rounded = np.array([[1.0, b], [b, 1.0]]) + 1e-9
        assert (proved(Program([identity]), answer(rounded)) == "") is holds
        wrong = np.eye(2)  # another polynomial: what is missing is put in, and the result judged
        assert (proved(Program([identity]), answer(wrong)) == "") is holds
    cubic = Identity(x * x + y * y * y, [Square(ring.constant(1), monomials(2, 1, 1))])
    assert "rounding" in proved(Program([cubic]), answer(np.eye(2)))


def test_monomials_of_a_square_come_from_the_newton_polytope() -> None:
    ring = fmpq_mpoly_ctx.get(["x", "y"])
    x, y = ring.gens()
    assert newton_basis([x**4 * y**2 + x**2 * y**4 + x**2 * y**2]) == [(1, 1), (1, 2), (2, 1)]  # Motzkin's
    assert newton_basis([x**2 + x * y + y**2]) == [(0, 1), (1, 0)]


def test_the_rivals_inequality_is_ours() -> None:
    """r in the model's coordinates, with polynomials about S, against the solution's own fields."""
    solution, gamma = solution_of(2)
    claim = even(statement_of(solution, gamma, PENALTY, level=1e4))
    model = model_of(claim)
    low, high = quotient_bounds(model, 1.0, 6)[0]
    z = 0.4 * np.random.default_rng(0).standard_normal((20, 5))
    x = z @ model.transform.T
    f, g1, g2, _ = solution.exact_fields(x)
    terms = solution.hamiltonian_terms(solution.gradient(x), (f, g1, g2, x * PENALTY), gamma)
    ours = np.reshape(terms, (-1, len(z))).sum(axis=0) / claim.level
    ends = np.sort([evaluated(model, model.residual(model.value, q))(z) for q in (low, high)], axis=0)
    assert (ends[0] - 1e-9 <= ours).all()
    assert (ours <= ends[1] + 1e-9).all()
    assert np.abs(ends[1] - ends[0]).max() < 1e-4


def test_tables_are_of_rows_whose_proofs_hold() -> None:
    kept = json.loads(KEPT.read_text(encoding="utf-8"))
    rows = {(row["method"].split(",")[0], row["law"], row["goal"]): row for row in kept["arm"]}
    rival, own = (rows[method, "linear", 180] for method in ("matrix inequalities", "ours"))
    assert rival["gamma"] < own["gamma"]  # the best rival is said to be better
    assert rival["step"] is None
    assert not any(row["exact"] for row in kept["arm"] if row["method"] == "ours")
    assert max(row["radius"] for row in kept["published"]) > published.PUBLISHED
    assert "every start" in tables(kept)


@pytest.mark.nightly("proves by three methods, with cvxpy and Clarabel of `make peers`")
def test_rivals_prove_the_small_cases_anew() -> None:
    if missing := Solver.missing():
        pytest.skip(f"missing: {missing}")
    with Solver() as solver:
        inequalities = linear_inequalities(solver)
        squares = given_storage(solver, 2, shares=(1.001, 0.999))
        row, best = published.rival(solver, 4, 4)
    assert not inequalities["exact"]
    assert inequalities["gamma"] == pytest.approx(236.1, rel=1e-3)
    assert squares["share"] == 0.999  # refused above the sampled level, proved below
    assert not row["exact"]
    assert row["radius"] > 0.61
    _, outcome = prove(best)  # its V, by branch and bound
    assert outcome.proved
