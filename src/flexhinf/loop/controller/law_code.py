"""How a kernel evaluates a law: by its own code, as a table of monomials, or as a series of springs, in loops."""

# `operator.matmul` has no type for blocks.
# pyright: reportUnknownMemberType=false
from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from flexhinf.codegen import Block, Composer, gives
from flexhinf.codegen.shared import share
from flexhinf.plant import Law
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import PolynomialLaw
from flexhinf.scalars import jacobian, where

#: Coefficients from which a polynomial law is a table. Below, its text as one piece is faster.
TABLE = 500


def law_slope(law: Law) -> np.ndarray:
    """∂u/∂x of a law at its operating point, (m, n)."""
    n, data = len(law.state_names), np.ravel(law.law_data)
    table = None if law.depends_on_reference else law.law_table
    if table is None:
        key = "slope", type(law), law.law_key, n, data.size
        return share(key, lambda: jacobian(law.evaluate_law, n, data.size, name="law"))(np.zeros(n), data)[1]
    before = sum(basis.count(n, k) for k in table.degrees if k < 1)
    linear = table.coefficients[:, before : before + n]
    return linear if 1 in table.degrees else np.zeros_like(linear)


@dataclass(frozen=True, eq=False)
class LawCode:
    """A law and the form of its numbers in a kernel.

    From `TABLE` coefficients on, a controller that is `composed` of pieces evaluates a polynomial law
    (`Law.law_table`) in loops, in nested form: the table of its coefficients has one row per monomial and one column
    per input, padded with zero columns so that rows fill vectors.
    """

    law: Law
    composed: bool

    @cached_property
    def table(self) -> PolynomialLaw | None:
        """The polynomial, where the law is evaluated as a table."""
        large = np.size(self.law.law_data) >= TABLE
        return self.law.law_table if large and self.composed and not self.law.depends_on_reference else None

    @property
    def columns(self) -> int:
        """Columns of the table: inputs, and padding to 1, 2, 4 or a multiple of 8."""
        inputs = len(self.law.input_names)
        return next((power for power in (1, 2, 4) if inputs <= power), -(-inputs // 8) * 8)

    @cached_property
    def data(self) -> np.ndarray:
        """The law's numbers as the kernel has them, flat."""
        if self.table is None:
            return np.ravel(self.law.law_data)
        rows = self.table.coefficients.T
        return np.pad(rows, ((0, 0), (0, self.columns - rows.shape[1]))).ravel()

    def on(
        self, run: Any, data: Any, active: Any = None, about: tuple[Any, Any] | None = None
    ) -> Callable[[Any], Any]:
        """k as a function of a deviation x (n,) on the run, with numbers (L · size,) as in `data`, of one law after the
        other, of which `active` (L,) is 1 for the law that is meant, else 0; about the moving reference (n without
        integrals,) and its input (m,), x* and u* by default."""
        if self.table is not None and isinstance(run, Composer):
            return partial(self._from_table, run, data, active)
        if active is not None:
            data = run.call(operator.matmul, active, data.reshape(len(active), self.data.size))
        if self.table is not None:
            data = data.reshape(-1, self.columns)[:, : len(self.law.input_names)].T.ravel()
        if (series := self.law.law_series) is not None:
            state = None if about is None else about[0]
            return lambda x: series.evaluate(x, data, state, run)
        if about is not None and self.law.depends_on_reference:
            return lambda x: run.call(self._law_about, x, *about, data)
        return lambda x: run.call(self._law, x, data)

    @gives("feedback")
    def _law(self, deviation: Any, law: Any) -> Any:
        """The law k(x - x*)."""
        return self.law.evaluate_law(deviation, law)

    @gives("feedback")
    def _law_about(self, deviation: Any, state: Any, input: Any, law: Any) -> Any:
        """The law about the moving reference."""
        return self.law.evaluate_about(deviation, state, input, law)

    def _from_table(self, run: Composer, data: Block, active: Block | None, x: Block) -> Block:
        assert self.table is not None
        inputs, size, degrees = len(self.law.input_names), self.data.size, self.table.degrees
        if active is None:
            return run.polynomial(x, data[:size], degrees, inputs)
        totals: list[Block] = []
        for law in range(len(active)):
            with run.when(active[law : law + 1]):
                totals.append(run.polynomial(x, data[law * size : (law + 1) * size], degrees, inputs))
        return run.call(_chosen, active, *totals)


def _chosen(active: Any, *values: Any) -> Any:  # the other laws may never have been computed
    return sum(where(flag > 0.5, value, 0.0) for flag, value in zip(active, values, strict=True))
