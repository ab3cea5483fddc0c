"""A law as a table of monomials."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.polynomial.algebra import PolynomialLaw

LAW = PolynomialLaw(2, (1, 3), np.arange(12.0).reshape(2, 6))


def test_numbers_and_exact_elements_agree():
    exact = LAW.evaluate(np.array([Fraction(1, 2), Fraction(-3, 4)], dtype=object))
    assert LAW.evaluate(np.array([0.5, -0.75])) == pytest.approx(exact.astype(float), rel=1e-15)
    by_hand = LAW.coefficients @ np.prod(np.array([0.5, -0.75]) ** LAW.exponents, axis=1)
    assert by_hand == pytest.approx(LAW.evaluate(np.array([0.5, -0.75])), rel=1e-15)


def test_coefficients_can_be_given():
    assert LAW.evaluate(np.array([1.0, 1.0]), np.ones((1, 6))).tolist() == [6.0]


def test_symbols_pass_through():
    scalars = pytest.importorskip("flexhinf.scalars")
    function = scalars.trace(lambda x, c: LAW.evaluate(x, c.reshape(2, 6)), 2, 12, name="law")
    value = np.array(function([0.3, -0.7], LAW.coefficients.ravel())).ravel()
    assert value == pytest.approx(LAW.evaluate(np.array([0.3, -0.7])), rel=1e-14)


def test_wrong_width_is_refused():
    with refused_with(InvalidInput, "(inputs, 6)", "(1, 5)"):
        PolynomialLaw(2, (1, 3), np.ones((1, 5)))


def test_a_law_of_symbols_is_summed_in_eight_parts():
    """Its latency lies between measurement and input: a sum of 35 terms one after the other would be 35 deep."""

    class Depth:
        def __init__(self, depth):
            self.depth = depth

        def __mul__(self, other):
            return Depth(max(self.depth, getattr(other, "depth", 0)) + 1)

        __add__ = __radd__ = __rmul__ = __mul__

    law = PolynomialLaw(5, (1, 3), np.ones((2, 40)))
    u = law.evaluate(np.array([Depth(0) for _ in range(5)], dtype=object))
    assert (
        max(value.depth for value in u) <= 3 + 5 + 3
    )  # monomial and coefficient, a part's terms, pairs of parts
