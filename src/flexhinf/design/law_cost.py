"""What a law costs: operations of one evaluation, and the states that it needs."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.analysis.law_batch import LawRows
from flexhinf.plant import Law
from flexhinf.scalars import trace

__all__ = ["needed_states", "operations"]

#: Coefficients up to which a polynomial law is traced to be counted; beyond, its sums and products are.
TRACED = 5_000

#: Number of random deviations in ±1 at which the slopes of a law are computed.
POINTS = 5

#: Slopes smaller than this, relative to the largest one, count as zero.
NEGLIGIBLE = 1e-12


def operations(law: Law) -> int:
    """Additions, multiplications and functions of one evaluation, estimator and integrals left out.

    Of the law's trace with common subexpressions shared. A polynomial of many coefficients is evaluated monomial by
    monomial: a product for each of degree two or more, a product and a sum for each coefficient.
    """
    if np.size(law.law_data) > TRACED and (table := law.law_table) is not None:
        monomials = table.coefficients.shape[1]
        return int(monomials - table.n + 2 * table.coefficients.size)
    n, data = len(law.state_names), np.size(law.law_data)
    if not law.depends_on_reference:
        return _count(trace(law.evaluate_law, n, data, name="law"))
    states = len(law.plant_states)
    return _count(trace(law.evaluate_about, n, states, len(law.input_names), data, name="law"))


def _count(function: Any) -> int:
    """Instructions that compute something."""
    import casadi as ca

    silent = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER)
    return sum(function.instruction_id(k) not in silent for k in range(function.n_instructions()))


def needed_states(law: Law) -> tuple[str, ...]:
    """States, and integrals, that the law depends on, at random deviations."""
    n = len(law.state_names)
    deviations = np.random.default_rng(0).uniform(-1.0, 1.0, (POINTS, n))
    _, slopes = LawRows(law)(deviations)
    size = np.abs(slopes).max(axis=(0, 1))
    return tuple(name for name, value in zip(law.state_names, size) if value > NEGLIGIBLE * size.max())
