"""The law of a solution as a closed loop runs it: u = −R2⁻¹ g2(x)ᵀ V_xᵀ on any element.

With a constant g2 that is a polynomial, a table of monomials. With g2(x) it is the product of the exact g2 and
the polynomial V_x: what runs is what `HJISolution.law` says and what `sampled_region` checks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.plant.problem import Problem
from flexhinf.polynomial.law import PolynomialLaw
from flexhinf.scalars import digest, trace

__all__ = ["EXACT_INPUT_MATRIX", "GradientLaw", "input_matrix_of"]

#: Problems that evaluate g2 itself on any element; of others the expansion does.
EXACT_INPUT_MATRIX = (GeneralisedPlant, PolynomialPlant)


@dataclass(frozen=True, eq=False)
class GradientLaw:
    """−R2⁻¹ g2(x)ᵀ V_xᵀ with the coefficients of V_x as data.

    Attributes
    ----------
    slopes : PolynomialLaw
        V_x, one row per state.
    input_matrix : callable
        g2 at one deviation (n,) on any element, (n, m).
    price : ndarray, shape (m, m)
        R2⁻¹.
    """

    slopes: PolynomialLaw
    input_matrix: Callable[[Any], Any]
    price: np.ndarray

    @cached_property
    def key(self) -> str:
        """What distinguishes its code: the monomials, and R2⁻¹ g2ᵀ as it is computed."""
        priced = trace(
            lambda x: self.price @ np.asarray(self.input_matrix(x)).T, self.slopes.n, name="priced"
        )
        return f"gradient {self.slopes.n} {self.slopes.degrees} {digest(priced)}"

    @property
    def coefficients(self) -> np.ndarray:
        """Of V_x, (n, Nmon)."""
        return self.slopes.coefficients

    def evaluate(self, x: Any, coefficients: Any) -> Any:
        """The law at one deviation (n,) on any element, (m,)."""
        slope = self.slopes.evaluate(x, coefficients)
        return -(self.price @ (np.asarray(self.input_matrix(x)).T @ slope))


def input_matrix_of(problem: Problem | None, expansion: PolynomialPlant) -> Callable[[Any], Any]:
    """g2 on any element: the exact one where the problem offers it, else its expansion."""
    return (problem if isinstance(problem, EXACT_INPUT_MATRIX) else expansion).input_matrix
