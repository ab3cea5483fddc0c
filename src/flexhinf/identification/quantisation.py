"""Steps of what an encoder counts: their size in a log, and the correlation that rounding gives to innovations.

The error of rounding to steps of size q has the variance q²/12 [widrow1961]. It is white only where a signal moves by
more than a step from sample to sample. Of slow motions it is a saw tooth, and innovations follow each other though
model and noise are right. How much of their correlation this is, the filter's own predictions tell, rounded as the
encoder rounds.
"""

from __future__ import annotations

import numpy as np

#: Differences that are rounding of numbers, beside the largest value, and draws of the noise before rounding.
ROUNDING, DRAWS = 1e-9, 4


def smallest_step(values: np.ndarray) -> float:
    """The smallest step between two values of a signal (N,), in its unit: of an encoder one count; 0 if none differ.

    Examples
    --------
    >>> round(smallest_step(np.array([0.0, 0.2, 0.2, 0.1, 0.4])), 12)
    0.1
    """
    known = np.unique(values[np.isfinite(values)])
    apart = np.diff(known)
    apart = apart[apart > ROUNDING * np.abs(known).max(initial=0.0)]
    if not apart.size:
        return 0.0
    # Of printed numbers neighbours are not quite as far apart: the mean of all is.
    return float(apart.sum() / np.rint(apart / apart.min()).sum())


def rounding_correlations(
    innovations: np.ndarray, predicted: np.ndarray, deviations: np.ndarray, step: float, lags: int
) -> np.ndarray:
    """Autocorrelations (lags,) that innovations (N,) have because the signal is rounded to a step.

    They are those of Q(ŷ + n) − ŷ over the deviations (N,): ŷ (N,) what the filter predicts, Q rounding to the step,
    n white noise for what the innovations have beyond q²/12. NaN stands where nothing was measured.
    """
    known = np.isfinite(innovations) & np.isfinite(deviations) & (deviations > 0.0)
    centre, scale = predicted[known], deviations[known]
    power = float(np.mean(np.square(innovations[known]))) if known.any() else 0.0
    total, rng = np.zeros(lags), np.random.default_rng(0)
    noise = np.sqrt(max(0.0, power - step**2 / 12.0))
    for _ in range(DRAWS):
        noisy = centre + noise * rng.standard_normal(centre.size)
        total += autocorrelations((step * np.rint(noisy / step) - centre) / scale, lags)
    return total / DRAWS


def autocorrelations(values: np.ndarray, lags: int) -> np.ndarray:
    """r(1) … r(lags) of a sequence (N,); zeros of a constant one."""
    centred = values - values.mean()
    power = inner(centred, centred)
    if not power > 0.0:
        return np.zeros(lags)
    return np.array([inner(centred[lag:], centred[:-lag]) for lag in range(1, lags + 1)]) / power


def inner(left: np.ndarray, right: np.ndarray) -> float:
    """The inner product of two long sequences (N,), whose last bits do not depend on threads as those of BLAS do."""
    return float(np.einsum("i,i->", left, right))
