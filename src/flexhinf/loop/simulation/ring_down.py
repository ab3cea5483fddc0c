"""The oscillations in which a loop comes to rest after an impulse, from the recorded runs alone.

Near its equilibrium a sampled loop obeys z(k+1) = A z(k), with z all that it remembers: states of the plant, estimate,
inputs. A is the least-squares fit to all samples of all runs (dynamic mode decomposition [schmid2010]); its eigenvalues
are the measured decay rates and frequencies, its eigenvectors say how much each of them moves. No model and no
linearisation of the loop enters, so what it shows is what the loop does: also where dry friction, limits or a filter
whose gain still settles make it another one than the linear loop. How far the fitted oscillations are from the runs is
part of the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.loop.simulation.metrics import damping_ratio

#: Directions that all samples together hold less of, relative to the strongest one, are rounding.
RESOLVED = 1e-7

#: An oscillation that moves a watched signal by less than this fraction of its peak cannot be seen in it.
VISIBLE = 0.05

#: Largest distance of the fit from the runs, relative to the peak, up to which these are decaying oscillations; a
#: signal that still has so much more of its peak than `VISIBLE` at the end of its run does not come to rest.
FITS = 0.1

#: A mode that falls below 1/e within so many samples is no oscillation, as `SampledSystem.damping` has it.
LASTING = 2.0


@dataclass(frozen=True)
class Oscillation:
    """One decaying oscillation in one run: |log λ| / 2π, Hz; −Re/|·| of its exponent, negative where it grows; and its
    amplitude just after the impulse, over the peak of the watched signal in which it is largest."""

    frequency: float
    damping: float
    share: float


@dataclass(frozen=True, eq=False)
class RingDown:
    """The oscillations of several runs: of each those that can be seen in its watched signals, the least damped first.

    `error` is the largest distance of the fit from any watched signal, relative to its peak: near 0 where the loop is
    as good as linear; infinite without a fit. `rests`: every watched signal is nearly gone in the last tenth of its
    run.
    """

    oscillations: tuple[tuple[Oscillation, ...], ...]
    error: float
    rests: bool

    def damping_of(self, run: int) -> float:
        """Smallest damping ratio that is seen in a run; 1 where nothing oscillates, 0 where runs are no decaying
        oscillations and do not come to rest."""
        if not self.error <= FITS and not self.rests:
            return 0.0
        return min((found.damping for found in self.oscillations[run]), default=1.0)

    @property
    def damping(self) -> float:
        """The smallest of all runs."""
        return min((self.damping_of(k) for k in range(len(self.oscillations))), default=1.0)

    @property
    def worst(self) -> int:
        """The run in which it is seen."""
        return min(range(len(self.oscillations)), key=self.damping_of)


def ring_down(runs: Sequence[np.ndarray], watched: Sequence[Sequence[int]], period: float) -> RingDown:
    """The oscillations of several runs of one loop, from just after an impulse on.

    Runs are (N, k) deviations from the equilibrium of all that the loop remembers, one row a sample of the period, s;
    `watched` are of each run the columns in which oscillations are looked for.
    """
    before = np.vstack([run[:-1] for run in runs])
    scale = np.sqrt(np.mean(before**2, axis=0))
    scale[scale == 0.0] = 1.0
    left, sizes, right = np.linalg.svd(before / scale, full_matrices=False)
    kept = int((sizes > RESOLVED * max(sizes[0], 1e-300)).sum())
    left, sizes, right = left[:, :kept], sizes[:kept], right[:kept]
    after = np.vstack([run[1:] for run in runs]) / scale
    step = right @ (after.T @ left) / sizes  # c(k+1) = step c(k) for z = scale · (c right)
    values, vectors = np.linalg.eig(step)
    shapes = scale[:, None] * (right.T @ vectors)
    with np.errstate(divide="ignore"):
        exponents = np.log(values.astype(complex)) / period
    frequencies = np.abs(exponents) / (2.0 * np.pi)
    lasting = (exponents.imag > 0.0) & (exponents.real > -1.0 / (LASTING * period))
    oscillations, error, rests = [], 0.0, True
    for run, places in zip(runs, watched):
        begin, columns = (
            np.linalg.lstsq(vectors, right @ (run[0] / scale) + 0j, rcond=None)[0],
            run[:, list(places)],
        )
        parts = shapes[list(places)] * begin
        peaks = np.maximum(np.abs(columns).max(axis=0), 1e-300)
        share = 2.0 * (np.abs(parts) / peaks[:, None]).max(axis=0)
        seen = [
            Oscillation(float(frequencies[k]), float(damping_ratio(exponents[k])), float(share[k]))
            for k in np.flatnonzero(lasting & (share >= VISIBLE))
        ]
        oscillations.append(tuple(sorted(seen, key=lambda one: one.damping)))
        with np.errstate(over="ignore", invalid="ignore"):
            fitted = np.real((values[None, :] ** np.arange(len(run))[:, None]) @ parts.T)
            distance = float((np.abs(fitted - columns) / peaks).max())
        error = max(error, distance if np.isfinite(distance) else np.inf)
        tail = np.abs(columns[-max(1, len(run) // 10) :]).max(axis=0)
        rests = rests and bool(np.all(tail <= VISIBLE * peaks))
    return RingDown(tuple(oscillations), error, rests)
