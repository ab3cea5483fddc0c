"""A law and its slope at many points."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis.rows import Rows
from flexhinf.loop.staged import offers
from flexhinf.plant import Law
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import gradient, monomials
from flexhinf.scalars import trace

__all__ = ["LawRows"]


class LawRows:
    """k(x) and ∂k/∂x at deviations (N, n): a polynomial's from its table, another law's by tangents.

    Parameters
    ----------
    law : Law
    """

    def __init__(self, law: Law) -> None:
        self.law = law

    @cached_property
    def _polynomial(self) -> tuple[dict[int, np.ndarray], dict[int, np.ndarray]] | None:
        """By degree: coefficients (m, Nmon), and those of all derivatives (m, n, Nmon of one degree less)."""
        law = self.law
        if not (offers(law, "law_polynomial", "evaluate_law") and getattr(law, "law_is_polynomial", True)):
            return None
        table = law.law_polynomial()  # type: ignore[attr-defined]
        n, parts, slopes, start = table.n, {}, {}, 0
        for k in table.degrees:
            parts[k] = table.coefficients[:, start : start + basis.count(n, k)]
            start += basis.count(n, k)
            if k:
                entries = parts[k] / basis.multiplicity(n, k)
                slopes[k - 1] = np.array([gradient(row, n, k).T for row in entries])
        return parts, slopes

    @cached_property
    def _rows(self) -> Rows:
        law = self.law
        n, size = len(law.state_names), np.size(law.law_data)
        key = ("law", type(law), law.law_key, n, size)
        return Rows(key, lambda: trace(law.evaluate_law, n, size, name="law"))

    @property
    def placed(self) -> bool:
        """Whether the law depends on the reference that it acts about, see `flexhinf.plant.Law`."""
        return offers(self.law, "evaluate_about", "evaluate_law")

    @cached_property
    def _rows_about(self) -> Rows:
        law: Any = self.law
        n, m, size = len(law.state_names), len(law.input_names), np.size(law.law_data)
        states = sum(not name.endswith("_integral") for name in law.state_names)

        def about(moving: Any, held: Any) -> Any:
            return law.evaluate_about(moving[:n], moving[n : n + states], moving[n + states :], held)

        key = ("law about", type(law), law.law_key, tuple(law.state_names), m, size)
        return Rows(key, lambda: trace(about, n + states + m, size, name="law_about"))

    def about(self, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of a placed law: values (N, m) and slopes (N, m, w) at rows (N, w) of deviation, reference and its input."""
        return self._rows_about(moving, np.ravel(self.law.law_data))

    def __call__(self, deviation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (N, m) and slopes (N, m, n) at deviations (N, n)."""
        if self._polynomial is None:
            return self._rows(deviation, np.ravel(self.law.law_data))
        parts, slopes = self._polynomial
        (count, n), m = deviation.shape, len(self.law.input_names)
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # Newton may stray; what is not finite is judged there
            powers = monomials(deviation, {*parts, *slopes})
            value, slope = np.zeros((count, m)), np.zeros((count, m * n))
            for k, part in parts.items():
                value += powers[k] @ part.T
            for k, part in slopes.items():
                slope += powers[k] @ part.reshape(m * n, -1).T
        return value, slope.reshape(count, m, n)
