"""What a law costs to compute, and what it has to be told of the state."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.analysis.law_batch import LawRows
from flexhinf.loop.staged import offers
from flexhinf.plant import Law
from flexhinf.scalars import trace

__all__ = ["needed_states", "operations"]

#: Coefficients up to which a polynomial law is traced to be counted; beyond, its sums and products are.
TRACED = 5_000

#: Deviations at which a law is looked at, drawn in ±1 with a fixed seed.
LOOKED = 5

#: Slopes below this share of the largest one are none.
NOTHING = 1e-12


def operations(law: Law) -> int:
    """Additions, multiplications and functions of one evaluation, estimator and integrals left out.

    Of the law's trace with common subexpressions shared. A polynomial of many coefficients is evaluated monomial by
    monomial: a product for each of degree two or more, a product and a sum for each coefficient.
    """
    if np.size(law.law_data) > TRACED and offers(law, "law_polynomial", "evaluate_law"):
        table = law.law_polynomial()  # type: ignore[attr-defined]
        monomials = table.coefficients.shape[1]
        return int(monomials - table.n + 2 * table.coefficients.size)
    n, data = len(law.state_names), np.size(law.law_data)
    about = getattr(law, "evaluate_about", None)
    if about is None:
        return _count(trace(law.evaluate_law, n, data, name="law"))
    states = sum(not name.endswith("_integral") for name in law.state_names)
    return _count(trace(about, n, states, len(law.input_names), data, name="law"))


def _count(function: Any) -> int:
    """Instructions that compute something."""
    import casadi as ca

    silent = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER)
    return sum(function.instruction_id(k) not in silent for k in range(function.n_instructions()))


def needed_states(law: Law) -> tuple[str, ...]:
    """States, and integrals, that the law depends on, at random deviations."""
    n = len(law.state_names)
    deviations = np.random.default_rng(0).uniform(-1.0, 1.0, (LOOKED, n))
    _, slopes = LawRows(law)(deviations)
    size = np.abs(slopes).max(axis=(0, 1))
    return tuple(name for name, value in zip(law.state_names, size) if value > NOTHING * size.max())
