"""Change of variables in neighbouring pairs only: from real coordinates to conjugate complex ones.

Eigenvectors of a real matrix come in conjugate pairs v = p ± iq. Going to the real columns p, q first and
mixing each pair afterwards keeps the expensive, dense part of the change of variables in real arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from flexhinf.polynomial import basis
from flexhinf.polynomial.threads import matrix_product
from flexhinf.polynomial.transform import change_variables

__all__ = ["rotate_pairs"]


def rotate_pairs(entries: np.ndarray, n: int, k: int, rotations: Mapping[int, np.ndarray]) -> np.ndarray:
    """Tensor entries of p(G z), where G is the identity but for 2×2 blocks on the diagonal.

    Parameters
    ----------
    entries : ndarray, shape (count(n, k),)
    rotations : mapping first variable → ndarray, shape (2, 2)
        The blocks; a block at i acts on variables i and i+1.

    Returns
    -------
    ndarray of complex, shape (count(n, k),)
    """
    result = entries.astype(complex)
    for first, rotation in rotations.items():
        for m in range(1, k + 1):
            group = _pair_tuples(n, k, first, m)
            result[group] = matrix_product(result[group], _power(rotation.tobytes(), m))
    return result


@lru_cache(4096)
def _pair_tuples(n: int, k: int, first: int, m: int) -> np.ndarray:
    """Ranks of the tuples that hold the pair's variables exactly m times.

    Returns
    -------
    ndarray of int32, shape (tuples of the other k − m indices, m + 1)
        Column b: the second variable b times, the first m − b times.
    """
    others = basis.indices(n, k - m)
    rest = np.flatnonzero(~((others == first) | (others == first + 1)).any(axis=1)).astype(np.int32)
    columns = []
    for b in range(m + 1):
        ranks = rest
        for step in range(m):
            ranks = basis.insertion(n, k - m + step + 1)[ranks, first + (step < b)]
        columns.append(ranks)
    return np.stack(columns, axis=1)


@lru_cache(512)
def _power(rotation: bytes, m: int) -> np.ndarray:
    """What a 2×2 matrix does to the m+1 tensor entries of degree m in two variables; shape (old, new)."""
    matrix = np.frombuffer(rotation, complex).reshape(2, 2)
    return np.stack([change_variables(unit, 2, m, matrix) for unit in np.eye(m + 1)])
