"""Covariances that provoke an estimator: none of whose elements is zero, or one of whose pivots is, to rounding.

A factor L of L Lᵀ takes a pivot for zero that rounding may have made of zero. How much that is, is relative to what was
added up for it. A recorded loop never comes near; the test vector of an export stands on either side.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

#: Elements of a covariance beside its diagonal, at most, as a share of the product of both standard deviations.
CORRELATED = 0.2

#: Pivots of a covariance, relative to what counts as zero, which is so much for each of its rows of what was added up:
#: just below, which is refused; just within either end; and just above. How many of its pivots are tried.
PIVOTS, ROUNDING, MOST_PIVOTS = (-1.08, -0.92, 0.92, 1.08), 1e-14, 4


def correlated(covariance: np.ndarray, of_zero: float) -> np.ndarray:
    """A covariance (n²,) with the same diagonal, or nearly, whose elements are not zero, and differ below it.

    `of_zero`: What takes the place of a standard deviation of zero, of the largest one.
    """
    n = math.isqrt(covariance.size)
    spread = np.sqrt(np.diag(covariance.reshape(n, n)))
    spread = np.where(spread > 0.0, spread, of_zero * spread.max())
    beside = CORRELATED * np.tril(np.cos(1.0 + np.arange(n * n)).reshape(n, n), -1)
    root = spread[:, None] * (np.eye(n) + beside)
    return (root @ root.T).ravel()


def nearly_singular(spread: np.ndarray, seed: int) -> Iterator[np.ndarray]:
    """Covariances of these standard deviations (n,), or nearly, in each of which one pivot is zero to rounding."""
    rng, n = np.random.default_rng(seed), len(spread)
    for k in np.unique(np.linspace(1, n - 1, MOST_PIVOTS).astype(int)) if n > 1 else ():
        for pivot, also in ((pivot, also) for also in (-1, *range(k)) for pivot in PIVOTS):
            root = spread[:, None] * np.tril(rng.uniform(0.2, 1.0, (n, n)))
            root[:, also] *= also < 0  # another one that is zero
            covariance = root @ root.T
            covariance[k, k] = at = root[k, :k] @ root[k, :k]
            added = np.diag(covariance).copy()  # what pivots are computed of, with what came of those before
            for i in range(1, k + 1):
                for j in (j for j in range(i) if j != also):
                    added[i] += (root[i, j] / root[j, j]) ** 2 * added[j]
            covariance[k, k] += pivot * n * ROUNDING * (added[k] if pivot < 0.0 else at)
            yield covariance
