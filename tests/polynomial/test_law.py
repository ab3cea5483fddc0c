"""A law as a table of monomials."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.polynomial.law import PolynomialLaw

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
    with pytest.raises(InvalidInput, match=r"expected shape \(inputs, 6\)"):
        PolynomialLaw(2, (1, 3), np.ones((1, 5)))
