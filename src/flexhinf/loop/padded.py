"""Polynomial laws of one text: monomials that some of them do not have get coefficients of zero.

A law about hanging has no even degrees, by symmetry, and one about another pose has: solved to the same degree,
they still differ in their monomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.loop.staged import offers
from flexhinf.plant import Law
from flexhinf.polynomial import basis
from flexhinf.polynomial.law import PolynomialLaw

__all__ = ["PaddedLaw", "of_one_text"]


class PaddedLaw:
    """A polynomial law with more degrees than occur in it.

    Parameters
    ----------
    law : Law
        With a method ``law_polynomial()``.
    degrees : tuple of int
        Ascending; those of the law among them.
    """

    def __init__(self, law: Law, degrees: tuple[int, ...]) -> None:
        polynomial: PolynomialLaw = law.law_polynomial()  # type: ignore[attr-defined]
        n, own = polynomial.n, polynomial.coefficients
        parts, start = [], 0
        for degree in degrees:
            size = basis.count(n, degree)
            if degree in polynomial.degrees:
                parts.append(own[:, start : start + size])
                start += size
            else:
                parts.append(np.zeros((len(own), size)))
        self.polynomial = PolynomialLaw(n, degrees, np.concatenate(parts, axis=1))
        self.state_names, self.input_names = tuple(law.state_names), tuple(law.input_names)
        self.operating_point, self.operating_input = law.operating_point, law.operating_input
        self.law_data, self.law_key = self.polynomial.coefficients.ravel(), f"polynomial {n} {degrees}"

    def law_polynomial(self) -> PolynomialLaw:
        """The polynomial."""
        return self.polynomial

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """k(x), (m,), for a deviation x (n,) on any element."""
        return self.polynomial.evaluate(x, np.asarray(data).reshape(self.polynomial.coefficients.shape))


def of_one_text(laws: Sequence[Law]) -> tuple[Law, ...]:
    """The laws, padded if they are polynomials of one kind and one ``degree`` whose monomials differ."""
    alike = len({(type(law), getattr(law, "degree", law.law_key)) for law in laws}) == 1
    if len({law.law_key for law in laws}) == 1 or not alike or not all(map(_polynomial, laws)):
        return tuple(laws)
    degrees = {degree for law in laws for degree in law.law_polynomial().degrees}  # type: ignore[attr-defined]
    return tuple(PaddedLaw(law, tuple(sorted(degrees))) for law in laws)


def _polynomial(law: Law) -> bool:
    """Whether `law_polynomial` says what `evaluate_law` computes."""
    return offers(law, "law_polynomial", "evaluate_law") and getattr(law, "law_is_polynomial", True)
