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
    """u_i(x) = Σ_a coefficients[i, a] x^exponents[a], x and u deviations from the operating point.

    Attributes
    ----------
    n : int
        Number of states.
    degrees : tuple of int
        Degrees that occur, ascending. The exponents are all monomials of these degrees, degree by degree.
    coefficients : ndarray, shape (m, Nmon)
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
        """Take over attributes; copies share their arrays, so nobody may write them."""
        vars(self).update(read_only(state))

    @property
    def exponents(self) -> np.ndarray:
        """Exponent vectors, shape (Nmon, n)."""
        return np.concatenate([basis.exponents(self.n, k) for k in self.degrees])

    def evaluate(self, x: np.ndarray, coefficients: np.ndarray | None = None) -> np.ndarray:
        """The law at one state, on any element type.

        Every monomial is one variable times a monomial of one degree less, shared by all inputs.

        Parameters
        ----------
        x : ndarray, shape (n,)
            Floats, or objects that multiply and add (symbols, intervals).
        coefficients : ndarray, shape (m, Nmon), optional
            Instead of the law's own; a new law with the same monomials then needs no recompilation.

        Returns
        -------
        ndarray, shape (m,)
        """
        x = np.asarray(x)
        coefficients = self.coefficients if coefficients is None else np.asarray(coefficients)
        powers = monomials(x[None, :], self.degrees)
        return _total(coefficients, np.concatenate([powers[k][0] for k in self.degrees]))


def _total(coefficients: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Σ_a coefficients[:, a] powers[a]; of objects in eight parts, a modulo 8, which are added in pairs.

    That is an eighth of the latency of one sum after the other: the law lies between measurement and input.
    """
    if powers.dtype != object or not powers.size:
        return coefficients @ powers
    sums = [coefficients[:, k::PARTS] @ powers[k::PARTS] for k in range(min(PARTS, powers.size))]
    while len(sums) > 1:
        odd = sums[len(sums) - len(sums) % 2 :]
        sums = [*(a + b for a, b in zip(sums[::2], sums[1::2], strict=False)), *odd]
    return sums[0]
