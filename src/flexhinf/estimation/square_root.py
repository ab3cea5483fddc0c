"""Beliefs as rows of deviations W, P = WᵀW: updates by reflections alone, without a subtraction and without a test.

The covariance itself is never formed, so numbers of 1e-8 and 1e8 may stand beside each other, and P cannot become
indefinite. Two arrays are reduced to triangles by Householder's reflections (`flexhinf.scalars.householder`):

    of a prediction           of a measurement y = C x + v, R = W_rᵀ W_r

    [ moved deviations ]      [ W Cᵀ   W   0   ]        [ S   K_x   K_v ]
    [ W_q              ]      [ W_r    0   W_r ]   →    [ 0   X     N   ]

X is the new W, and the mean moves by K_xᵀ g with Sᵀ g = y − C x̂ [kailath2000]. Noise stands last: what is summed last
should be small. y = C x + v holds for the estimates of x and v, and z = C x + v for each row (z, x, v) that is left;
what rounding leaves of that, found in twice the digits (`flexhinf.scalars.residual`), goes through the gains once more.

A deviation moves by difference arithmetic (`flexhinf.codegen.differences`), not as the difference of two points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.scalars import absolute, maximum, minimum, where
from flexhinf.scalars.run import Run


class RootGaussian(NamedTuple):
    """A mean (n,) and rows W (n, n) of deviations, P = WᵀW."""

    mean: Elements
    root: Elements

    @property
    def covariance(self) -> Elements:
        """P (n, n)."""
        return self.root.T @ self.root


def root_rows(covariance: np.ndarray) -> np.ndarray:
    """W (n, n) with WᵀW a covariance (n, n): the Cholesky factor of its correlations, the largest pivot first.

    A remainder below n eps of its own variance is rounding, and left out.
    """
    n = len(covariance)
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 0.0)
    left = covariance * unit[:, None] * unit
    rows, waiting = np.zeros((n, n)), list(range(n))
    for k in range(n):
        pivot = max(waiting, key=lambda j: left[j, j])
        if not left[pivot, pivot] > n * np.finfo(float).eps:
            break
        waiting.remove(pivot)
        row = np.zeros(n)
        row[[pivot, *waiting]] = left[pivot, [pivot, *waiting]] / np.sqrt(left[pivot, pivot])
        rows[k] = row * scale
        left = left - np.outer(row, row)
    return rows


def root_prediction(run: Run, rows: Elements, process_noise: Elements) -> Elements:
    """W (n, n) of moved deviations, rows (m, n), and R^v (n, n)."""
    n = rows.shape[1]
    return run.householder(run.stacked(rows, run.cholesky(process_noise).T), n, triangle=n)[:n]


@dataclass(frozen=True)
class Pairs:
    """A run on pairs of a state and a deviation of it, for the stages of a Runge–Kutta step of one `flow`.

    The flow and its difference are computed by `both`, of (x, d, …); all else that the stages call are sums, which
    values and deviations have alike.
    """

    run: Run
    flow: Callable[..., Elements]
    both: Callable[..., tuple[Elements, Elements]]

    def call(
        self, function: Callable[..., Elements], *arrays: tuple[Elements, Elements]
    ) -> tuple[Elements, Elements]:
        """As `flexhinf.codegen.Direct.call`, of pairs."""
        if function == self.flow:
            (x, d), *held = arrays
            return self.run.call(self.both, x, d, *held)
        values, deviations = zip(*arrays, strict=True)
        return self.run.call(function, *values), self.run.call(function, *deviations)


def innovation_scales(root: Elements, slope: Elements, noise: Elements) -> Elements:
    """Σ |c_j| σ_j + √r (p,), what an innovation is made of, from W."""
    return absolute(slope) @ np.sqrt((root * root).sum(axis=0)) + np.sqrt(np.diagonal(noise))


def reciprocal_condition(
    gains: Elements, innovation: Elements, root: Elements, slope: Elements, noise: Elements
) -> Elements:
    """ρ / max(1, |ν|) (1,): rounding of W moves the mean of a correction by eps over this many standard deviations.

    ρ is the smallest pivot of S in parts of Σ |c_j| σ_j + √r, what it was made of, and ν = S⁻ᵀ e the innovation in
    standard deviations. 1 where nothing is measured, 0 where a pivot is zero, or a variance too large for a float.

    `gains`: [S …] (p, p or more), the first rows of a reduced array. `innovation`: e (p,). `root`: W (n, n) before the
    correction. `slope`: C (p, n). `noise`: R^n (p, p).
    """
    p, sizes = len(innovation), innovation_scales(root, slope, noise)
    pivots = absolute(np.array([gains[k, k] for k in range(p)])) / sizes
    white = absolute(solved(gains, innovation))
    ratio = reduce(minimum, pivots) / reduce(maximum, white, 1.0)
    return np.array([where(ratio > 0.0, ratio, 0.0)])


def linear_correction(
    run: Run,
    belief: RootGaussian,
    innovation: Elements,
    slope: Elements,
    noise: Elements,
    from_origin: Elements | None = None,
) -> tuple[RootGaussian, Elements, Elements]:
    """x(k|k), the covariance of the innovation, and [S K_x K_v], for an output that is linear about the mean.

    `innovation`: (p,). `slope`: C (p, n). `noise`: R^n (p, p). `from_origin`: (p,), y − H(0), where H is linear
    everywhere: the innovation is that less C x̂, and its rounding is found, too.
    """
    p, mean = len(innovation), belief.mean
    seen, noises = (
        run.columns(_seen, belief.root.T, slope),
        run.columns(_noise, run.cholesky(noise), belief.mean),
    )
    reduced = run.householder(run.stacked(seen.T, noises.T), p, triangle=p)
    gains = reduced[:p]
    first, spread = run.call(_moved, gains, innovation, *(() if from_origin is None else (from_origin, mean)))
    rows = run.stacked(first, reduced[p:])
    rows = run.columns(_refined, (rows.T, run.residual(rows, slope).T), gains).T
    moved = run.call(_first, rows) if from_origin is not None else run.call(_added, rows, mean)
    return RootGaussian(moved, rows[1:]), spread, gains


def correction_of_rows(
    run: Run, mean: Elements, rows: Elements, innovation: Elements, noise: Elements
) -> tuple[RootGaussian, Elements, Elements]:
    """x(k|k), the covariance of the innovation, and [S K_x], of deviations of outputs and states beside each other.

    `rows`: (m, p + n). `innovation`: (p,).
    """
    n, p = len(mean), len(innovation)
    noises = run.columns(_beside_zeros, run.cholesky(noise), mean)
    reduced = run.householder(run.stacked(rows, noises.T), p, triangle=p)
    gains, left = reduced[:p], run.columns(_states, reduced[p:].T, innovation).T
    mean, spread = run.call(_gained, gains, innovation, mean)
    return RootGaussian(mean, run.householder(left, n)[:n]), spread, gains


def _seen(row: Elements, slope: Elements) -> Elements:
    """A row (C w, w, 0)."""
    return np.concatenate([slope @ row, row, np.zeros(len(slope))])


def _noise(row: Elements, mean: Elements) -> Elements:
    """A row (r, 0, r)."""
    return np.concatenate([row, np.zeros(len(mean)), row])


def _beside_zeros(row: Elements, mean: Elements) -> Elements:
    return np.concatenate([row, np.zeros(len(mean))])


def _states(row: Elements, innovation: Elements) -> Elements:
    return row[len(innovation) :]


def solved(gains: Elements, error: Elements) -> Elements:
    """g of Sᵀ g = e, for the first p columns S (p, p) of the gains; zero where a pivot is, for want of any noise."""
    left, found = np.array(error), list[Any]()
    for k in range(len(left)):
        pivot = gains[k, k]
        zero = pivot == 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            found.append(where(zero, 0.0, left[k] / where(zero, 1.0, pivot)))
        left[k + 1 :] = left[k + 1 :] - gains[k, k + 1 : len(left)] * found[k]
    return np.array(found)


def _moved(
    gains: Elements, innovation: Elements, from_origin: Elements | None = None, mean: Elements | float = 0.0
) -> tuple[Elements, Elements]:
    """A row (e, x, v) for which e = C x + v should hold, x the move of the mean or that and the mean; P_yy."""
    p = len(innovation)
    g = solved(gains, innovation)
    x, v = g @ gains[:, p:-p], g @ gains[:, -p:]
    row = np.concatenate([innovation if from_origin is None else from_origin, mean + x, v])
    return row.reshape(1, len(row)), gains[:, :p].T @ gains[:, :p]


def _refined(row: Elements, missing: Elements, gains: Elements) -> Elements:
    """x of a row (e, x, v), once e = C x + v holds."""
    p = len(missing)
    return row[p:-p] + solved(gains, missing) @ gains[:, p:-p]


def _first(rows: Elements) -> Elements:
    return rows[0]


def _added(rows: Elements, mean: Elements) -> Elements:
    return mean + rows[0]


def _gained(gains: Elements, innovation: Elements, mean: Elements) -> tuple[Elements, Elements]:
    p = len(innovation)
    return mean + solved(gains, innovation) @ gains[:, p:], gains[:, :p].T @ gains[:, :p]
