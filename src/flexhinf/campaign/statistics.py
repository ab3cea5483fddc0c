"""Statistics of a campaign's rows: success rate with its interval, and which number matters for a metric."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.errors import InvalidInput

#: Samples for each coefficient of a surrogate, at least; most coefficients, and most samples that it is fitted to.
SAMPLES_A_TERM, MOST_TERMS, MOST_ROWS = 10, 600, 20_000

#: Parts of the samples of which each in turn is left out to judge the surrogate.
FOLDS = 5

#: Base samples of the Sobol indices of a surrogate.
BASE = 1024

#: Polynomials that are fitted: the one with most terms that the samples allow.
SURROGATES = "a linear polynomial", "a quadratic polynomial without products", "a quadratic polynomial"


@dataclass(frozen=True)
class Interval:
    """A fraction with its confidence interval."""

    successes: int
    count: int
    # low, high: By Clopper and Pearson: exact for independent samples
    low: float
    high: float
    confidence: float

    @property
    def rate(self) -> float:
        """The fraction itself."""
        return self.successes / self.count


def success_interval(successes: int, count: int, confidence: float = 0.95) -> Interval:
    """The interval of a probability of which so many independent samples out of `count` are successes.

    Clopper & Pearson, "The use of confidence or fiducial limits illustrated in the case of the binomial", 1934.
    With no failure in n samples and 95 % it ends at 1 and begins at (0.025)^(1/n): about 1 − 3.7/n.

    Raises InvalidInput: for a count below 1, or successes that are not among them.
    """
    from scipy.special import betaincinv

    if not 0 <= successes <= count or count < 1:
        raise InvalidInput(
            "There is no such fraction.",
            f"expected 0 <= successes <= count, got {successes} of {count}",
            "99 of 100",
        )
    half, failures = 0.5 * (1.0 - confidence), count - successes
    low = betaincinv(successes, failures + 1, half) if successes else 0.0
    high = betaincinv(successes + 1, failures, 1.0 - half) if failures else 1.0
    return Interval(successes, count, float(low), float(high), confidence)


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Sobol indices of a polynomial that was fitted to the samples: of the polynomial, not of the loop."""

    names: tuple[str, ...]  # Numbers that differ from sample to sample, the most important one first
    # first, total: (p,). Fraction of the polynomial's variance that a number causes alone, and with all others
    first: np.ndarray
    total: np.ndarray
    # Fraction of the metric's variance in samples left out of the fit that the polynomial explains. What is left is
    # of higher order, or noise
    r_squared: float
    terms: str  # What the polynomial has
    count: int  # Samples it was fitted to


def sensitivity(names: Sequence[str], numbers: np.ndarray, values: np.ndarray) -> Sensitivity | None:
    """Which numbers a metric depends on, from the samples that there are.

    `numbers`: (N, p), Of the samples.
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
    centre, scale = x.mean(axis=0), x.std(axis=0)
    z = (x - centre) / scale

    def fit(some: np.ndarray | slice) -> np.ndarray:
        return np.linalg.lstsq(_terms(z[some], kind), y[some], rcond=None)[0]

    fold, errors = np.arange(len(y)) % FOLDS, np.empty(len(y))
    for k in range(FOLDS):  # every fifth sample in turn is left out of the fit
        out = fold == k
        errors[out] = y[out] - _terms(z[out], kind) @ fit(~out)
    r_squared = float(1.0 - np.mean(errors**2) / np.var(y))
    coefficients = fit(slice(None))
    first, total = _indices(lambda points: _terms(points, kind) @ coefficients, z)
    order = np.argsort(-total, kind="stable")
    chosen = tuple(names[varied[int(k)]] for k in order)
    return Sensitivity(chosen, first[order], total[order], r_squared, SURROGATES[kind], len(kept))


def _terms(z: np.ndarray, kind: int) -> np.ndarray:
    """Terms (N, terms) of one of `SURROGATES` at standardised numbers (N, p)."""
    parts = [np.ones((len(z), 1)), z]
    if kind > 0:
        parts.append(z**2)
    if kind > 1:
        first, second = np.triu_indices(z.shape[1], 1)
        parts.append(z[:, first] * z[:, second])
    return np.hstack(parts)


class _Empirical:
    """The distribution of samples, as `scipy.stats.sobol_indices` takes one."""

    def __init__(self, values: np.ndarray) -> None:
        self.sorted = np.sort(values)

    def ppf(self, u: np.ndarray) -> np.ndarray:
        """Quantiles."""
        return self.sorted[np.minimum((np.asarray(u) * len(self.sorted)).astype(int), len(self.sorted) - 1)]


def _indices(function, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and total Sobol indices (p,) of a function of points (N, p), its arguments distributed as the samples."""
    from scipy.stats import sobol_indices

    if z.shape[1] == 1:
        return np.ones(1), np.ones(1)
    found = sobol_indices(
        func=lambda points: function(points.T)[None, :], n=BASE, rng=0,
        dists=[_Empirical(column) for column in z.T],
    )  # fmt: skip
    first, total = (np.clip(np.ravel(values), 0.0, 1.0) for values in (found.first_order, found.total_order))
    return first, np.where(np.isfinite(total), total, math.nan)
