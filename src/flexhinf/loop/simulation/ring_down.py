"""Oscillations in which a loop comes to rest after an impulse, from the recorded runs alone.

Near its equilibrium a sampled loop obeys z(k+1) = A z(k), with z its whole state: states of the plant, estimate,
inputs. A is the least-squares fit to all samples of all runs (dynamic mode decomposition [schmid2010]); its eigenvalues
are the measured decay rates and frequencies, its eigenvectors say how much each of them moves. No model and no
linearisation of the loop enters, so the result holds also where dry friction, limits or a filter whose gain still
settles make it another one than the linear loop. How far the fitted oscillations are from the runs is part of the
result.
"""

# NumPy's least squares have no type for complex numbers.
# pyright: reportUnknownArgumentType=false, reportUnknownMemberType=false, reportUnknownVariableType=false
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flexhinf.loop.simulation.metrics import LASTING, peak_of, tail_of
from flexhinf.scalars.spectral import damping_ratio

#: Directions that all samples together hold less of, relative to the strongest one, are rounding.
RESOLVED = 1e-7

#: An oscillation that moves a watched signal by less than this fraction of its peak cannot be seen in it.
VISIBLE = 0.05

#: Largest distance of the fit from the runs, relative to the peak, up to which these are decaying oscillations; a
#: signal that still has so much more of its peak than `VISIBLE` at the end of its run does not come to rest.
FITS = 0.1


class Oscillation(NamedTuple):
    """One decaying oscillation in one run."""

    frequency: float  # |log λ| / 2π, Hz
    damping: float  # −Re/|·| of its exponent, negative where it grows
    share: float  # its amplitude just after the impulse, over the peak of the watched signal in which it is largest


@dataclass(frozen=True, eq=False)
class RingDown:
    """The oscillations of several runs: for each run those visible in its watched signals, the least damped first.

    `error` is the largest distance of the fit from any watched signal, relative to its peak: near 0 where the loop is
    as good as linear; infinite without a fit. `rests`: every watched signal is nearly gone in the last tenth of its
    run.
    """

    oscillations: tuple[tuple[Oscillation, ...], ...]
    error: float
    rests: bool

    def damping_of(self, run: int, below: float = np.inf) -> float:
        """Smallest damping ratio visible in a run, of oscillations below a frequency, rad/s, and of those that grow; 1
        where nothing oscillates, 0 where runs are no decaying oscillations and do not come to rest."""
        counted = (
            oscillation.damping
            for oscillation in self.oscillations[run]
            if 2.0 * np.pi * oscillation.frequency < below or oscillation.damping < 0.0
        )
        lowest = min(counted, default=1.0)
        return lowest if self.error <= FITS or self.rests else 0.0

    @property
    def damping(self) -> float:
        """Smallest damping ratio of all runs."""
        return min((self.damping_of(k) for k in range(len(self.oscillations))), default=1.0)

    @property
    def worst(self) -> int:
        """The run with the smallest damping ratio."""
        return min(range(len(self.oscillations)), key=self.damping_of)


def ring_down(runs: Sequence[np.ndarray], watched: Sequence[Sequence[int]], period: float) -> RingDown:
    """The oscillations of several runs of one loop, from just after an impulse on.

    Runs are (N, k) deviations of the loop's state from its equilibrium, one row a sample of the period, s; `watched`
    are of each run the columns in which oscillations are looked for.
    """
    before = np.vstack([run[:-1] for run in runs])
    spread = np.sqrt(np.mean(before**2, axis=0))
    scale = np.where(spread == 0.0, 1.0, spread)
    left, sizes, right = np.linalg.svd(before / scale, full_matrices=False)
    kept = int((sizes > RESOLVED * max(sizes[0], 1e-300)).sum())
    left, sizes, right = left[:, :kept], sizes[:kept], right[:kept]
    after = np.vstack([run[1:] for run in runs]) / scale
    # c(k+1) = step c(k) for z = scale · (c right)
    values, vectors = np.linalg.eig(right @ (after.T @ left) / sizes)
    shapes = scale[:, None] * (right.T @ vectors)
    with np.errstate(divide="ignore"):
        exponents = np.log(values.astype(complex)) / period
    frequencies = np.abs(exponents) / (2.0 * np.pi)
    lasting = (exponents.imag > 0.0) & (exponents.real > -1.0 / (LASTING * period))
    oscillations: list[tuple[Oscillation, ...]] = []
    error, rests = 0.0, True
    for run, places in zip(runs, watched):
        columns = run[:, list(places)]
        begin = np.linalg.lstsq(vectors, right @ (run[0] / scale) + 0j, rcond=None)[0]
        parts = shapes[list(places)] * begin
        peaks = np.maximum(peak_of(columns), 1e-300)
        share = 2.0 * (np.abs(parts) / peaks[:, None]).max(axis=0)
        seen = [
            Oscillation(float(frequencies[k]), float(damping_ratio(exponents[k])), float(share[k]))
            for k in np.flatnonzero(lasting & (share >= VISIBLE))
        ]
        oscillations.append(tuple(sorted(seen, key=lambda oscillation: oscillation.damping)))
        with np.errstate(over="ignore", invalid="ignore"):
            fitted = np.real((values[None, :] ** np.arange(len(run))[:, None]) @ parts.T)
            distance = float((np.abs(fitted - columns) / peaks).max())
        error = max(error, distance if np.isfinite(distance) else np.inf)
        rests = rests and bool(np.all(peak_of(tail_of(columns)) <= VISIBLE * peaks))
    return RingDown(tuple(oscillations), error, rests)
