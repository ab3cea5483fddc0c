"""Translation from and to Kronecker coefficients: C (x ⊗ … ⊗ x), n^k columns for what C(n+k−1, k) monomials need.

Column (i1, …, ik), the first index slowest, multiplies x_i1 … x_ik; all orderings of one tuple are one
monomial. That is the form of PPR, NLbalancing and QQR [corbin2024].
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.polynomial import basis
from flexhinf.untrusted import real_array


def from_kronecker(coefficients: Any, n: int, k: int) -> np.ndarray:
    """Monomial coefficients of C (x ⊗ … ⊗ x).

    Parameters
    ----------
    coefficients : array_like or SciPy sparse, shape (rows, n^k)
        C; need not be symmetric, orderings are added up.
    n, k : int
        Variables and degree.

    Returns
    -------
    ndarray, shape (rows, count(n, k))

    Raises
    ------
    InvalidInput
        Wrong number of columns.
    """
    matrix: Any = coefficients if hasattr(coefficients, "tocoo") else real_array(coefficients)
    if len(matrix.shape) != 2 or matrix.shape[1] != n**k:
        raise InvalidInput(
            f"The Kronecker coefficients of degree {k} do not fit {n} variables.",
            f"expected shape (rows, {n}^{k} = {n**k}), got {tuple(matrix.shape)}",
            "one column per product x_i1 … x_ik, the first index slowest",
        )
    if hasattr(matrix, "tocoo"):
        entries = matrix.tocoo()
        rows, columns, numbers = entries.row, entries.col, entries.data
    else:
        rows, columns = np.nonzero(matrix)
        numbers = matrix[rows, columns]
    result = np.zeros((matrix.shape[0], basis.count(n, k)))
    np.add.at(result, (rows, _ranks(columns, n, k)), numbers)
    return result


def to_kronecker(part: np.ndarray, n: int, k: int) -> np.ndarray:
    """The symmetric C with C (x ⊗ … ⊗ x) equal to a polynomial given by monomial coefficients.

    Parameters
    ----------
    part : ndarray, shape (…, count(n, k))

    Returns
    -------
    ndarray, shape (…, n^k)
    """
    return (part / basis.multiplicity(n, k))[..., _ranks(np.arange(n**k), n, k)]


def _ranks(columns: np.ndarray, n: int, k: int) -> np.ndarray:
    """Monomial that each Kronecker column belongs to."""
    if k == 0:
        return np.zeros(len(columns), int)
    tuples = np.stack(np.unravel_index(columns, (n,) * k), axis=1)
    return basis.rank(n, np.sort(tuples, axis=1))
