"""Which numbers matter for a metric of a campaign: Sobol indices of a polynomial fitted to its samples."""

# Statistics of SciPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownLambdaType=false
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import numpy as np

from flexhinf.arrays import Matrix, Vector

#: Smallest number of samples per coefficient of a surrogate; its largest numbers of coefficients and of samples.
SAMPLES_A_TERM, MOST_TERMS, MOST_ROWS = 10, 600, 20_000

#: Number of parts for cross-validation of the surrogate: each part in turn is left out of the fit.
FOLDS = 5

#: Samples whose terms are in memory at a time.
CHUNK = 1024

#: Base samples of the Sobol indices of a surrogate.
BASE = 1024

#: Polynomials for the fit; the one with the most terms that the samples allow is used.
SURROGATES = "a linear polynomial", "a quadratic polynomial without products", "a quadratic polynomial"


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Sobol indices of a polynomial that was fitted to the samples; they describe the polynomial, not the loop."""

    names: tuple[str, ...]  # Numbers that differ from sample to sample, the most important one first
    # first, total: (p,). Fraction of the polynomial's variance that a number causes alone, and with all others
    first: np.ndarray
    total: np.ndarray
    # Fraction of the metric's variance that the polynomial explains in samples left out of the fit; the remainder is of
    # higher order, or noise
    r_squared: float
    terms: str  # What the polynomial has
    count: int  # Samples it was fitted to


def sensitivity(names: Sequence[str], numbers: np.ndarray, values: np.ndarray) -> Sensitivity | None:
    """Sobol indices of a metric with respect to the varied numbers, from a polynomial fitted to the samples.

    `numbers`: (N, p), The varied numbers of the samples.
    `values`: (N,), The metric; samples where it is not finite are left out.
    Returns: none where nothing differs, or there are too few samples for a straight line in each number.
    """
    kept = np.flatnonzero(np.isfinite(values))[:MOST_ROWS]
    varied = [k for k in range(numbers.shape[1]) if len(kept) and np.ptp(numbers[kept, k]) > 0.0]
    x, y = numbers[kept][:, varied], values[kept]
    count = len(varied)
    most = min(len(kept) // SAMPLES_A_TERM, MOST_TERMS) - 1 - count  # terms beside the linear ones
    if most < 0 or not count or np.ptp(y) <= 1e-12 * np.abs(y).max():
        return None
    kind = int(most >= count) + int(most >= count + count * (count - 1) // 2)
    z, centred = (x - x.mean(axis=0)) / x.std(axis=0), y - y.mean()
    squares, products = _normal_equations(z, centred, kind)
    errors = np.empty(len(y))
    for k in range(FOLDS):  # every fifth sample in turn is left out of the fit
        others = np.arange(FOLDS) != k
        left_out = np.linalg.lstsq(squares[others].sum(axis=0), products[others].sum(axis=0), rcond=None)[0]
        errors[k::FOLDS] = centred[k::FOLDS] - _fitted(z[k::FOLDS], kind, left_out)
    r_squared = float(1.0 - np.mean(errors**2) / np.var(y))
    coefficients = np.linalg.lstsq(squares.sum(axis=0), products.sum(axis=0), rcond=None)[0]
    first, total = _indices(lambda points: _fitted(points, kind, coefficients), z)
    order = np.argsort(-total, kind="stable")
    return Sensitivity(
        tuple(names[varied[int(k)]] for k in order),
        first[order],
        total[order],
        r_squared,
        SURROGATES[kind],
        len(kept),
    )


def _terms(z: np.ndarray, kind: int) -> np.ndarray:
    """Terms (N, terms) of one of `SURROGATES` at standardised numbers (N, p)."""
    parts = [np.ones((len(z), 1)), z, *([z**2] if kind > 0 else [])]
    if kind > 1:
        first, second = np.triu_indices(z.shape[1], 1)
        parts.append(z[:, first] * z[:, second])
    return np.hstack(parts)


def _normal_equations(z: Matrix, y: Vector, kind: int) -> tuple[np.ndarray, Matrix]:
    """AᵀA (folds, terms, terms) and Aᵀy (folds, terms) of the samples of each fold, `CHUNK` of them at a time."""
    size = _terms(z[:1], kind).shape[1]
    squares, products = np.zeros((FOLDS, size, size)), np.zeros((FOLDS, size))
    for k in range(FOLDS):
        for some in _chunks(len(y[k::FOLDS])):
            terms = _terms(z[k::FOLDS][some], kind)
            squares[k] += terms.T @ terms
            products[k] += terms.T @ y[k::FOLDS][some]
    return squares, products


def _fitted(z: Matrix, kind: int, coefficients: Vector) -> Vector:
    return np.concatenate([_terms(z[some], kind) @ coefficients for some in _chunks(len(z))])


def _chunks(count: int) -> Iterator[slice]:
    return (slice(at, at + CHUNK) for at in range(0, count, CHUNK))


def _indices(function: Callable[[Matrix], Vector], z: Matrix) -> tuple[Vector, Vector]:
    """First and total Sobol indices (p,) of a function of points (N, p), its arguments distributed as the samples."""
    from scipy.stats import sobol_indices

    if z.shape[1] == 1:
        return np.ones(1), np.ones(1)
    ordered, count = np.sort(z, axis=0), len(z)

    def quantiles(k: int, u: np.ndarray) -> np.ndarray:
        return ordered[np.minimum((np.asarray(u) * count).astype(int), count - 1), k]

    def values(points: Matrix) -> Matrix:
        return function(points.T)[None, :]

    indices = sobol_indices(
        func=values,
        n=BASE,
        rng=0,
        dists=[SimpleNamespace(ppf=partial(quantiles, k)) for k in range(z.shape[1])],
    )
    first, total = (
        np.clip(np.ravel(order), 0.0, 1.0) for order in (indices.first_order, indices.total_order)
    )
    return first, np.where(np.isfinite(total), total, math.nan)
