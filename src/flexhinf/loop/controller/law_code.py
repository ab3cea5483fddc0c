"""A law as a controller's kernel evaluates it: its own text, or a table of monomials in loops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from flexhinf.codegen import Block, Composer
from flexhinf.plant import Law
from flexhinf.polynomial import basis
from flexhinf.polynomial.law import PolynomialLaw
from flexhinf.scalars import jacobian, where

#: Coefficients from which a polynomial law is a table. Below, its text as one piece is faster.
TABLE = 500


@dataclass(frozen=True, eq=False)
class LawCode:
    """A law and the form of its numbers in a kernel.

    From `TABLE` coefficients on, a composed kernel evaluates a polynomial law (`Law.law_table`) in loops, in nested
    form: the table of its coefficients has one row per monomial and one column per input, padded with zero columns so
    that rows fill vectors.

    Parameters
    ----------
    composed : bool
        Whether the controller is composed of pieces.
    """

    law: Law
    composed: bool

    @cached_property
    def table(self) -> PolynomialLaw | None:
        """The polynomial, where the law is evaluated as a table."""
        large = np.size(self.law.law_data) >= TABLE
        return self.law.law_table if large and self.composed and not self.placed else None

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

    @cached_property
    def slope(self) -> np.ndarray:
        """∂u/∂x at the operating point, (m, n)."""
        n, data = len(self.law.state_names), np.ravel(self.law.law_data)
        if self.table is None:
            return jacobian(self.law.evaluate_law, n, data.size)(np.zeros(n), data)[1]
        degrees = self.table.degrees
        before = sum(basis.count(n, k) for k in degrees if k < 1)
        linear = self.table.coefficients[:, before : before + n]
        return linear if 1 in degrees else np.zeros_like(linear)

    @property
    def placed(self) -> bool:
        """Whether the law depends on the reference that it acts about, see `flexhinf.plant.Law`."""
        return self.law.depends_on_reference

    def evaluate(self, run: Any, x: Any, data: Any) -> Any:
        """k(x), (m,), for a deviation x (n,) and the numbers as in `data`."""
        return self.on(run, data)(x)

    def on(
        self, run: Any, data: Any, active: Any = None, about: tuple[Any, Any] | None = None
    ) -> Callable[[Any], Any]:
        """k as a function of a deviation x (n,) on the run.

        Parameters
        ----------
        data : (L · size,)
            Numbers as in `data`, of one law after the other.
        active : (L,), optional
            1 for the law that is meant, else 0. By default there is one.
        about : (state, input), optional
            The moving reference, (n without integrals,) and (m,); x* and u* by default.
        """
        if self.table is not None and isinstance(run, Composer):
            return partial(self._from_table, run, data, active)
        if active is not None:
            data = run.call(_of_active, active, data.reshape(len(active), self.data.size))
        if self.table is not None:
            data = data.reshape(-1, self.columns)[:, : len(self.law.input_names)].T.ravel()
        if about is not None and self.placed:
            return lambda x: run.call(self.law.evaluate_about, x, *about, data)
        return lambda x: run.call(self.law.evaluate_law, x, data)

    def _from_table(self, run: Composer, data: Block, active: Block | None, x: Block) -> Block:
        """The polynomials of the active law alone."""
        assert self.table is not None
        inputs, size, degrees = len(self.law.input_names), self.data.size, self.table.degrees

        def total(law: int) -> Block:
            return run.polynomial(x, data[law * size : (law + 1) * size], degrees, inputs)

        if active is None:
            return total(0)
        totals = []
        for law in range(len(active)):
            with run.when(active[law : law + 1]):
                totals.append(total(law))
        return run.call(_chosen, active, *totals)


def _of_active(active: Any, rows: Any) -> Any:
    """The active law's row."""
    return active @ rows


def _chosen(active: Any, *values: Any) -> Any:
    """The active law's value; the others may never have been computed."""
    return sum(where(flag > 0.5, value, 0.0) for flag, value in zip(active, values, strict=True))
