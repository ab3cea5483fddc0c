"""A feedback law as plain data: monomials and their coefficients, as a kernel evaluates it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import monomials
from flexhinf.validation import read_only

#: Parts of a sum of objects, as many as the latency of an addition asks for.
PARTS = 8


@dataclass(frozen=True, eq=False)
class PolynomialLaw:
    """u_i(x) = Σ_a coefficients[i, a] x^exponents[a], x (n,) and u (m,) deviations from the operating point.

    The exponents are all monomials of the degrees that occur, ascending, degree by degree; coefficients (m, Nmon).
    """

    n: int
    degrees: tuple[int, ...]
    coefficients: np.ndarray

    def __post_init__(self) -> None:
        self.__setstate__({"coefficients": self.coefficients})
        expected = sum(basis.count(self.n, k) for k in self.degrees)
        if self.coefficients.ndim != 2 or self.coefficients.shape[1] != expected:
            raise InvalidInput(
                "The coefficients of the law do not fit its monomials.",
                f"expected shape (inputs, {expected}), got {self.coefficients.shape}",
                f"one column per monomial of degrees {self.degrees} in {self.n} states",
            )

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(read_only(state))

    @property
    def exponents(self) -> np.ndarray:
        """Exponent vectors, shape (Nmon, n)."""
        return np.concatenate([basis.exponents(self.n, k) for k in self.degrees])

    def evaluate(self, x: np.ndarray, coefficients: np.ndarray | None = None) -> np.ndarray:
        """The law (m,) at one state (n,) of floats, or of objects that multiply and add (symbols, intervals).

        Every monomial is one variable times a monomial of one degree less, shared by all inputs. Other `coefficients`
        (m, Nmon) than the law's own make a new law with the same monomials, which needs no recompilation.
        """
        x = np.asarray(x)
        coefficients = self.coefficients if coefficients is None else np.asarray(coefficients)
        powers = monomials(x[None, :], self.degrees)
        row = np.concatenate([powers[k][0] for k in self.degrees])
        if row.dtype != object or not row.size:
            return coefficients @ row
        # Objects are added in eight parts, and those in pairs: an eighth of the latency of one sum after the other, and
        # the law lies between measurement and input.
        sums = [coefficients[:, k::PARTS] @ row[k::PARTS] for k in range(min(PARTS, row.size))]
        while len(sums) > 1:
            odd = sums[len(sums) - len(sums) % 2 :]
            sums = [*(a + b for a, b in zip(sums[::2], sums[1::2], strict=False)), *odd]
        return sums[0]
