"""Kronecker coefficients against products written out."""

from __future__ import annotations

from functools import reduce

import numpy as np
import pytest
import scipy.sparse

from flexhinf.errors import InvalidInput
from flexhinf.polynomial import algebra
from flexhinf.polynomial.basis import from_kronecker, to_kronecker


def _power(x: np.ndarray, k: int) -> np.ndarray:
    return reduce(np.kron, [x] * k, np.ones(1))


@pytest.mark.parametrize(("n", "k"), [(1, 4), (2, 3), (3, 0), (3, 1), (4, 3), (5, 2)])
@pytest.mark.parametrize("sparse", [False, True])
def test_values_are_the_same(n, k, sparse):
    rng = np.random.default_rng(n + 10 * k)
    full = rng.standard_normal((2, n**k)) * (rng.random((2, n**k)) < 0.7)
    part = from_kronecker(scipy.sparse.csr_array(full) if sparse else full.tolist(), n, k)
    x = rng.standard_normal((3, n))
    expected = np.array([full @ _power(point, k) for point in x])
    assert algebra.evaluate({k: part}, x) == pytest.approx(expected, rel=1e-12, abs=1e-13)


def test_back_is_the_symmetric_one():
    rng = np.random.default_rng(0)
    full = rng.standard_normal((1, 27))
    back = to_kronecker(from_kronecker(full, 3, 3), 3, 3).reshape(3, 3, 3)
    tensor = full.reshape(3, 3, 3)
    orders = [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]
    assert back == pytest.approx(sum(tensor.transpose(order) for order in orders) / 6, rel=1e-12)


def test_wrong_width_is_told():
    with pytest.raises(InvalidInput, match=r"3\^2 = 9\), got \(3, 6\)"):
        from_kronecker(np.ones((3, 6)), 3, 2)
